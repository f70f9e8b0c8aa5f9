"""Condensed states are of the sections from left to right (ISO 11783-11), whatever their numbers are."""

from struct import pack

import numpy as np

from agent.implements.section_control import ABSENT, SectionedImplement
from protocol.device_description import (
    CONDENSED_WORK_STATE,
    OFFSET_Y,
    SETPOINT_CONDENSED,
    WIDTH,
)
from protocol.device_pool import read_pool
from tests.agent.implements.test_several_booms import element, states, text

BOOM, FIRST, MIDDLE, LAST = 2, 10, 11, 12  # elements
STATES, SETPOINTS, PLACE, BREADTH = 1, 2, 3, 4  # object numbers
USUAL = {(number, WIDTH): 1000 for number in (FIRST, MIDDLE, LAST)}
FROM_THE_RIGHT = {(FIRST, OFFSET_Y): 1000, (MIDDLE, OFFSET_Y): 0, (LAST, OFFSET_Y): -1000}
FROM_THE_LEFT = {key: -right_mm for key, right_mm in FROM_THE_RIGHT.items()}


def boom(told: dict[tuple[int, int], int]) -> SectionedImplement:
    """Three sections that tell their places and widths."""
    out = b"DVC" + pack("<H", 0) + text("d") + text("1") + pack("<Q", 7) + text("s")
    out += b"l" * 7 + b"e" * 7 + b"\x00"
    kinds = (
        (STATES, CONDENSED_WORK_STATE),
        (SETPOINTS, SETPOINT_CONDENSED),
        (PLACE, OFFSET_Y),
        (BREADTH, WIDTH),
    )
    for number, ddi in kinds:
        out += b"DPD" + pack("<HHBB", number, ddi, 2, 8) + text("v") + pack("<H", 0xFFFF)
    out += element(100, 1, 1, 0, []) + element(101, 2, BOOM, 100, [STATES, SETPOINTS])
    for number in (FIRST, MIDDLE, LAST):
        out += element(200 + number, 4, number, 101, [PLACE, BREADTH])
    pool = read_pool(out, 4)
    assert pool is not None
    return SectionedImplement(pool, told)


def test_sections_that_are_numbered_from_the_right_are_switched_where_they_are() -> None:
    """The leftmost one was told what the rightmost one was to do, and its ground was left out."""
    implement = boom(USUAL | FROM_THE_RIGHT)
    at = {section.element: k for k, section in enumerate(implement.sections)}
    implement.wanted = np.array([k == at[LAST] for k in range(3)])  # the leftmost one
    told = dict(implement.setpoints(np.ones(3, np.bool_)))
    assert states(told[BOOM, SETPOINT_CONDENSED]) == [1, 0, 0] + [ABSENT] * 13
    implement.heard((BOOM, CONDENSED_WORK_STATE), 0b000001 | ~0x3F)
    assert implement.actual.tolist() == [k == at[LAST] for k in range(3)]


def test_a_section_that_is_folded_keeps_its_place_among_the_others() -> None:
    """A folded section tells no width. All sections to its right were taken for the next one."""
    implement = boom(USUAL | FROM_THE_LEFT | {(FIRST, WIDTH): 0})
    assert [section.element for section in implement.sections] == [MIDDLE, LAST]
    implement.wanted = np.array([True, False])
    told = dict(implement.setpoints(np.ones(2, np.bool_)))
    assert states(told[BOOM, SETPOINT_CONDENSED]) == [ABSENT, 1, 0] + [ABSENT] * 13
    implement.heard((BOOM, CONDENSED_WORK_STATE), 0b010001 | ~0x3F)
    assert implement.actual.tolist() == [False, True]


def test_sections_whose_places_are_not_told_are_in_the_order_of_their_numbers() -> None:
    implement = boom(USUAL | {(FIRST, OFFSET_Y): 1000})
    implement.wanted = np.array([section.element == FIRST for section in implement.sections])
    told = dict(implement.setpoints(np.ones(3, np.bool_)))
    assert states(told[BOOM, SETPOINT_CONDENSED])[:3] == [1, 0, 0]


def test_an_implement_whose_sections_are_all_folded_is_told_nothing() -> None:
    implement = boom(FROM_THE_LEFT)
    assert implement.setpoints(np.ones(0, np.bool_)) == []
