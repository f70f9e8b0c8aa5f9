"""The state machine of the mission's document, edge by edge, and the additions we made.

Then every state with every event and every cause, on a peer: it reacts as docs/stopping.md says.
"""

from collections.abc import Callable, Iterable, Mapping
from itertools import product
from math import hypot
from random import Random
from typing import Any

import numpy as np
import pytest

from agent.cause import Cause, Clears, Severity
from agent.config import MS, STOP_REPEAT_US, S
from agent.core import Peer
from agent.effects import HALT, Drive, Effect, Send
from agent.fsm import Machine, matrix, to_mermaid
from agent.identity import Identity
from agent.lifecycle import TABLE, Event, State
from agent.mission import Choice, FleetView, Wish
from agent.motion import Limits, Motion
from agent.ports import Observation
from agent.safety import CREEP_M_S, REPEATS_ALONE, Safety, SilencePolicy
from crdt.stops import StopDot
from protocol.fleet_frames import Member, Pose
from protocol.name import fleet_name
from protocol.network_frames import AddressClaimed
from protocol.safety_frames import EmergencyReset, EmergencyStop, Reason

# Copied from the mission's diagram by hand: (source, event, target).
MISSION = {
    (State.DISCONNECTED, Event.FLEET_JOINED, State.IDLE),
    (State.IDLE, Event.SYNC_RECEIVED, State.SYNCHRONIZING),
    (State.IDLE, Event.CLAIMED, State.WORKING),
    (State.SYNCHRONIZING, Event.SYNC_COMPLETE, State.IDLE),
    (State.WORKING, Event.TASK_COMPLETE, State.IDLE),
    (State.WORKING, Event.EMERGENCY, State.EMERGENCY_STOP),
    (State.IDLE, Event.EMERGENCY, State.EMERGENCY_STOP),
    (State.SYNCHRONIZING, Event.EMERGENCY, State.EMERGENCY_STOP),
    (State.EMERGENCY_STOP, Event.MANUAL_RESET, State.DISCONNECTED),
}
ADDED = {
    (State.DISCONNECTED, Event.EMERGENCY, State.EMERGENCY_STOP),
    (State.WORKING, Event.SYNC_RECEIVED, State.SYNCHRONIZING),
    *((s, e, State.DISCONNECTED)
      for s in (State.IDLE, State.SYNCHRONIZING, State.WORKING)
      for e in (Event.BUS_LOST, Event.LEFT)),
}  # fmt: skip


@pytest.mark.parametrize(("state", "event"), list(product(State, Event)))
def test_every_combination(state: State, event: Event) -> None:
    target = TABLE[state, event]
    listed = {t for s, e, t in MISSION | ADDED if (s, e) == (state, event)}
    assert target == (listed.pop() if listed else state)


def test_every_state_hears_a_stop_and_only_a_person_ends_it() -> None:
    assert all(TABLE[state, Event.EMERGENCY] is State.EMERGENCY_STOP for state in State)
    ways_out = {e for e in Event if TABLE[State.EMERGENCY_STOP, e] is not State.EMERGENCY_STOP}
    assert ways_out == {Event.MANUAL_RESET}


def test_the_diagram_is_printed_from_the_table() -> None:
    text = to_mermaid(TABLE, State.DISCONNECTED)
    assert text.startswith("stateDiagram-v2\n    [*] --> DISCONNECTED")
    for source, event, target in MISSION | ADDED:
        assert f"{source.name} --> {target.name}: {event.name.lower()}" in text


def test_a_table_with_a_hole_is_refused() -> None:
    with pytest.raises(AssertionError):
        matrix(Event, (State.IDLE, *[None] * len(Event)))
    with pytest.raises(AssertionError):
        matrix(Event, (State.IDLE, None))


def test_a_machine_moves_by_its_table() -> None:
    machine = Machine("lifecycle", TABLE, State.DISCONNECTED)
    assert machine.fire(Event.FLEET_JOINED) == (State.DISCONNECTED, State.IDLE)
    assert machine.fire(Event.MANUAL_RESET) == (State.IDLE, State.IDLE)


# ---------------------------------------------------------------- every state, event and cause

FULL = Wish(2.0, 0.0, 0.0, True)
BY_TIME_US = 1 * S  # what is raised with a time holds so long here


class Eager:
    """A mission that always wants full speed."""

    section_units: Mapping[int, int] = {0: 4}

    def choose(self, view: FleetView) -> Choice | None:
        return None

    def approach(self, section: int, view: FleetView) -> Wish:
        return FULL

    def begin(self, section: int, view: FleetView) -> None: ...
    def work(self, view: FleetView) -> Wish:
        return FULL

    def abandon(self) -> None: ...
    def admits(self, goal: tuple[float, float]) -> bool:
        return True

    def travel(self, goal: tuple[float, float], view: FleetView) -> Wish:
        return FULL

    def interrupted(self) -> None: ...
    def rest(self, view: FleetView) -> Wish:
        return FULL


def peer_in(state: State, cause: Cause | None, policy: SilencePolicy = SilencePolicy.STOP) -> Peer:
    identity = Identity(
        0, frozenset(range(3)), fleet_name("total", 0), 1, policy, started=True, first_boot=True
    )
    motion = Motion(0, Limits(0.8, 2.5, 1.5), np.empty((0, 4)))
    peer = Peer(identity, Random(1), 0, {}, Eager(), motion)
    peer.observe(Observation(0.0, 0.0, 0.0, 0.0, 0.0), 0)
    peer.claims.current = 0 if state is State.WORKING else None
    peer.lifecycle.state = state
    if cause is not None:
        timed = cause.clears is Clears.BY_TIMEOUT
        peer.safety.raise_cause(cause, 0, "", BY_TIME_US if timed else 0)
    return peer


def held_by(peer: Peer) -> set[Cause]:
    return {cause for cause, _ in peer.safety.causes}


@pytest.mark.parametrize("cause", [None, *Cause], ids=lambda c: c.name if c else "no cause")
def test_every_state_event_and_cause(cause: Cause | None) -> None:
    """Events change the state as the table says and clear no cause; the gate knows causes alone."""
    severity = Severity.CLEAR if cause is None else cause.severity
    wanted = Drive(2.0, 0.0, 0.1, True)
    for state, event in product(State, Event):
        peer = peer_in(state, cause)
        peer.latch("a cause that latches")
        source = State.EMERGENCY_STOP if severity is Severity.LATCHED else state
        assert peer.state is source
        peer.fire(event, "whatever comes")
        assert peer.state is TABLE[source, event]
        assert held_by(peer) == ({cause} if cause else set())
        drive = peer.safety.gate(wanted, 0)
        if severity >= Severity.PAUSE:
            assert drive == HALT and not peer.safety.may_move
        elif severity is Severity.SLOW:
            assert hypot(drive.vx_m_s, drive.vy_m_s) == pytest.approx(CREEP_M_S)
        else:
            assert drive == wanted


@pytest.mark.parametrize("cause", [None, *Cause], ids=lambda c: c.name if c else "no cause")
def test_what_a_control_period_drives(cause: Cause | None) -> None:
    """Motion only in IDLE and WORKING, only with no cause above SLOW, the implement not else."""
    for state in State:
        peer = peer_in(state, cause)
        (drive,) = (e for e in peer._working.control(0) if isinstance(e, Drive))
        moves = state in (State.IDLE, State.WORKING) and peer.safety.may_move
        assert (drive != HALT) is moves, state
        if cause is Cause.CREEP:
            assert hypot(drive.vx_m_s, drive.vy_m_s) <= CREEP_M_S + 1e-9


def pass_time(peer: Peer, until_us: int = 10 * S) -> None:
    now_us = 0
    while now_us < until_us:
        now_us = max(now_us + 1, peer.deadline_us)
        peer.tick(now_us)


# What people, the bus and time can do, and which causes each of them ends in which state; by hand.
Act = Callable[[Peer], Any]
ACTS: dict[str, Act] = {
    "start": lambda peer: peer.start(0),
    "manual reset": lambda peer: peer.manual_reset(0),
    "press": lambda peer: peer.press(Reason.PERSON_IN_FIELD, 0),
    "hold": lambda peer: peer.safety.hold(0),
    "bus lost": lambda peer: peer.bus_lost(0),
    "bus back": lambda peer: peer.bus_back(0),
    "leave": lambda peer: peer.leave(0),
    "disk failed": lambda peer: peer.disk_failed(0),
    "time": pass_time,
}
ENDED_BY: dict[Cause, str | None] = {
    Cause.NOT_STARTED: "start",
    Cause.OBSTACLE_AHEAD: None,  # by its answer, or when it leaves: tests/chaos/test_pause.py
    Cause.CREEP: "time",  # here nobody is silent any more
    Cause.MEMBER_SILENT: "time",
    Cause.BACKBONE_LOST: None,  # when a segment is reached: tests/sim/test_segment_fleet.py
    Cause.BACKBONE_CREEP: None,
    Cause.BUS_OFF: "bus back",
    Cause.ERROR_PASSIVE: "time",  # the driver says that it is gone
    Cause.UNHEARD: "time",
    Cause.ADDRESS_LOST: "time",  # it claims another
    Cause.CONFIG_MISMATCH: None,
    Cause.LATE_TICK: "time",
    Cause.UNAUTHENTICATED_STOP: "time",
    Cause.IMPLEMENTS_STOP: "time",
    Cause.DISK_ERROR: None,
    Cause.STOP_DOT: "manual reset",  # here every dot is cleared
    Cause.BOOT_UNCONFIRMED: "manual reset",
}
RAISED_BY = {
    "press": Cause.STOP_DOT,
    "hold": Cause.NOT_STARTED,
    "bus lost": Cause.BUS_OFF,
    "disk failed": Cause.DISK_ERROR,
}


@pytest.mark.parametrize("cause", Cause, ids=lambda c: c.name)
def test_what_ends_each_cause_in_every_state(cause: Cause) -> None:
    for state, (name, act) in product(State, ACTS.items()):
        latches = cause.severity is Severity.LATCHED
        source = State.EMERGENCY_STOP if latches else state
        peer = peer_in(source, cause)
        act(peer)
        ended = ENDED_BY[cause] == name
        expected = (
            (set() if ended else {cause}) | {RAISED_BY[name]}
            if name in RAISED_BY
            else (set() if ended else {cause})
        )
        if (
            name == "manual reset"
            and source is State.EMERGENCY_STOP
            and cause is not Cause.DISK_ERROR
        ):
            expected |= {Cause.NOT_STARTED}  # reset is not start
            assert peer.state is State.DISCONNECTED
        if name == "start" and latches:
            assert cause in held_by(peer), "a latched robot takes no start"
        assert held_by(peer) == expected, (state, name)
        if peer.safety.latched:
            assert peer.state is State.EMERGENCY_STOP, (state, name)


@pytest.mark.parametrize("policy", SilencePolicy, ids=lambda p: p.name)
def test_how_silence_ends(policy: SilencePolicy) -> None:
    peer = peer_in(State.WORKING, None, policy)
    safety, everybody = peer.safety, frozenset(range(3))
    safety.members(everybody, frozenset(), 0)
    safety.members(everybody - {2}, frozenset({2}), 1 * S)
    assert held_by(peer) == {Cause.MEMBER_SILENT}
    safety.tick(3 * S - 1)
    assert held_by(peer) == {Cause.MEMBER_SILENT}, "two seconds without a change first"
    safety.tick(3 * S)
    kept = {
        SilencePolicy.STOP: {Cause.MEMBER_SILENT},
        SilencePolicy.SLOW: {Cause.CREEP},
        SilencePolicy.CONTINUE: set(),
    }
    assert held_by(peer) == kept[policy]
    safety.members(everybody, frozenset(), 10 * S)
    safety.tick(12 * S - 1)
    assert held_by(peer) == kept[policy]
    assert safety.deadline_us == (12 * S if kept[policy] else safety.deadline_us)
    safety.tick(12 * S)
    assert held_by(peer) == set(), "heard again, and stable"


def test_a_reset_while_the_bus_is_off_waits_for_the_bus() -> None:
    """Found by `headland chaos`, profile protocol, seed 1689: it took an address that nobody could
    hear of, lost it when the bus came back, and stayed IDLE without one, awake for good."""
    peer = peer_in(State.IDLE, None)
    pass_time(peer, 2 * S)
    assert peer.joining.joined
    peer.press(Reason.PERSON_IN_FIELD, 2 * S)
    peer.bus_lost(2 * S)
    (dot,) = peer.safety.stops.active
    peer.safety.receive_reset(EmergencyReset(*dot, 200), 2 * S)
    peer.manual_reset(2 * S)
    assert peer.state is State.DISCONNECTED
    for now_us in range(2 * S, 4 * S, 10_000):
        peer.tick(now_us)
        assert peer.state is State.DISCONNECTED and not peer.joining.joined
    peer.bus_back(4 * S)
    for now_us in range(4 * S, 6 * S, 10_000):
        peer.tick(now_us)
    assert peer.joining.joined and peer.state is not State.DISCONNECTED


@pytest.mark.parametrize("late_us", [10_000, 300_000])
def test_an_address_that_is_lost_and_had_again_in_one_turn_is_had(late_us: int) -> None:
    """Found by `headland chaos`, profile protocol, seed 2303982: its clock had been set back, so that
    it took no turn from where it lost its address until the next one was its own; it stood,
    DISCONNECTED, and spoke, for good."""
    peer = peer_in(State.IDLE, None)
    pass_time(peer, 2 * S)
    address = peer.address
    assert address is not None
    peer.hear(address, AddressClaimed(peer.identity.name.pack() - 1), 2 * S)
    for now_us in range(2 * S + late_us, 3 * S, 10_000):
        peer.tick(now_us)
    assert peer.address not in (None, address)
    assert peer.joining.joined and peer.state is State.IDLE
    assert Cause.ADDRESS_LOST not in held_by(peer)


def stops_of(effects: Iterable[Effect]) -> list[EmergencyStop]:
    sent = [effect.message for effect in effects if isinstance(effect, Send)]
    return [message for message in sent if isinstance(message, EmergencyStop)]


def test_who_knows_nobody_repeats_its_stop_for_a_second() -> None:
    """Found by `headland chaos`, profile press, seed 3226: its only frame was lost."""
    peer = peer_in(State.IDLE, None)
    said = stops_of(peer.press(Reason.PERSON_IN_FIELD, 0))
    for now_us in range(0, 3 * S, STOP_REPEAT_US):
        said += stops_of(peer.safety.tick(now_us))
    assert len(said) == 1 + REPEATS_ALONE
    assert len(set(said)) == 2, "one stop; the repetition says who repeats it"


@pytest.mark.parametrize("stood", [False, True])
def test_a_claim_by_one_that_may_move_is_no_sign_of_life(stood: bool) -> None:
    """Found by `headland chaos`, profile protocol, seed 1600653: who was pressed off the bus came back,
    claimed its address, and could say the stop only 250 ms later; its claim put the silence off. A fleet
    that is reset claims anew, and is not silent."""
    peer = peer_in(State.WORKING, None)
    name = fleet_name("total", 1).pack()
    peer.hear(140, AddressClaimed(name), 0)
    peer.hear(140, Member(1, 0, 1), 0)
    pose, silence_us = Pose(0.0, 0.0, 0.0, 0.0, State.IDLE, stood, 0), peer.membership.silence_us
    peer.hear(140, pose, 0)
    peer.hear(140, AddressClaimed(name), silence_us - 1)
    peer.tick(silence_us)
    assert peer.membership.silent == (set() if stood else {1})
    peer.hear(140, AddressClaimed(name), silence_us + 1)
    assert peer.membership.silent == (set() if stood else {1}), (
        "nor does it come back by that alone"
    )
    peer.hear(140, pose, silence_us + 2)
    assert not peer.membership.silent


@pytest.mark.parametrize("back_us", [0, -5 * S])
def test_a_press_is_heard_though_the_clock_is_set_back(back_us: int) -> None:
    peer = peer_in(State.IDLE, None)
    assert stops_of(peer.press(Reason.PERSON_IN_FIELD, 9 * S))
    assert not stops_of(peer.press(Reason.PERSON_IN_FIELD, 9 * S + 1)), "the same hand"
    assert bool(stops_of(peer.press(Reason.PERSON_IN_FIELD, 9 * S + 2 + back_us))) is (back_us < 0)


def test_a_stranger_that_does_not_stand_is_told_of_the_stop() -> None:
    peer = peer_in(State.IDLE, None)
    peer.press(Reason.PERSON_IN_FIELD, 0)
    moving = Pose(0.0, 0.0, 0.0, 2.0, State.WORKING, False, 0)
    (told,) = stops_of(peer.hear(140, moving, S))
    assert (told.slot, told.echo) == (0, True)
    assert not stops_of(peer.hear(140, moving, S + 1)), "not at once again"
    assert not stops_of(peer.hear(140, moving._replace(stopped=True), 2 * S))


def test_each_of_many_stops_is_told_in_turn() -> None:
    """Found by `headland chaos`, profile protocol, seed 2403159: a robot told the first four of five
    stops, again and again; those had been cleared where they were heard, behind a cut, and the fifth
    had not."""
    peer = peer_in(State.IDLE, None)
    peer.hear(140, Member(1, 0, 1), 0)
    dots = {StopDot(slot, 7, counter) for slot in range(2) for counter in range(5)}
    for dot in dots:
        peer.hear(140, EmergencyStop(*dot, 1, False, 0, 0), 0)
    assert peer.safety.stops.active == dots
    moving = Pose(0.0, 0.0, 0.0, 2.0, State.WORKING, False, 0)
    told = [stops_of(peer.hear(140, moving, turn * S)) for turn in range(1, 4)]
    assert {StopDot(*stop[:3]) for stops in told for stop in stops} == dots


@pytest.mark.parametrize("stood", [False, True])
def test_who_stood_before_a_press_has_to_say_that_stop(stood: bool) -> None:
    """Found by `headland chaos`, profile protocol, seed 203087: the only other robot stood already, had
    not heard the stop, and passed for one that had; then the one that was pressed lost its memory."""
    peer = peer_in(State.IDLE, None)
    peer.hear(140, Member(1, 0, 1), 0)
    pose = Pose(0.0, 0.0, 0.0, 0.0, State.EMERGENCY_STOP, True, 0)
    peer.hear(140, pose._replace(stopped=stood), 0)
    (stop,) = stops_of(peer.press(Reason.PERSON_IN_FIELD, 0))
    peer.hear(140, pose, MS)
    assert bool(stops_of(peer.safety.tick(STOP_REPEAT_US))) is stood
    peer.hear(140, stop._replace(echo=True), STOP_REPEAT_US)
    assert not stops_of(peer.safety.tick(2 * STOP_REPEAT_US))


def test_a_life_without_memory_names_its_stops_anew() -> None:
    """Found by `headland chaos`, profile protocol, seed 806733: the new incarnation, 39681, had the low
    byte of the first, which is all that a stop says of it."""
    names = set()
    for incarnation in (1, 39681, 39682):
        safety = Safety(0, incarnation, SilencePolicy.STOP, None, {}, 0)
        (stop,) = stops_of(safety.press(Reason.PERSON_IN_FIELD, 0))
        names.add((stop.incarnation, stop.counter))
    assert len(names) == 3
