"""A sprayer whose power fails while it sprays: what it did not spray is not worked. Found by a review."""

from random import Random
from struct import pack
from typing import Final

import numpy as np
from shapely.geometry import box

from agent.implements.as_applied_map import AsAppliedMap
from agent.implements.task_controller import TaskController, controller_name
from crdt import Progress
from protocol.frames.frame import Frame
from protocol.units import S
from sim.rigs.implements_rig import (
    BOOM_AHEAD_M,
    CONDENSED_MAKER,
    RECEIVER,
    STEP_US,
    ControllerNode,
    RigBus,
    RigFixes,
    Sprayer,
)

SPEED_M_S, MIDDLE_M = 3.0, 30.0
BEGINS_US, FAILS_US, END_US = 6 * S, 25 * S, 40 * S
BETWEEN_MESSAGES_S: Final = 1.0  # of the sprayer, at most


class Failing:
    """A device whose power fails."""

    def __init__(self, device: Sprayer) -> None:
        self.device = device

    def hears(self, frame: Frame, now_us: int) -> list[Frame]:
        """Take a frame; returns the answers."""
        return self.device.hears(frame, now_us) if now_us < FAILS_US else []

    def turns(self, now_us: int) -> list[Frame]:
        """Send what is due."""
        return self.device.turns(now_us) if now_us < FAILS_US else []


class Receiver:
    """The receiver of a tractor that drives east."""

    def hears(self, frame: Frame, now_us: int) -> list[Frame]:
        """It answers nothing."""
        return []

    def turns(self, now_us: int) -> list[Frame]:
        """Its place, each 50 ms."""
        if now_us % STEP_US:
            return []
        place = pack("<ii", round(1e4 * tractor_m(now_us)), round(1e4 * MIDDLE_M))
        way = pack("<HH", 0, round(1000 * SPEED_M_S))
        return [Frame(0x09F80100 | RECEIVER, place), Frame(0x09F80200 | RECEIVER, way)]


def tractor_m(now_us: int) -> float:
    return -20.0 + SPEED_M_S * max(0, now_us - BEGINS_US) / S


def test_what_a_sprayer_without_power_has_passed_is_not_worked() -> None:
    """It counted as worked for six seconds, until the sprayer was taken for gone."""
    cells = list[tuple[int, int]]()

    def share(row: int, columns: tuple[int, ...]) -> None:
        cells.extend((row, column) for column in columns)

    ground = AsAppliedMap(box(0.0, 0.0, 400.0, 60.0), Progress())
    controller = TaskController(controller_name(5), ground, RigFixes(), -2.0, Random(1), 0, 0)
    bus, sprayer = RigBus(1), Sprayer(CONDENSED_MAKER, 7)
    for each in (ControllerNode(controller, share), Failing(sprayer), Receiver()):
        bus.attach(each)
    bus.run(0, FAILS_US)
    assert all(sprayer.valves)
    bus.run(FAILS_US, END_US)
    assert not controller.implements
    boom_m = tractor_m(FAILS_US) + BOOM_AHEAD_M
    reach_m = max(column for _, column in cells) * ground.cell_m + ground.origin[0]
    assert boom_m - SPEED_M_S * BETWEEN_MESSAGES_S - 1.0 < reach_m <= boom_m, (
        "and all before that is"
    )
    assert ground.needs(np.array([[boom_m + 5.0, MIDDLE_M]])).all(), "it is to be sprayed yet"
