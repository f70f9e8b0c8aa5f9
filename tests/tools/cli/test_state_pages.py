"""The page of states has every state machine of the code."""

import ast
from pathlib import Path

import pytest

from tools.cli.state_pages import COLOURS, MACHINES, Machine, diagram, states

ROOT = Path(__file__).parents[3]


def test_every_table_is_on_the_page() -> None:
    made = {
        path.relative_to(ROOT).as_posix()
        for layer in ("crdt", "protocol", "agent")
        for path in (ROOT / layer).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "matrix"
    }
    assert made == {machine.module for machine in MACHINES}


@pytest.mark.parametrize("machine", MACHINES, ids=lambda m: m.title)
def test_each_picture_has_every_state_and_edge(machine: Machine) -> None:
    svg, order = diagram(machine), type(machine.start)
    assert len(order) <= len(COLOURS)
    assert all(f">{state.name}</text>" in svg for state in order)
    pairs = {(a, b) for (a, _), b in machine.table.items() if a is not b}
    assert svg.count('marker-end="url(#end)"') == len(pairs)
    assert f"]({machine.picture})" in states()
