"""Ground is painted as a section was until it said otherwise, also between places of a slow receiver."""

from typing import Any, cast

import numpy as np
import pytest

from agent.implements.task_controller import TOLD_LATE_US, TaskController
from agent.interface.config import S
from agent.interface.observation import Observation
from protocol.device_description import OFFSET_X, OFFSET_Y, WIDTH, WORK_STATE
from tests.agent.implements.test_changed_descriptions import IMPLEMENT, Field, pool

SECTION = 5  # element
SPEED_M_S = 3.0
BEGIN_US = 100 * S


class Painted:
    """A map that notes from where to where ground was painted, metres along x."""

    def __init__(self) -> None:
        self.spans_m: list[tuple[float, float]] = []

    def paint(self, corners: np.ndarray[Any, Any]) -> list[tuple[int, int]]:
        self.spans_m.append((corners[:, 0].min(), corners[:, 0].max()))
        return []

    @property
    def length_m(self) -> float:
        return sum(to_m - from_m for from_m, to_m in self.spans_m)


@pytest.fixture
def tractor() -> tuple[TaskController, Painted]:
    """With one section of 3 m at the place of the receiver, which drives along x."""
    field, ground = Field(), Painted()
    field.upload(pool(element=SECTION))
    field.say(b"\x81\xff")
    field.wait(2 * S)
    controller = field.controller
    controller.ground = cast(Any, ground)
    for ddi, number in ((OFFSET_X, 0), (OFFSET_Y, 0), (WIDTH, 3000)):
        client = controller.server.clients[IMPLEMENT]
        client.values[SECTION, ddi] = number
    controller._begin(IMPLEMENT)
    assert [s.width_mm for s in controller.implements[IMPLEMENT].sections] == [3000]
    return controller, ground


def place(at_us: int) -> Observation:
    x_m = SPEED_M_S * (at_us - BEGIN_US) / S
    return Observation(x_m, 0.0, 0.0, SPEED_M_S, 0.0, sensed_at_us=at_us)


def test_a_section_is_off_a_little_before_it_says_so(
    tractor: tuple[TaskController, Painted],
) -> None:
    """Implements tell their states in cycles; what was not worked in that time would stay."""
    controller, ground = tractor
    controller._value(IMPLEMENT, (SECTION, WORK_STATE), 1, BEGIN_US - 1)
    controller._move(place(BEGIN_US))
    controller._value(IMPLEMENT, (SECTION, WORK_STATE), 0, BEGIN_US + S // 2)
    controller._move(place(BEGIN_US + S))
    assert ground.length_m == pytest.approx(SPEED_M_S * (0.5 - TOLD_LATE_US / S))


def test_a_section_is_on_from_when_it_says_so(tractor: tuple[TaskController, Painted]) -> None:
    """All ground since the last place was painted: three metres with 1 Hz."""
    controller, ground = tractor
    controller._move(place(BEGIN_US))
    controller._value(IMPLEMENT, (SECTION, WORK_STATE), 1, BEGIN_US + S // 2)
    controller._move(place(BEGIN_US + S))
    assert np.allclose(ground.spans_m[-1], (1.5, 3.0)) and ground.length_m == pytest.approx(1.5)


def test_a_late_place_paints_nothing_under_a_section_that_was_still_off(
    tractor: tuple[TaskController, Painted],
) -> None:
    """A receiver's place arrives 0.2 s after it was sensed, and a word in between."""
    controller, ground = tractor
    controller._move(place(BEGIN_US))
    controller._value(IMPLEMENT, (SECTION, WORK_STATE), 1, BEGIN_US + S // 10)
    controller._move(place(BEGIN_US + S // 20))
    assert not ground.spans_m
    controller._move(place(BEGIN_US + S // 5))
    assert np.allclose(ground.spans_m, [(0.3, 0.6)])


def test_a_second_between_two_places_is_painted_and_a_jump_is_not(
    tractor: tuple[TaskController, Painted],
) -> None:
    controller, ground = tractor
    controller._value(IMPLEMENT, (SECTION, WORK_STATE), 1, BEGIN_US - 1)
    controller._move(place(BEGIN_US))
    controller._move(place(BEGIN_US + S))
    assert np.allclose(ground.spans_m, [(0.0, 3.0)])
    controller._move(place(BEGIN_US + 2 * S)._replace(x_m=20.0))
    assert len(ground.spans_m) == 1
