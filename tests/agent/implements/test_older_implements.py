"""Implements from before 2012: their actual work states are set, as the data dictionary had no others."""

from struct import pack

import numpy as np
import pytest

from agent.implements.section_control import ABSENT, SectionedImplement
from protocol.device_description import (
    CONDENSED_WORK_STATE,
    SETPOINT_WORK_STATE,
    WIDTH,
    WORK_STATE,
)
from protocol.device_pool import read_pool
from tests.agent.implements.test_several_booms import element, states, text

BOOM, FIRST, SECOND = 2, 10, 11  # elements
STATE, BREADTH, SETPOINT = 1, 2, 3  # object numbers
SETTABLE = 2


def implement(condensed: bool, properties: int, with_setpoints: bool = False) -> SectionedImplement:
    """Two sections of a metre. `properties`: of their actual work states."""
    out = b"DVC" + pack("<H", 0) + text("d") + text("1") + pack("<Q", 7) + text("s")
    out += b"l" * 7 + b"e" * 7
    ddi = CONDENSED_WORK_STATE if condensed else WORK_STATE
    out += b"DPD" + pack("<HHBB", STATE, ddi, properties, 8) + text("v") + pack("<H", 0xFFFF)
    out += b"DPT" + pack("<HHi", BREADTH, WIDTH, 1000) + text("w") + pack("<H", 0xFFFF)
    setpoint = pack("<HHBB", SETPOINT, SETPOINT_WORK_STATE, SETTABLE, 8)
    out += b"DPD" + setpoint + text("v") + pack("<H", 0xFFFF)
    own = [BREADTH] + [STATE] * (not condensed) + [SETPOINT] * with_setpoints
    out += element(100, 1, 1, 0, []) + element(101, 2, BOOM, 100, [STATE] * condensed)
    out += element(200, 4, FIRST, 101, own) + element(201, 4, SECOND, 101, own)
    pool = read_pool(out, 3)
    assert pool is not None
    found = SectionedImplement(pool, {})
    found.wanted = np.array([True, False])
    return found


def test_condensed_states_that_can_be_set_switch_the_sections() -> None:
    """Such an implement was put to automatic and then told nothing, so it stayed off for good."""
    told = dict(implement(True, SETTABLE).setpoints(np.ones(2, np.bool_)))
    assert list(told) == [(BOOM, CONDENSED_WORK_STATE)]
    assert states(told[BOOM, CONDENSED_WORK_STATE]) == [1, 0] + [ABSENT] * 14


def test_states_of_sections_that_can_be_set_switch_them() -> None:
    told = implement(False, SETTABLE).setpoints(np.ones(2, np.bool_))
    assert told == [((FIRST, WORK_STATE), 1), ((SECOND, WORK_STATE), 0)]


@pytest.mark.parametrize("properties", [0, SETTABLE])
def test_setpoints_are_used_where_they_are_described(properties: int) -> None:
    told = implement(False, properties, with_setpoints=True).setpoints(np.ones(2, np.bool_))
    assert told == [((FIRST, SETPOINT_WORK_STATE), 1), ((SECOND, SETPOINT_WORK_STATE), 0)]


def test_states_that_are_only_told_are_not_set() -> None:
    assert implement(True, 0).setpoints(np.ones(2, np.bool_)) == [
        ((FIRST, SETPOINT_WORK_STATE), 1),
        ((SECOND, SETPOINT_WORK_STATE), 0),
    ], "the session sends nothing that is not described"
