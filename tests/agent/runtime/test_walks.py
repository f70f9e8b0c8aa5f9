"""The three walks of ARCHITECTURE.md go through the files that it names."""

import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.effects import GatedDrive
from agent.interface.lifecycle import State
from agent.interface.mission import ClaimRequest, FleetView
from agent.interface.observation import Observation
from agent.peer.inputs import BusState, Sensed, Timer
from agent.peer.peer import Peer
from agent.runtime.peer_runner import PeerRunner
from agent.safety.stop_controller import StopController
from protocol.controller_health import Health
from protocol.frames.codec import encode
from protocol.frames.frame import Frame
from protocol.frames.safety_frames import EmergencyStop, Reason
from tests.agent.lone_peer import Eager, introduce, peer_in

ROOT = Path(__file__).parents[3]
CALLS_MAX, FILES_MAX = 8, 6  # of ours, between a stop frame and the actuator
SECTION = 0
Call = tuple[str, str]  # file, function


class Bus:
    """A bus that hands over one frame."""

    health = Health.ACTIVE

    def __init__(self) -> None:
        self.callback: Callable[[Frame], None] = print

    def send(self, frame: Frame) -> bool:
        return True

    def subscribe(self, callback: Callable[[Frame], None]) -> None:
        self.callback = callback

    def close(self) -> None: ...


class StandingBody:
    def __init__(self) -> None:
        self.told: list[GatedDrive] = []

    def sense(self, now_us: int) -> Observation | None:
        return Observation(0.0, 0.0, 0.0, 0.0, 0.0, sensed_at_us=now_us)

    def drive(self, command: GatedDrive, now_us: int) -> None:
        self.told.append(command)


def ours(frame: FrameType | None) -> Iterator[Call]:
    """The functions of ours on the stack, innermost first; comprehensions count as their function."""
    while frame is not None:
        file = Path(frame.f_code.co_filename)
        if file.is_relative_to(ROOT / "agent") and not frame.f_code.co_name.startswith("<"):
            yield file.relative_to(ROOT).as_posix(), frame.f_code.co_name
        frame = frame.f_back


@contextmanager
def walked(*stations: Callable[..., Any]) -> Iterator[set[Call]]:
    """Every function of ours that is on the stack when one of the stations is called.

    These are the calls on the way: what they call and return from in between is not counted."""
    calls: set[Call] = set()
    codes = {station.__code__ for station in stations}

    def seen(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code in codes:
            calls.update(ours(frame))

    sys.setprofile(seen)
    try:
        yield calls
    finally:
        sys.setprofile(None)


def paragraph(title: str) -> set[str]:
    """The files that a paragraph of ARCHITECTURE.md names."""
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    found = re.search(rf"^\*\*{title}\.\*\*(.*?)\n\n", text, re.DOTALL | re.MULTILINE)
    assert found is not None, title
    return set(re.findall(r"`(agent/[a-z_/]+\.py)`", found.group(1)))


def files(calls: set[Call]) -> set[str]:
    return {file for file, _ in calls}


def test_a_stop_reaches_the_actuator_in_few_calls() -> None:
    peer = peer_in(State.WORKING, None)
    introduce(peer, 141, 1)
    bus, body = Bus(), StandingBody()
    runner = PeerRunner(peer, bus, body, None, clock=lambda: S)
    runner._listening = True
    bus.subscribe(runner._on_frame)
    stop = encode(EmergencyStop(1, 1, 1, Reason.PERSON_IN_FIELD), 141)
    with walked(StopController.receive_stop, StandingBody.drive) as calls:
        bus.callback(stop)
    assert body.told == [(0.0, 0.0, 0.0, False, -1)] and peer.safety.latched
    assert len(calls) <= CALLS_MAX and len(files(calls)) <= FILES_MAX, sorted(calls)
    assert files(calls) == paragraph("A stop")


class OneSection(Eager):
    """A mission that claims one section."""

    def choose(self, view: FleetView) -> ClaimRequest | None:
        return ClaimRequest(SECTION, 0)


def tick(peer: Peer, now_us: int) -> int:
    """One timer, sensed and confirmed; returns its time."""
    now_us = max(now_us + 1, peer.due_at_us)
    peer.step(BusState(Health.ACTIVE, True, now_us), now_us)
    if peer.wants_observation(now_us):
        x_m = 0.01 * (now_us // CONTROL_PERIOD_US)
        peer.step(Sensed(Observation(x_m, 0.0, 0.0, 0.0, 0.0, sensed_at_us=now_us)), now_us)
    peer.step(Timer(), now_us)
    return now_us


def stations(*of: Sequence[Any]) -> list[Callable[..., Any]]:
    return [getattr(type(part), name) for part, name in of]


@pytest.fixture
def working() -> Peer:
    peer = peer_in(State.IDLE, None)
    peer.lifecycle.machine.state = State.DISCONNECTED
    mission = OneSection()
    named = peer.named
    named.control.mission = named.work.mission = mission
    return peer


def test_a_claim_is_made_and_started_where_the_document_says(working: Peer) -> None:
    allocation, now_us = working.allocation, 0
    with walked(
        *stations((allocation, "claim"), (allocation, "start"), (OneSection(), "begin"))
    ) as calls:
        while working.claims.current is None and now_us < 20 * S:
            now_us = tick(working, now_us)
    assert working.claims.current == SECTION and working.state is State.WORKING
    assert files(calls) == paragraph("A claim")


def test_a_control_tick_goes_where_the_document_says(working: Peer) -> None:
    named, now_us = working.named, 0
    while working.claims.current is None and now_us < 20 * S:
        now_us = tick(working, now_us)
    motion = named.motion
    walk = stations(
        (named.check, "look"), (named.senses, "look"), (OneSection(), "work"),
        (named.views, "view"), (motion, "drive"), (named.obstacle, "watch"), (named.safety, "gate"),
    )  # fmt: skip
    with walked(*walk) as calls:
        until_us = now_us + 2 * CONTROL_PERIOD_US
        while now_us < until_us:
            now_us = tick(working, now_us)
    assert files(calls) == paragraph("A control tick")
