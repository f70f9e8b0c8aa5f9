"""The map's operator device on a live bus: stops immediately, releases with the operator's key."""

import asyncio
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from agent.interface.ports import Bus
from protocol.frames.frame import Frame
from protocol.frames.safety_frames import Command, Reason
from tools.common.bus_address import AttachError
from tools.common.bus_attach import connections_of
from tools.operate.device_keys import DeviceKeys
from tools.operate.estop import press
from tools.operate.operator_device import LIVE_S, KnownRobot, Operator
from tools.operate.reset import LISTEN_S, STEP_S, held_still, operator_keyring, release

CONFIRM_S = 10.0  # repeated until every live robot has echoed, at most this long
RELEASE_S = 5.0
ASK_S = 5.0  # asks which robots are there; an answer may have come before we were on the bus


class PanelError(Exception):
    """One line for the person."""


STARTS = 3  # repeats of a start, because a lost one means another walk to the machine
NO_KEY = (
    "this map holds no operator's key: start it with --operator-key, or use headland release; "
    "where the fleet has no keys, say so"
)


def not_confirmed(answer: Mapping[str, Any]) -> str:
    """Robots and addresses that have not confirmed, by the answer of a panel to a press or a release;
    empty if all have."""
    missing = [f"robot {slot}" for slot in answer["late"]]
    missing += [f"address {address}" for address in answer.get("unnamed", ())]
    missing += [f"robot {slot} (not heard)" for slot in answer.get("silent", ())]
    return ", ".join(missing)


def told_result(answer: Mapping[str, Any]) -> tuple[bool, str]:
    """Whether a press or a release has done all that it is for, by the answer of a panel, and a line
    that says so."""
    missing, is_release = not_confirmed(answer), "released" in answer
    if missing:
        failed = "not confirmed"
        if is_release:
            failed = "not started" if answer["released"] else "not released"
        return False, f"{failed}: {missing}"
    if not answer["heard"]:
        return False, "no robot is heard"
    return True, "released" if is_release else f"stopped: {answer['stopped']}"


class Panel:
    """Stops robots for any page, and releases them with the operator's key that was named when the
    map started."""

    def __init__(
        self, bus: Bus, keys: DeviceKeys | None, operator_key: Path | None = None,
        robots: Iterable[int] = (),
    ) -> None:  # fmt: skip
        """`keys`: of a stop panel of a fleet with keys. `operator_key`: file that releases it.
        `robots`: that must confirm a stop, also where they are not heard."""
        self.bus, self.signed = bus, keys is not None
        self._key = operator_key  # chosen at the start of the map, never by a request
        self.stopper = Operator(bus, keys)
        self.stopper.expect(robots)
        self._listeners = [self.stopper]
        self._pressing: asyncio.Task[list[int]] | None = None
        self._repeating: asyncio.Task[list[KnownRobot]] | None = None
        self._releasing: asyncio.Task[dict[str, Any]] | None = None

    def hear(self, now_s: float, frame: Frame) -> None:
        """Pass a frame to the devices that stop and release."""
        for operator in self._listeners:
            operator.hear(now_s, frame)

    async def keep_asking(self) -> None:
        """Asks which robots are there and what has been done, because a late listener has missed it."""
        asked = -1
        while True:
            self.stopper.ask_who()
            if asked != (asked := connections_of(self.bus)):
                self.stopper.ask_work()
                self.stopper.ask_stops()
            await asyncio.sleep(ASK_S if self.stopper.robots else LISTEN_S)

    async def stop(self) -> dict[str, Any]:
        """Press, and report which robots have not confirmed, and which addresses have not said which
        robot they are. A second press waits for the same answer, unless robots were released meanwhile:
        then it is a press of its own. A press ends a release that is under way."""
        if self._releasing is not None:
            self._releasing.cancel()
            self._releasing = None
        if self._pressing is None or self._pressing.done():
            self._pressing = asyncio.create_task(self._press())
        elif self._repeating is not None and self._released:
            self._repeating.cancel()  # the stop that it repeats is cleared
        late = await asyncio.shield(self._pressing)
        live = [robot.slot for robot in self.stopper.live]
        return {
            "stopped": [slot for slot in live if slot not in late], "late": late,
            "unnamed": self.stopper.unnamed(self.stopper.now_s - LIVE_S),
            "heard": bool(live), "signed": self.signed,
        }  # fmt: skip

    @property
    def _released(self) -> bool:
        """Whether a robot that has repeated the stop beats without being stopped."""
        return any(robot.echoed and not robot.stopped for robot in self.stopper.live)

    async def _press(self) -> list[int]:
        while True:
            self._repeating = repeating = asyncio.create_task(
                press(self.stopper, Reason.OPERATOR_INTERVENTION, CONFIRM_S)
            )
            try:
                await asyncio.wait({repeating})
            finally:
                repeating.cancel()
            if not repeating.cancelled():
                return [robot.slot for robot in repeating.result()]

    @property
    def releases(self) -> bool:
        """A fleet with keys can be released from here."""
        return self._key is not None

    async def release(self, keyless: bool, reset: bool, start: bool) -> dict[str, Any]:
        """Clear the stops and reset each machine, and start: both or one of them. `late` of the answer
        has robots that are still latched; where all are `released`, those that did not start. `silent`
        has robots that were there and are not heard: what they do is unknown.

        `keyless`: the person says that the fleet has no keys. Raises PanelError.
        """
        if self._releasing is not None:
            raise PanelError("a release is under way")
        if self._key is None and not keyless:
            raise PanelError(NO_KEY)
        self._releasing = releasing = asyncio.create_task(self._release(reset, start))
        try:
            await asyncio.wait({releasing})
        finally:
            releasing.cancel()
            if self._releasing is releasing:
                self._releasing = None
        if releasing.cancelled():
            raise PanelError("STOP was pressed during the release")
        return releasing.result()

    async def _release(self, reset: bool, start: bool) -> dict[str, Any]:
        try:
            keyring = operator_keyring(self._key, 2 * RELEASE_S)
        except AttachError as problem:
            raise PanelError(str(problem)) from None
        operator = Operator(self.bus, keyring, self.stopper.device)
        operator.expect(robot.slot for robot in self.stopper.members)
        operator.shown.ask()
        self._listeners.append(operator)
        try:
            await operator.listen(LISTEN_S, stops=True)
            operator.check_address()
            shown, _ = operator.shown.named
            latched = await release(operator, False, RELEASE_S) if reset else []
            # On a bus that carries nothing a start would arrive after a later stop.
            starts = start and not latched and bool(operator.live or not reset)
            unstarted = await self._start(operator) if starts else []
            still = await held_still(operator) if latched else frozenset()
            operator.check_address()
        except AttachError as problem:
            raise PanelError(str(problem)) from None
        finally:
            self._listeners.remove(operator)
        return {
            "cleared": [".".join(map(str, d)) for d in shown if d not in still] if reset else [],
            "late": latched or unstarted, "heard": bool(operator.live), "signed": keyring is not None,
            "silent": [robot.slot for robot in operator.silent],
            "released": not latched, "started": starts and not unstarted,
        }  # fmt: skip

    async def _start(self, operator: Operator) -> list[int]:
        """Every machine that is not latched; returns those that did not start."""
        loop = asyncio.get_running_loop()
        end_s = loop.time() + RELEASE_S
        while True:
            for _ in range(STARTS):
                operator.command(Command.START)
                await asyncio.sleep(STEP_S)
            await asyncio.sleep(LISTEN_S)  # until each has beaten
            operator.now_s = loop.time()
            left = [r.slot for r in operator.live if not r.started]
            if not left or loop.time() >= end_s:
                return left
