"""Tables of state machines, on one of a door."""

from enum import Enum, auto

import pytest

from protocol.state_machine import StateMachine, edges, matrix, to_mermaid


class Door(Enum):
    OPEN = auto()
    SHUT = auto()
    LOCKED = auto()


class Act(Enum):
    PUSH = auto()
    TURN = auto()
    KICK = auto()


TABLE = matrix(
    Act,
    (Door.OPEN, Door.SHUT, None, Door.SHUT),
    (Door.SHUT, Door.OPEN, Door.LOCKED, Door.OPEN),
    (Door.LOCKED, None, Door.SHUT, None),
)


def test_a_table_with_a_hole_is_refused() -> None:
    with pytest.raises(AssertionError, match="a state has no row"):
        matrix(Act, (Door.OPEN, *[None] * len(Act)))
    with pytest.raises(AssertionError, match="1 of 3 events"):
        matrix(Act, (Door.OPEN, None))


def test_a_machine_moves_by_its_table_and_ignores_the_rest() -> None:
    machine = StateMachine("door", TABLE, Door.OPEN)
    assert machine.fire(Act.TURN) == (Door.OPEN, Door.OPEN)
    assert machine.fire(Act.PUSH) == (Door.OPEN, Door.SHUT)
    assert machine.fire(Act.TURN) == (Door.SHUT, Door.LOCKED)
    assert machine.state is Door.LOCKED


def test_edges_name_all_events_that_lead_to_a_state() -> None:
    assert edges(TABLE, Door.OPEN) == [(Door.SHUT, [Act.PUSH, Act.KICK])]
    assert edges(TABLE, Door.SHUT) == [(Door.OPEN, [Act.PUSH, Act.KICK]), (Door.LOCKED, [Act.TURN])]


def test_the_diagram_has_every_edge_and_no_ignored_event() -> None:
    lines = to_mermaid(TABLE, Door.OPEN).splitlines()
    assert lines[:2] == ["stateDiagram-v2", "    [*] --> OPEN"]
    assert len(lines) == 2 + 6 and "    LOCKED --> SHUT: turn" in lines
