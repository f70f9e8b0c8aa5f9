"""The state machine of the project brief, edge by edge, and the additions we made.

Then every state with every event and every cause, on a peer: it reacts as docs/use/stopping.md says.
"""

from collections.abc import Callable
from itertools import product
from math import hypot
from typing import Any

import pytest

from agent.interface.config import S
from agent.interface.effects import HALT, Drive
from agent.interface.identity import SilencePolicy
from agent.interface.lifecycle import TABLE, Event, State
from agent.peer.inputs import BusState, DiskFailed, Heard, Leave, ManualReset, Press, Start, Timer
from agent.peer.notices import ControlDue
from agent.peer.peer import Peer
from agent.safety.stop_cause import Severity, StopCause
from agent.safety.stop_controller import CREEP_M_S
from protocol.controller_health import Health
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import EmergencyReset, Reason
from protocol.state_machine import to_mermaid
from tests.agent.lone_peer import held_by, pass_time, peer_in

# Copied from the diagram of the project brief by hand: (source, event, target).
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


# ---------------------------------------------------------------- every state, event and cause


@pytest.mark.parametrize("cause", [None, *StopCause], ids=lambda c: c.name if c else "no cause")
def test_every_state_event_and_cause(cause: StopCause | None) -> None:
    """Events change the state as the table says and clear no cause; the gate knows causes alone."""
    severity = Severity.CLEAR if cause is None else cause.severity
    wanted = Drive(2.0, 0.0, 0.1, True)
    for state, event in product(State, Event):
        peer = peer_in(state, cause)
        if peer.safety.latched:
            peer.lifecycle.fire(Event.EMERGENCY, "a cause that latches")
        source = State.EMERGENCY_STOP if severity is Severity.LATCHED else state
        assert peer.state is source
        peer.lifecycle.fire(event, "whatever comes")
        assert peer.state is TABLE[source, event]
        assert held_by(peer) == ({cause} if cause else set())
        drive = peer.safety.gate(wanted, 0)
        if severity >= Severity.PAUSE:
            assert drive == HALT and not peer.safety.may_move
        elif severity is Severity.SLOW:
            assert hypot(drive.vx_m_s, drive.vy_m_s) == pytest.approx(CREEP_M_S)
        else:
            assert drive == wanted


@pytest.mark.parametrize("cause", [None, *StopCause], ids=lambda c: c.name if c else "no cause")
def test_what_a_control_period_drives(cause: StopCause | None) -> None:
    """Motion only in IDLE and WORKING, only with no cause above SLOW, the implement not else."""
    for state in State:
        peer = peer_in(state, cause)
        (drive,) = (
            e for e in peer.named.control._control(ControlDue(0), 0) if isinstance(e, Drive)
        )
        moves = state in (State.IDLE, State.WORKING) and peer.safety.may_move
        assert (drive != HALT) is moves, state
        if cause is StopCause.CREEP:
            assert hypot(drive.vx_m_s, drive.vy_m_s) <= CREEP_M_S + 1e-9


# What people, the bus and time can do, and which causes each of them ends in which state; by hand.
Act = Callable[[Peer], Any]
ACTS: dict[str, Act] = {
    "start": lambda peer: peer.step(Start(), 0),
    "manual reset": lambda peer: peer.step(ManualReset(), 0),
    "press": lambda peer: peer.step(Press(Reason.PERSON_IN_FIELD), 0),
    "hold": lambda peer: peer.safety.hold(0),
    "bus lost": lambda peer: peer.step(BusState(Health.OFF, True), 0),
    "bus back": lambda peer: peer.step(BusState(Health.ACTIVE, True), 0),
    "leave": lambda peer: peer.step(Leave(), 0),
    "disk failed": lambda peer: peer.step(DiskFailed(), 0),
    "time": pass_time,
}
ENDED_BY: dict[StopCause, str | None] = {
    StopCause.NOT_STARTED: "start",
    StopCause.OBSTACLE_AHEAD: None,  # by its answer, or when it leaves: tests/chaos/test_pause.py
    StopCause.CREEP: "time",  # here nobody is silent any more
    StopCause.MEMBER_SILENT: "time",
    StopCause.BACKBONE_LOST: None,  # when a segment is reached: tests/sim/rigs/test_segments_rig.py
    StopCause.BACKBONE_CREEP: None,
    StopCause.BUS_OFF: "bus back",
    StopCause.ERROR_PASSIVE: "time",  # the driver says that it is gone
    StopCause.UNHEARD: "time",
    StopCause.SENSES_OLD: "time",  # here they are in time again
    # or when the place changes, which it does not while the robot stands
    StopCause.PLACE_FROZEN: "start",
    StopCause.PLACE_LOST: "time",  # here it stays at one place, which is accurate
    StopCause.SCAN_LOST: None,  # when scans arrive, here there is none: test_range_freshness.py
    StopCause.IMPLEMENT_DOWN: None,  # when it is up, here nothing senses it: test_implement_check.py
    StopCause.ADDRESS_LOST: "time",  # it claims another
    StopCause.CONFIG_MISMATCH: "time",  # the other machine is not heard any more
    StopCause.DUPLICATE_ID: "time",
    StopCause.LATE_TICK: "time",
    StopCause.UNAUTHENTICATED_STOP: "time",
    StopCause.SPENT_STOP: "time",
    StopCause.IMPLEMENTS_STOP: "time",
    StopCause.WORK_OFF: "time",  # here there is no session with a task controller
    StopCause.DISK_ERROR: None,
    StopCause.STOP_DOT: "manual reset",  # here every dot is cleared
    StopCause.BOOT_UNCONFIRMED: "manual reset",
}
RAISED_BY = {
    "press": StopCause.STOP_DOT,
    "hold": StopCause.NOT_STARTED,
    "bus lost": StopCause.BUS_OFF,
    "disk failed": StopCause.DISK_ERROR,
}


@pytest.mark.parametrize("cause", StopCause, ids=lambda c: c.name)
def test_what_ends_each_cause_in_every_state(cause: StopCause) -> None:
    for state, (name, act) in product(State, ACTS.items()):
        latches = cause.severity is Severity.LATCHED
        source = State.EMERGENCY_STOP if latches else state
        peer = peer_in(source, cause)
        act(peer)
        back = cause is StopCause.BUS_OFF and name == "time"  # here its driver reports ACTIVE
        back |= cause is StopCause.PLACE_LOST and name == "start"
        ended = ENDED_BY[cause] == name or back
        expected = (
            (set() if ended else {cause}) | {RAISED_BY[name]}
            if name in RAISED_BY
            else (set() if ended else {cause})
        )
        if (
            name == "manual reset"
            and source is State.EMERGENCY_STOP
            and cause is not StopCause.DISK_ERROR
        ):
            expected |= {StopCause.NOT_STARTED}  # reset is not start
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
    assert held_by(peer) == {StopCause.MEMBER_SILENT}
    safety.on_tick(3 * S - 1)
    assert held_by(peer) == {StopCause.MEMBER_SILENT}, "two seconds without a change first"
    safety.on_tick(3 * S)
    kept = {
        SilencePolicy.STOP: {StopCause.MEMBER_SILENT},
        SilencePolicy.SLOW: {StopCause.CREEP},
        SilencePolicy.CONTINUE: set(),
    }
    assert held_by(peer) == kept[policy]
    safety.members(everybody, frozenset(), 10 * S)
    safety.on_tick(12 * S - 1)
    assert held_by(peer) == kept[policy]
    assert safety.due_at_us == (12 * S if kept[policy] else safety.due_at_us)
    safety.on_tick(12 * S)
    assert held_by(peer) == set(), "heard again, and stable"


def test_a_reset_while_the_bus_is_off_waits_for_the_bus() -> None:
    """Found by `headland chaos`, profile protocol, seed 1689: it took an address that nobody could
    hear of, lost it when the bus came back, and stayed IDLE without one, awake for good."""
    peer = peer_in(State.IDLE, None)
    pass_time(peer, 2 * S)
    assert peer.joining.joined
    peer.step(Press(Reason.PERSON_IN_FIELD), 2 * S)
    peer.step(BusState(Health.OFF, True), 2 * S)
    (dot,) = peer.safety.stops.active
    peer.safety.receive_reset(EmergencyReset(*dot, 200), 2 * S)
    peer.step(ManualReset(), 2 * S)
    assert peer.state is State.DISCONNECTED
    for now_us in range(2 * S, 4 * S, 10_000):
        peer.step(Timer(), now_us)
        assert peer.state is State.DISCONNECTED and not peer.joining.joined
    peer.step(BusState(Health.ACTIVE, True), 4 * S)
    for now_us in range(4 * S, 6 * S, 10_000):
        peer.step(Timer(), now_us)
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
    peer.step(Heard(address, AddressClaimed(peer.identity.name.pack() - 1)), 2 * S)
    for now_us in range(2 * S + late_us, 3 * S, 10_000):
        peer.step(Timer(), now_us)
    assert peer.address not in (None, address)
    assert peer.joining.joined and peer.state is State.IDLE
    assert StopCause.ADDRESS_LOST not in held_by(peer)
