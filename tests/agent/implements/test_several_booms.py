"""An implement with several booms, each with condensed states of its own (ISO 11783-10)."""

from struct import pack

import numpy as np

from agent.implements.section_control import SectionedImplement
from protocol.device_description import CONDENSED_WORK_STATE, SETPOINT_CONDENSED
from protocol.device_pool import read_pool

STATES, SETPOINTS, MORE_STATES, MORE_SETPOINTS = 1, 2, 3, 4  # object numbers
FRONT, REAR = 2, 3  # elements


def text(words: str) -> bytes:
    return bytes((len(words),)) + words.encode()


def element(number: int, kind: int, at: int, parent: int, children: list[int]) -> bytes:
    """A DET. `number`: of the object. `at`: of the element. `parent`, `children`: of objects."""
    head = b"DET" + pack("<HB", number, kind) + text("e") + pack("<HHH", at, parent, len(children))
    return head + pack(f"<{len(children)}H", *children)


def two_booms(front: int, rear: int) -> SectionedImplement:
    """So many sections each, one metre wide and numbered in turn as far as both booms have them."""
    out = b"DVC" + pack("<H", 0) + text("d") + text("1") + pack("<Q", 7) + text("s")
    out += b"l" * 7 + b"e" * 7 + b"\x00"
    condensed = ((STATES, 161), (SETPOINTS, 290), (MORE_STATES, 162), (MORE_SETPOINTS, 291))
    for number, data in condensed:
        out += b"DPD" + pack("<HHBB", number, data, 2, 8) + text("c") + pack("<H", 0xFFFF)
    out += b"DPT" + pack("<HHi", 9, 67, 1000) + text("w") + pack("<H", 0xFFFF)
    out += element(100, 1, 1, 0, [])
    words = [STATES, SETPOINTS, MORE_STATES, MORE_SETPOINTS]
    out += element(101, 2, FRONT, 100, words[: 2 if front <= 16 else 4])
    out += element(102, 2, REAR, 100, words[: 2 if rear <= 16 else 4])
    for k in range(front):
        out += element(200 + k, 4, 10 + 2 * k, 101, [9])
    for k in range(rear):
        out += element(300 + k, 4, 11 + 2 * k, 102, [9])
    pool = read_pool(out, 4)
    assert pool is not None
    return SectionedImplement(pool, {})


def states(number: int) -> list[int]:
    """The sixteen states of a condensed value."""
    return [number >> 2 * k & 3 for k in range(16)]


def test_each_boom_is_told_its_own_sections_and_not_only_the_first() -> None:
    implement = two_booms(3, 2)  # elements 10, 12, 14 in front, 11, 13 behind
    assert [section.element for section in implement.sections] == [10, 11, 12, 13, 14]
    implement.wanted = np.array([True, False, False, True, True])
    told = dict(implement.setpoints(np.ones(5, np.bool_)))
    assert states(told[FRONT, SETPOINT_CONDENSED])[:4] == [1, 0, 1, 3]
    assert states(told[REAR, SETPOINT_CONDENSED])[:3] == [0, 1, 3]
    assert len(told) == 2


def test_each_boom_tells_the_states_of_its_own_sections() -> None:
    implement = two_booms(3, 2)
    assert sorted(implement.measured()) == [
        (FRONT, CONDENSED_WORK_STATE),
        (REAR, CONDENSED_WORK_STATE),
    ]
    implement.heard((FRONT, CONDENSED_WORK_STATE), 0b110101 | ~0x3F)
    implement.heard((REAR, CONDENSED_WORK_STATE), 0b0100 | ~0xF)
    assert implement.actual.tolist() == [True, False, True, True, False]


def test_a_wide_boom_has_further_words_of_its_own() -> None:
    implement = two_booms(2, 18)
    implement.wanted = np.array([True] * 20)
    told = dict(implement.setpoints(np.ones(20, np.bool_)))
    assert states(told[FRONT, SETPOINT_CONDENSED]) == [1, 1] + [3] * 14
    assert states(told[REAR, SETPOINT_CONDENSED]) == [1] * 16
    assert states(told[REAR, SETPOINT_CONDENSED + 1]) == [1, 1] + [3] * 14
    implement.heard((REAR, CONDENSED_WORK_STATE + 1), 0b0101 | ~0xF)
    assert np.flatnonzero(implement.actual).tolist() == [18, 19]
