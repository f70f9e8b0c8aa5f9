"""An independent master control pauses the vehicles of a launch, lets them go on, and takes orders back.

What became of parcels is read from the world of the launch.
"""

import asyncio
import json
import signal
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

from tools.bench.vda5050.counterparts import (
    WAIT_S,
    Mosquitto,
    NodeProgram,
    Witness,
    end,
    start,
)
from tools.bench.vda5050.masters_orders import SCENARIO, vehicles

VEHICLES: Final = 2
RUN_S: Final = 240.0
WANTED: Final[tuple[dict[str, Any], ...]] = (
    {"pause": "FINISHED"}, {"pause": "FINISHED"}, {"cancel": "FINISHED"},
    {"withdrawn": "withdrawn", "states": 0}, {"resume": "FINISHED"}, {"resume": "FINISHED"},
    {"late": "FAILED"}, {"delivered": "delivered"}, {"next": {"failed": False, "cancelled": False}},
)  # fmt: skip
DELIVERED: Final = 2  # of three orders; one is taken back


class MastersActions(NamedTuple):
    """What the master saw, and what became of the parcels."""

    steps: list[dict[str, Any]]
    delivered: int  # 0 if any was mishandled
    flaws: dict[str, int]  # by the official schemas

    @property
    def as_wanted(self) -> int:
        """Steps that ended as the standard says."""
        return sum(step == wanted for step, wanted in zip(self.steps, WANTED, strict=False))


async def trial(folder: Path, node: Path, keyed: bool = False) -> MastersActions:
    """One launch of two robots. `node`: where vda-5050-lib is. `keyed`: the fleet has keys, so the
    gateway believes only what robots prove."""
    (folder / "yard.toml").write_text(SCENARIO.replace("robots = 4", f"robots = {VEHICLES}"))
    broker, master = Mosquitto(folder), NodeProgram()
    await broker.start()
    words, more = ((), ["--keys", "out/keys"]) if keyed else (("--no-keys",), [])
    launch = await start(folder, "launch", "yard.toml", "--out", "out", "--fresh", *words)
    witness = Witness(broker, "Headland")
    try:
        async with vehicles(folder, launch, VEHICLES, broker.url, more=more):
            await master.start(node, "actions.js", broker.url, "yard", str(VEHICLES))
            with suppress(TimeoutError):  # what came until then is the result
                await master.until(lambda events: {"over": True} in events, RUN_S)
            launch.send_signal(signal.SIGINT)
            async with asyncio.timeout(WAIT_S):
                await launch.wait()
    finally:
        await master.kill()
        await witness.close()
        await end(launch)
        await broker.kill()
    report = json.loads((folder / "out" / "report.json").read_text())
    delivered = 0 if any(report["flaws"].values()) else int(report["delivered"])
    steps = [event for event in master.events if event != {"over": True}]
    return MastersActions(steps, delivered, dict(witness.flaws))
