"""What holds for every state machine that is written as a total table."""

from collections.abc import Collection, Mapping
from enum import Enum
from itertools import product
from typing import TypeVar

S = TypeVar("S", bound=Enum)
E = TypeVar("E", bound=Enum)


def check_table(
    table: Mapping[tuple[S, E], S], start: S, expected: Collection[tuple[S, E, S]]
) -> None:
    """`expected`: every edge to another state, copied by hand; all other events are ignored."""
    states, events = type(start), type(next(event for _, event in table))
    assert set(table) == set(product(states, events)), "the table is total"
    found = {(a, event, b) for (a, event), b in table.items() if a is not b}
    assert found == set(expected)
    reached, grown = {start}, True
    while grown:
        more = {b for a, _, b in found if a in reached} - reached
        reached, grown = reached | more, bool(more)
    assert reached == set(states), "every state can be reached"
    assert {event for _, event, _ in found} == set(events), "every event changes some state"
