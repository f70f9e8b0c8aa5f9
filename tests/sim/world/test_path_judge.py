"""The judge of path files finds each fault that the rules know."""

import pytest

from sim.world.path_judge import judge_paths

DRAWING = "type octile\nheight 2\nwidth 3\nmap\n...\n.@.\n"


def verdict(*steps: str, starts: str = "(0,0),(2,0)", goals: str = "(1,0),(2,1)") -> list[str]:
    lines = [f"{t}:{step}," for t, step in enumerate(steps)]
    text = "\n".join([f"starts={starts}", f"goals={goals}", "solution=", *lines, ""])
    return judge_paths(text, DRAWING).faults


def test_a_plan_has_no_fault() -> None:
    assert verdict("(0,0),(2,0)", "(1,0),(2,1)") == []


@pytest.mark.parametrize(
    ("steps", "fault"),
    [
        (["(1,0),(2,0)", "(1,0),(2,1)"], "starts"),
        (["(0,0),(2,0)", "(0,0),(2,1)"], "agent 0 does not end"),
        (["(0,0),(2,0)", "(1,0),(1,0)"], "in one cell"),
        (["(0,0),(2,0)", "(2,0),(2,1)", "(1,0),(2,1)"], "jumps"),
        (["(0,0),(2,0)", "(0,0),(1,0)", "(1,0),(0,0)"], "change places"),
        (["(0,0),(2,0)", "(1,0),(2,0)", "(1,1),(2,1)", "(1,0),(2,1)"], "in a wall"),
    ],
)
def test_each_fault_is_found(steps: list[str], fault: str) -> None:
    assert any(fault in each for each in verdict(*steps)), steps


def test_what_is_no_file_of_paths_is_a_value_error() -> None:
    for text in ("", "starts=\nsolution=\n", "starts=(0,0),\ngoals=(0,0),\nsolution=\n0:\n"):
        with pytest.raises(ValueError):
            judge_paths(text, DRAWING)
