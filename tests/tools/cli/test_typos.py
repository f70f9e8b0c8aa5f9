"""Wrong words of a scenario: one line with what and where, never a traceback, never silence."""

import pytest

from tools.bench.typos import CASES, ToldOfTypo, answers


@pytest.fixture(scope="module")
def told() -> dict[tuple[str, ...], ToldOfTypo]:
    return dict(answers())


def test_there_are_as_many_as_the_issue_asks_for() -> None:
    assert len(set(CASES)) == len(CASES) >= 25 + 40


@pytest.mark.parametrize("case", CASES, ids=lambda case: case[1])
def test_a_typo_is_one_line_that_names_it(
    case: tuple[str, ...], told: dict[tuple[str, ...], ToldOfTypo]
) -> None:
    assert told[case].good, told[case].text or "it was taken without a word"
