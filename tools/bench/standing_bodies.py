"""When the bodies of a launch stand after a press: by the world that they are in, not by what robots say.

The launch is `tools.bench.watched_launch`. Two times are told of each press. No command to move is in
force any more: the bound of a stop on the bus is about that (docs/how/safety_case.md, S1). And the last
body stands: later, by the time in which it brakes.
"""

import asyncio
import json
from asyncio.subprocess import PIPE, STDOUT, Process
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from tools.bench.figure import Figure
from tools.bench.stopped_beats import BUS_BOUND_MS, LOOK_S, READY_S, TIMEOUT_S
from tools.bench.systems import ADDED_MS
from tools.bench.watched_launch import KEY
from tools.common.child_process import module_command

DRIVING_SHARE: Final = 0.5  # of its full speed, from which on a body drives
SOME_S: Final = 15.0  # for so many bodies to drive at once; after it one is enough
ALL_MAX: Final = 4  # bodies of a fleet of which all have to drive; of a larger one half of them
STANDS_S: Final = (
    0.5  # nothing has moved for this long: what begins to brake after it is none of the press
)


class BodiesPress(NamedTuple):
    """Milliseconds from one press."""

    commanded_ms: float  # until no command to move is in force
    stood_ms: float  # until the last body stands
    driving: int  # bodies that drove when it was pressed


async def start_watched(folder: Path, scenario: str, robots: int) -> Process:
    """A launch whose bodies are watched, in a folder, with its output in a pipe."""
    return await asyncio.create_subprocess_exec(
        *module_command("tools.bench.watched_launch"), scenario, str(robots),
        cwd=folder, stdout=PIPE, stderr=STDOUT,
    )  # fmt: skip


class Bodies:
    """What a watched launch says of its bodies."""

    def __init__(self, speed_m_s: float) -> None:
        """`speed_m_s`: of a body at its full speed."""
        self.speed_min_m_s = DRIVING_SHARE * speed_m_s
        self.speeds_m_s: list[float] = []
        self.now_s = 0.0  # as new as what follows
        self.moved_s: list[float] = []  # when each body moved last
        self.commanded_s: list[float] = []  # when a command to move was last in force

    async def read(self, launch: Process) -> None:
        """Until the output ends."""
        assert launch.stdout is not None
        async for raw in launch.stdout:
            self.take(raw)

    def take(self, raw: bytes) -> None:
        """One line of the launch; only those of its bodies count."""
        if raw.startswith(b'{"bodies"'):
            told = json.loads(raw)
            self.now_s = told["now_s"]
            self.moved_s = [moved_s for moved_s, _, _ in told[KEY]]
            self.commanded_s = [commanded_s for _, commanded_s, _ in told[KEY]]
            self.speeds_m_s = [speed_m_s for _, _, speed_m_s in told[KEY]]

    @property
    def driving(self) -> int:
        """How many bodies drive."""
        return sum(speed_m_s >= self.speed_min_m_s for speed_m_s in self.speeds_m_s)

    async def drive(self) -> int:
        """Wait until all bodies drive, half of a large fleet, or one after a while; how many do. Raises
        TimeoutError."""
        loop = asyncio.get_running_loop()
        begun_s = loop.time()
        async with asyncio.timeout(READY_S):
            while True:
                await asyncio.sleep(LOOK_S)
                bodies = len(self.speeds_m_s)
                least = bodies if bodies <= ALL_MAX else bodies // 2
                if loop.time() - begun_s >= SOME_S:
                    least = 1
                if 0 < least <= self.driving:
                    return self.driving

    async def stood(self, pressed_s: float, driving: int) -> BodiesPress:
        """Wait until all bodies stand after a press. Raises TimeoutError."""
        async with asyncio.timeout(TIMEOUT_S):
            while self.now_s < pressed_s or self.now_s - max(self.moved_s) < STANDS_S:
                await asyncio.sleep(LOOK_S)
        return BodiesPress(
            1000 * (max(self.commanded_s) - pressed_s),
            1000 * (max(self.moved_s) - pressed_s),
            driving,
        )


def standing(
    door: str, sides: Sequence[tuple[str, Sequence[BodiesPress]]], robots: int, braking_ms: float,
    against: str,
) -> Iterator[Figure]:  # fmt: skip
    """Two figures for each side on which was pressed. `braking_ms`: of a body at its full speed."""
    limit_ms = BUS_BOUND_MS + ADDED_MS
    for side, presses in sides:
        scope = (
            f"longest of {len(presses)}, by the world of {robots} robots as processes; "
            f"{min(press.driving for press in presses)} or more drove, at half of their speed at least; "
            f"bound of the bus {BUS_BOUND_MS:g} ms"
        )
        commanded_ms = max(press.commanded_ms for press in presses)
        yield Figure(
            f"{door}: stop {side}, no command to move in force", commanded_ms, "ms", f"<= {limit_ms:g}",
            commanded_ms <= limit_ms, against, scope,
        )  # fmt: skip
        stood_ms = max(press.stood_ms for press in presses)
        yield Figure(
            f"{door}: stop {side}, last body stands", stood_ms, "ms", f"<= {limit_ms + braking_ms:g}",
            stood_ms <= limit_ms + braking_ms, against,
            f"{scope}; and {braking_ms:.0f} ms in which a body brakes from its full speed",
        )  # fmt: skip
