"""What is said of a wrong value in a file."""

from typing import Annotated

import pytest
from pydantic import BaseModel, Field, ValidationError

from agent.runtime.declared_values import FleetTable, first_error


class Values(BaseModel):
    speed_m_s: float = Field(default=1.0, gt=0, le=4)
    port: int = Field(default=1, ge=1, lt=65536)
    seed: int = Field(default=1, ge=0, le=2**63 - 1)
    route: list[tuple[float, float]] = Field(default=[(0.0, 0.0)], min_length=1, max_length=3)
    name: Annotated[str, Field(min_length=1, max_length=8)] = "a"


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"speed_m_s": 9.0}, "speed_m_s: should be 4 or less, not 9.0"),
        ({"speed_m_s": 0.0}, "speed_m_s: should be more than 0, not 0.0"),
        ({"port": 70000}, "port: should be less than 65536, not 70000"),
        ({"port": 0}, "port: should be 1 or more, not 0"),
        ({"seed": 2**63}, "seed: should be 9223372036854775807 or less, not 9223372036854775808"),
        ({"route": []}, "route: should have 1 or more items, has 0"),
        ({"route": [(1, 2)] * 4}, "route: should have 3 or fewer items, has 4"),
        ({"route": [(1, 2, 3)]}, "route.0: should have 2 or fewer items, has 3"),
        ({"name": ""}, "name: should have 1 or more characters, not ''"),
        ({"name": "much too long"}, "name: should have 8 or fewer characters, not 'much too long'"),
    ],
)
def test_a_value_out_of_its_range_is_told_without_the_words_of_the_validator(
    given: dict[str, object], told: str
) -> None:
    """`tuple should have at most 2 items after validation, not 3, not [1.0, 0.0, 3.0]`."""
    with pytest.raises(ValidationError) as problem:
        Values.model_validate(given)
    assert first_error(problem.value, Values) == told


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"robots": True}, "robots: not a whole number: True"),
        ({"robots": "3"}, "robots: not a whole number: '3'"),
        ({"radius_m": True}, "radius_m: not a number: True"),
        ({"radius_m": "0.8"}, "radius_m: not a number: '0.8'"),
        ({"asks": 1}, "asks: not true or false: 1"),
        ({"asks": "yes"}, "asks: not true or false: 'yes'"),
    ],
)
def test_a_value_of_another_kind_is_not_converted(given: dict[str, object], told: str) -> None:
    """`robots = true` was a fleet of one robot."""
    with pytest.raises(ValidationError) as problem:
        FleetTable.model_validate(given)
    assert first_error(problem.value, FleetTable) == told


def test_a_whole_number_is_a_number() -> None:
    assert FleetTable.model_validate({"radius_m": 1}).radius_m == 1.0
