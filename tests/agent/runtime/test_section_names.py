"""Names of sections and their numbers on the wire."""

import pytest

from agent.runtime.section_names import NAMED_FIRST, SectionNames


def test_names_of_the_convention_are_one_section() -> None:
    names = SectionNames()
    assert {names.number(name) for name in ("S7", "s7", "section_7", "Section 7", "7", "S07")} == {
        7
    }
    assert names.name(7) == "S7" and names.name(8) == "S8"


def test_another_name_has_a_number_of_the_upper_half() -> None:
    names = SectionNames()
    assert names.number("north") == names.number("north") >= NAMED_FIRST
    with pytest.raises(ValueError, match="needs a name"):
        names.number("")


@pytest.mark.parametrize(
    ("one", "other"), [("north 7", "south 7"), ("S7", "north_7"), ("7", "row-7")]
)
def test_i25_names_that_end_in_one_number_are_not_one_section(one: str, other: str) -> None:
    """Both were section 7 without a word, so the second one counted as done with the first."""
    names = SectionNames()
    assert names.number(one) == names.number(one) == 7
    with pytest.raises(ValueError, match="collide"):
        names.number(other)
    assert names.name(7) == one
