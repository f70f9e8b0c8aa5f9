"""State machines as data: one total table per machine, and one way to move.

A table is written as rows, one per state, with one column per event. `None` means that the event
is deliberately ignored. Guards stay outside: the caller decides which event happened, the table
decides what it means (after python-hyper/h11, `_state.py`).
"""

from collections.abc import Mapping
from enum import Enum
from typing import Generic, TypeVar

S = TypeVar("S", bound=Enum)
E = TypeVar("E", bound=Enum)


def matrix(events: type[E], *rows: tuple[S | None, ...]) -> dict[tuple[S, E], S]:
    """Read rows of (source, target on 1st event, target on 2nd event, ...) into a total table.

    None as a target means that the state stays. Raises AssertionError if a row has another number
    of targets than there are events, or if a state has no row.
    """
    table: dict[tuple[S, E], S] = {}
    for source, *targets in rows:
        assert source is not None
        assert len(targets) == len(events), f"{source.name}: {len(targets)} of {len(events)} events"
        for event, target in zip(events, targets, strict=True):
            table[source, event] = target if target is not None else source
    states = {source for source, _ in table}
    assert states == set(type(next(iter(states)))), "a state has no row"
    return table


class StateMachine(Generic[S, E]):
    """A current state and the table it moves by."""

    def __init__(self, name: str, table: Mapping[tuple[S, E], S], start: S) -> None:
        self.name, self.table, self.state = name, table, start

    def fire(self, event: E) -> tuple[S, S]:
        """Move by the table; returns (source, target), which are equal for an ignored event."""
        source = self.state
        self.state = self.table[source, event]
        return source, self.state


def edges(table: Mapping[tuple[S, E], S], source: S) -> list[tuple[S, list[E]]]:
    """The other states that can follow `source`, in the order of their definition, each with the
    events that lead there."""
    found: dict[S, list[E]] = {}
    for (state, event), target in table.items():
        if state is source and target is not source:
            found.setdefault(target, []).append(event)
    return [(state, found[state]) for state in type(source) if state in found]


def to_mermaid(table: Mapping[tuple[S, E], S], start: S) -> str:
    """The Mermaid state diagram of a table, without ignored events."""
    edges = [
        f"    {a.name} --> {b.name}: {e.name.lower()}" for (a, e), b in table.items() if a is not b
    ]
    return "\n".join(["stateDiagram-v2", f"    [*] --> {start.name}", *edges])
