"""The figures about the sources, and that their counters find what they count."""

import ast

import pytest

from tools.bench.house import figures, lines_of_code, modules_in_cycles, twice


@pytest.mark.slow
def test_every_figure_about_the_sources_holds() -> None:
    missed = [figure for figure in figures(quick=True) if figure.holds is False]
    assert not missed, missed


def test_cycles_and_doubles_are_found() -> None:
    assert modules_in_cycles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}, "e": set()}) == 3
    assert modules_in_cycles({"a": {"b"}, "b": {"c"}, "c": set()}) == 0
    one, other = ast.parse("class Route: ..."), ast.parse("class Route: ...\nclass Lane: ...")
    assert twice({"agent.paths.a": one, "agent.paths.b": other}) == 1
    assert twice({"agent.paths.a": one, "agent.field.b": other}) == 0


def test_lines_of_code_leave_comments_and_docstrings_out() -> None:
    statement = "NAME = (\n    1,\n)\n"
    function = 'def f() -> int:\n    """One."""\n    return NAME[0]\n'
    text = f'"""What it is."""\n\n# why\n{statement}\n\n{function}'
    assert lines_of_code(text) == 3 + 2
