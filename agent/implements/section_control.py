"""Which sections of an implement are on: those that will be over ground that nobody has worked.

A section is switched early by the time that it needs. It is switched on if any ground of its next
control period is free, and off when none is: rather an overlap than a gap.
"""

from collections.abc import Mapping, Sequence
from math import ceil, cos, hypot, pi, remainder, sin
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.implements.as_applied_map import AsAppliedMap, Points
from agent.interface.config import MS, S
from agent.interface.observation import Observation
from protocol.device_description import (
    CONDENSED_WORK_STATE,
    OFFSET_X,
    OFFSET_Y,
    ON_CHANGE,
    SECTION_CONTROL_STATE,
    SETPOINT_CONDENSED,
    SETPOINT_WORK_STATE,
    SETTABLE,
    WIDTH,
    WORK_STATE,
)
from protocol.device_pool import BoomSection, DevicePool
from protocol.task_client import Key

LATENCY: Final = 142  # DDI: from a setpoint to its effect, ms
TURN_ON_TIME, TURN_OFF_TIME = 205, 206  # DDI, of a section, ms
PLACES: Final = frozenset((OFFSET_X, OFFSET_Y, WIDTH))
TIMES: Final = frozenset((LATENCY, TURN_ON_TIME, TURN_OFF_TIME))
TIME_MAX_MS: Final = 60_000  # no section needs so long; a longer time is not believed
CONTROL_PERIOD_US: Final = 50 * MS
ACROSS_M: Final = 0.1  # between two places of a section that are looked at
ALONG_M: Final = 0.05
TOUCH_M: Final = 0.002  # places are told in millimetres
# A longer way between two fixes is not painted, because the place has jumped. At 10 m/s a receiver with
# 5 Hz has such ways. With fewer fixes a way may be longer, by `FURTHER` than what the speed and the turn
# explain.
STEP_MAX_M: Final = 2.0
STEP_MAX_US: Final = 1500 * MS  # between two fixes of a receiver with 1 Hz, of which one is late
FURTHER: Final = 1.5
SPEED_MIN_M_S: Final = 0.1  # slower, no section is switched
PER_WORD: Final = 16  # sections in one condensed state
OFF, ON, ABSENT = 0, 1, 3  # two bits of one section


class SectionedImplement:
    """One implement: where its sections are, what they do and what they are told."""

    def __init__(self, pool: DevicePool, told: Mapping[Key, int]) -> None:
        """`told`: values that it has told of its places and widths. It may have no sections."""
        self.pool, self.sections = pool, pool.sections(told)
        self.refused = pool.refused_sections(told)  # sections whose widths are not believed
        self._known: dict[Key, int] = {**pool.fixed, **told}
        self.on_for_us = self.off_for_us = 0
        self._take_times()
        self.actual = np.zeros(len(self.sections), np.bool_)
        self._told_on = np.zeros(len(self.sections), np.bool_)  # each by itself
        # Elements above each section that have a work state; while one of them is off, it is off, too.
        self._above = [
            [each for each in pool.above(section.element) if (each, WORK_STATE) in pool.properties]
            for section in self.sections
        ]
        self._off: set[int] = set()  # those that have said to be off
        # Elements above sections that are told a state of their own, and the sections below each.
        self._told_above: dict[int, list[int]] = {}
        for k, section in enumerate(self.sections):
            for each in pool.above(section.element):
                if pool.properties.get((each, SETPOINT_WORK_STATE), 0) & SETTABLE:
                    self._told_above.setdefault(each, []).append(k)
        self.wanted = np.zeros(len(self.sections), np.bool_)
        # Condensed values, and the sections that each is of; None: one whose place is not known.
        order = pool.section_order(told)
        self._told_words = _words(pool, self.sections, order, SETPOINT_CONDENSED)
        self._state_words = _words(pool, self.sections, order, CONDENSED_WORK_STATE)
        if not self._told_words and not any(
            (section.element, SETPOINT_WORK_STATE) in pool.properties for section in self.sections
        ):  # before 2012 the states themselves were set
            self._told_words = {
                key: of for key, of in self._state_words.items() if pool.properties[key] & SETTABLE
            }
        # The last fix, and the left and right ends of the sections then.
        self._before: tuple[Observation, Points, Points] | None = None
        self._ahead_m = np.array([s.ahead_mm / 1000 for s in self.sections])
        self._right_m = np.array([s.right_mm / 1000 for s in self.sections])
        self._half_m = np.array([s.width_mm / 2000 for s in self.sections])
        left, right = self._right_m - self._half_m, self._right_m + self._half_m
        self._touches = np.abs(left - np.roll(right, 1)) < TOUCH_M
        self._touches &= self._ahead_m == np.roll(self._ahead_m, 1)
        # Places under each section that are looked at, and whose they are.
        counts = [max(2, round(2 * half_m / ACROSS_M)) for half_m in self._half_m.tolist()]
        self._owner = np.repeat(np.arange(len(counts)), counts)
        shares = [np.arange(n) / n + 0.5 / n for n in counts]
        share = np.concatenate(shares) if shares else np.empty(0)
        at = self._owner
        self._spots_m = self._ahead_m[at], left[at] + share * 2 * self._half_m[at]

    def recall(self, before: "SectionedImplement") -> None:
        """Take over the states that it had before its places or widths changed."""
        at = {section.element: k for k, section in enumerate(before.sections)}
        for k, section in enumerate(self.sections):
            was = at.get(section.element)
            if was is not None:
                self._told_on[k], self.wanted[k] = before._told_on[was], before.wanted[was]
        self._off = set(before._off)
        self._take_states()

    def heard(self, key: Key, number: int) -> None:
        """It has told a value: the states of its sections are among them."""
        element, ddi = key
        for place, k in enumerate(self._state_words.get(key, ())):
            if k is not None:
                self._told_on[k] = number >> 2 * place & 3 == ON
        if ddi == WORK_STATE:
            for k, section in enumerate(self.sections):
                if section.element == element:
                    self._told_on[k] = number == ON
            if number == OFF and any(element in each for each in self._above):
                self._off.add(element)
            else:
                self._off.discard(element)
        self._take_states()
        if ddi in TIMES and self.pool.describes(key):
            self._known[key] = number
            self._take_times()

    def changes_places(self, key: Key, number: int) -> bool:
        """Whether this value is a place or a width that it has not told before."""
        if key[1] not in PLACES or not self.pool.describes(key) or self._known.get(key) == number:
            return False
        self._known[key] = number
        return True

    def _take_states(self) -> None:
        below_off = [not self._off.isdisjoint(each) for each in self._above]
        self.actual = self._told_on & ~np.array(below_off, np.bool_)

    def _take_times(self) -> None:
        latency_ms = _time_ms(self._known, LATENCY)
        self.on_for_us = (_time_ms(self._known, TURN_ON_TIME) or latency_ms) * MS
        self.off_for_us = (_time_ms(self._known, TURN_OFF_TIME) or latency_ms) * MS

    # ---------------------------------------------------------------- ground

    def worked(
        self, here: Observation, ahead_m: float, ground: AsAppliedMap, on: NDArray[np.bool_]
    ) -> list[tuple[int, int]]:
        """Paint the ground between the last fix and this one under sections that are on.

        `ahead_m`: of the hitch, from the place. `on`: (n,), since the last fix. Returns the cells that
        are whole now: none for a fix from before the last one, as a late one that comes after a word."""
        if self._before is not None and here.sensed_at_us <= self._before[0].sensed_at_us:
            return []
        left = _placed(here, ahead_m + self._ahead_m, self._right_m - self._half_m)
        right = _placed(here, ahead_m + self._ahead_m, self._right_m + self._half_m)
        before, self._before = self._before, (here, left, right)
        cells: list[tuple[int, int]] = []
        if before is None or not self.sections:
            return cells
        was, was_left, was_right = before
        for first, last in self._runs(on):
            steps_m = np.hypot(*(left[[first, last]] - was_left[[first, last]]).T)
            reach_m = np.abs(self._right_m[[first, last]]).max() + abs(ahead_m)
            if steps_m.max() <= _step_max_m(was, here, float(reach_m)):
                corners = np.array((was_left[first], was_right[last], right[last], left[first]))
                cells += ground.paint(corners)
        return cells

    def _runs(self, on: NDArray[np.bool_]) -> list[tuple[int, int]]:
        """First and last of sections that are on side by side, without a gap between them."""
        runs: list[tuple[int, int]] = []
        for k in np.flatnonzero(on).tolist():
            if runs and runs[-1][1] == k - 1 and self._touches[k]:
                runs[-1] = runs[-1][0], k
            else:
                runs.append((k, k))
        return runs

    def decide(
        self, here: Observation, ahead_m: float, ground: AsAppliedMap, now_us: int
    ) -> NDArray[np.bool_]:
        """Which sections are to be on, (n,); as before while the implement stands."""
        speed_m_s = float(np.hypot(here.vx_m_s, here.vy_m_s))
        if not self.sections or speed_m_s < SPEED_MIN_M_S:
            return self.wanted
        age_us = now_us - here.sensed_at_us
        spots = _placed(here, ahead_m + self._spots_m[0], self._spots_m[1])
        step_m = speed_m_s * CONTROL_PERIOD_US / S
        towards = np.array((here.vx_m_s, here.vy_m_s)) / speed_m_s
        opened_m = speed_m_s * (age_us + self.on_for_us) / S
        closed_m = speed_m_s * (age_us + self.off_for_us) / S
        free_on = self._free(spots, towards, opened_m, opened_m + step_m, ground)
        free_off = self._free(spots, towards, closed_m - step_m, closed_m + step_m, ground)
        return np.where(self.wanted, free_off, free_on)

    def _free(
        self, spots: Points, towards: NDArray[np.float64], from_m: float, to_m: float,
        ground: AsAppliedMap,
    ) -> NDArray[np.bool_]:  # fmt: skip
        """Whether any ground is free under each section on this way ahead."""
        along = np.linspace(from_m, to_m, max(2, ceil((to_m - from_m) / ALONG_M) + 1))
        points = (spots[:, None, :] + along[None, :, None] * towards).reshape(-1, 2)
        free = ground.needs(points).reshape(len(spots), -1).any(axis=1)
        return np.bincount(self._owner[free], minlength=len(self.sections)) > 0

    # ---------------------------------------------------------------- setpoints

    def automatic(self) -> list[tuple[Key, int]]:
        """What switches its section control to automatic."""
        return [
            ((element, SECTION_CONTROL_STATE), 1)
            for element in self.pool.found(SECTION_CONTROL_STATE)
        ]

    def setpoints(self, of: NDArray[np.bool_]) -> list[tuple[Key, int]]:
        """What tells it the wanted states: condensed where it has them.

        `of`: (n,), True for the sections that are said again where each has a state of its own. An
        element above them that is told a state is on while one of them is to be on."""
        above = [
            ((element, SETPOINT_WORK_STATE), int(self.wanted[below].any()))
            for element, below in self._told_above.items()
        ]
        if self._told_words:
            words = self._told_words.items()
            return above + [(key, self._condensed(of_word)) for key, of_word in words]
        return above + [
            (self._setpoint_of(self.sections[k].element), int(self.wanted[k]))
            for k in np.flatnonzero(of).tolist()
        ]

    def _setpoint_of(self, element: int) -> Key:
        """What switches the section of this element, which has a state of its own."""
        state = element, WORK_STATE
        older = (element, SETPOINT_WORK_STATE) not in self.pool.properties
        return state if older and state in self.pool.properties else (element, SETPOINT_WORK_STATE)

    def measured(self) -> Sequence[Key]:
        """The values that say what its sections do, and what is above them."""
        found = list(self._state_words)
        found = found or [(section.element, WORK_STATE) for section in self.sections]
        above = {element for each in self._above for element in each}
        return [*found, *((element, WORK_STATE) for element in sorted(above))]

    def times(self) -> Sequence[Key]:
        """The values that say how long its sections take; people change them while it works."""
        return [key for key in self.pool.properties if key[1] in TIMES]

    def told_places(self) -> Sequence[Key]:
        """The places and widths that it tells when they change, as while it unfolds."""
        triggers = self.pool.triggers
        return [key for key in triggers if key[1] in PLACES and triggers[key] & ON_CHANGE]

    def _condensed(self, of_word: Sequence[int | None]) -> int:
        number = 0
        for place in range(PER_WORD):
            state, k = ABSENT, of_word[place] if place < len(of_word) else None
            if k is not None:
                state = ON if self.wanted[k] else OFF
            number |= state << 2 * place
        return number - (1 << 32) if number >= 1 << 31 else number


def _words(
    pool: DevicePool, sections: Sequence[BoomSection], order: Sequence[int], ddi: int
) -> dict[Key, Sequence[int | None]]:
    """Which sections each condensed value is of, in its order: those below its element.

    An implement with several booms has a value for each of them. `order`: elements of all its sections.
    A section that is not among `sections` keeps its place, as None. `ddi`: of the first `PER_WORD`
    sections."""
    at = {section.element: k for k, section in enumerate(sections)}
    below: dict[int, list[int | None]] = {}
    owners = pool.owners(order, ddi) if sections else ()
    for number, element in zip(order, owners, strict=False):
        if element is not None:
            below.setdefault(element, []).append(at.get(number))
    return {
        (element, ddi + first // PER_WORD): of_element[first : first + PER_WORD]
        for element, of_element in below.items()
        for first in range(0, len(of_element), PER_WORD)
        if (element, ddi + first // PER_WORD) in pool.properties
    }


def _time_ms(known: Mapping[Key, int], ddi: int) -> int:
    number = next((number for (_, each), number in known.items() if each == ddi), 0)
    return number if abs(number) <= TIME_MAX_MS else 0


def _step_max_m(was: Observation, here: Observation, reach_m: float) -> float:
    """How far a section moves at most between two fixes. `reach_m`: from the place to it."""
    passed_for_us = here.sensed_at_us - was.sensed_at_us
    if not 0 < passed_for_us <= STEP_MAX_US:
        return STEP_MAX_M
    speed_m_s = max(hypot(each.vx_m_s, each.vy_m_s) for each in (was, here))
    turned_rad = abs(remainder(here.heading_rad - was.heading_rad, 2 * pi))
    return max(STEP_MAX_M, FURTHER * (speed_m_s * passed_for_us / S + reach_m * turned_rad))


def _placed(here: Observation, along: NDArray[np.float64], right: NDArray[np.float64]) -> Points:
    """Places ahead and to the right of an observation, in the field frame."""
    c, s = cos(here.heading_rad), sin(here.heading_rad)
    return np.column_stack((here.x_m + c * along + s * right, here.y_m + s * along - c * right))
