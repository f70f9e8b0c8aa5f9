"""States of elements above sections: a boom that is off works nothing, and some booms are told theirs."""

from struct import pack

import numpy as np
import pytest

from agent.implements.section_control import SectionedImplement
from protocol.device_description import (
    CONDENSED_WORK_STATE,
    SETPOINT_WORK_STATE,
    SETTABLE,
    WIDTH,
    WORK_STATE,
)
from protocol.device_pool import read_pool
from tests.agent.implements.test_several_booms import element, text

WHOLE, FRONT, REAR = 1, 2, 3  # elements; the first is above the other two
STATES, STATE, BREADTH, SETPOINT = 1, 2, 3, 4  # object numbers


@pytest.fixture
def implement() -> SectionedImplement:
    return made([STATES, STATE])


def made(front: list[int]) -> SectionedImplement:
    """Two booms with two sections each, all of which have said that they are on.

    `front`: objects of the front boom."""
    out = b"DVC" + pack("<H", 0) + text("d") + text("1") + pack("<Q", 7) + text("s")
    out += b"l" * 7 + b"e" * 7 + b"\x00"
    for number, ddi in ((STATES, CONDENSED_WORK_STATE), (STATE, WORK_STATE)):
        out += b"DPD" + pack("<HHBB", number, ddi, 0, 8) + text("v") + pack("<H", 0xFFFF)
    out += b"DPD" + pack("<HHBB", SETPOINT, SETPOINT_WORK_STATE, SETTABLE, 8) + text("s")
    out += pack("<H", 0xFFFF)
    out += b"DPT" + pack("<HHi", BREADTH, WIDTH, 1000) + text("w") + pack("<H", 0xFFFF)
    out += element(100, 1, WHOLE, 0, [STATE])
    out += element(101, 2, FRONT, 100, front) + element(102, 2, REAR, 100, [STATES])
    for k, boom in ((10, 101), (11, 101), (12, 102), (13, 102)):
        out += element(200 + k, 4, k, boom, [BREADTH])
    pool = read_pool(out, 4)
    assert pool is not None
    found = SectionedImplement(pool, {})
    for boom in (FRONT, REAR):
        found.heard((boom, CONDENSED_WORK_STATE), 0b0101 | ~0xF)
    assert found.actual.tolist() == [True] * 4
    return found


def test_sections_below_what_is_off_are_off(implement: SectionedImplement) -> None:
    """Their ground counted as worked, although the boom was raised or its master switch was off."""
    implement.heard((FRONT, WORK_STATE), 0)
    assert implement.actual.tolist() == [False, False, True, True]
    implement.heard((WHOLE, WORK_STATE), 0)
    assert implement.actual.tolist() == [False] * 4
    implement.heard((FRONT, WORK_STATE), 1)
    implement.heard((WHOLE, WORK_STATE), 1)
    assert implement.actual.tolist() == [True] * 4


def test_states_above_sections_are_asked_for(implement: SectionedImplement) -> None:
    states = {(FRONT, CONDENSED_WORK_STATE), (REAR, CONDENSED_WORK_STATE)}
    assert set(implement.measured()) == states | {(WHOLE, WORK_STATE), (FRONT, WORK_STATE)}


def test_a_state_that_is_told_while_the_boom_is_off_is_kept(implement: SectionedImplement) -> None:
    implement.heard((FRONT, WORK_STATE), 0)
    implement.heard((FRONT, CONDENSED_WORK_STATE), 0b0100 | ~0xF)
    implement.heard((FRONT, WORK_STATE), 1)
    assert implement.actual.tolist() == [False, True, True, True]


def test_a_boom_with_a_setpoint_is_on_while_one_of_its_sections_is_to_be_on() -> None:
    """It was never told, so it stayed off, and its sections with it."""
    implement = made([STATES, STATE, SETPOINT])
    every = np.ones(4, np.bool_)
    for wanted, on in (([False, True, False, False], 1), ([False, False, True, True], 0)):
        implement.wanted = np.array(wanted)
        assert dict(implement.setpoints(every))[FRONT, SETPOINT_WORK_STATE] == on


def test_a_boom_without_a_setpoint_is_told_none(implement: SectionedImplement) -> None:
    keys = [key for key, _ in implement.setpoints(np.ones(4, np.bool_))]
    assert (FRONT, SETPOINT_WORK_STATE) not in keys
