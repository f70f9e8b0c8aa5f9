"""The state machine of the mission's document, edge by edge, and the additions we made."""

from itertools import product

import pytest

from agent.fsm import Machine, matrix, to_mermaid
from agent.lifecycle import TABLE, Event, State

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
