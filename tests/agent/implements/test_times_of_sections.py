"""Turn-on and turn-off times that an implement keeps as settings, which ISO 11783-11 wants of them."""

from random import Random
from struct import pack
from types import SimpleNamespace
from typing import Any, Final, cast

import numpy as np
import pytest

from agent.implements.section_control import SectionedImplement
from agent.implements.task_controller import TaskController, controller_name
from protocol.device_pool import read_pool
from protocol.frames.frame import Frame
from protocol.units import MS, S
from sim.rigs.implements_rig import CONDENSED_MAKER, SPRAYER, ControllerNode, RigBus, Sprayer

TURN_ON, TURN_OFF = 205, 206
VALUE, REQUEST, CHANGE = 3, 2, 8
BOOM: Final = 2  # element


class SettableTimes(Sprayer):
    """A sprayer whose times are settings of its controller, so they are no fixed values."""

    def __init__(self) -> None:
        super().__init__(CONDENSED_MAKER, 7)
        self.times_ms = {TURN_ON: 700, TURN_OFF: 400}
        self.followed: set[int] = set()

    def pool(self) -> bytes:
        """The two fixed values are values that can be asked for and set."""
        objects = super().pool()
        for number, ddi, title, fixed_ms in (
            (1005 + 1, TURN_ON, b"\x02on", self.maker.on_for_ms),
            (1005 + 2, TURN_OFF, b"\x03off", self.maker.off_for_ms),
        ):
            fixed = b"DPT" + pack("<HHi", number, ddi, fixed_ms) + title + b"\xff\xff"
            assert fixed in objects
            asked = b"DPD" + pack("<HHBB", number, ddi, 2, 8) + title + b"\xff\xff"
            objects = objects.replace(fixed, asked)
        return objects

    def hears(self, frame: Frame, now_us: int) -> list[Frame]:
        """Tell a time when it is asked for."""
        command, ddi = frame.data[0] & 0xF, int.from_bytes(frame.data[2:4], "little")
        asked = self.phase == "in" and frame.identifier >> 8 & 0x3FFFF == 0xCB00 | SPRAYER
        if asked and ddi in self.times_ms and command in (REQUEST, CHANGE):
            if command == CHANGE:
                self.followed.add(ddi)
            return [self.tells(ddi)]
        return super().hears(frame, now_us)

    def tells(self, ddi: int) -> Frame:
        """Its value of a time."""
        head = bytes((VALUE | BOOM << 4, 0))
        return self._data(head + pack("<Hi", ddi, self.times_ms[ddi]))


def no_cells(row: int, columns: tuple[int, ...]) -> None:
    """Nothing is worked here."""


def test_times_that_are_settings_of_an_implement_are_asked_for_and_followed() -> None:
    """They were taken for 0, so each section of such an implement was switched too late."""
    bus, sprayer = RigBus(1), SettableTimes()
    ground, fixes = cast(Any, SimpleNamespace()), SimpleNamespace(take=lambda *given: None)
    controller = TaskController(controller_name(5), ground, cast(Any, fixes), 0.0, Random(1), 0, 0)
    node = ControllerNode(controller, no_cells)
    bus.attach(node)
    bus.attach(sprayer)
    bus.run(0, 8 * S)
    implement = controller.implements[SPRAYER]
    assert (implement.on_for_us, implement.off_for_us) == (700 * MS, 400 * MS)
    assert sprayer.followed == {TURN_ON, TURN_OFF}
    sprayer.times_ms[TURN_ON] = 900
    node.hears(sprayer.tells(TURN_ON), 8 * S)
    assert (implement.on_for_us, implement.off_for_us) == (900 * MS, 400 * MS)


@pytest.mark.parametrize("time_ms", [2**31 - 1, -(2**31), 60_001])
def test_a_time_that_no_section_needs_is_not_believed(time_ms: int) -> None:
    """Its sections were switched by ground that is thousands of kilometres ahead, so they were off."""
    pool = read_pool(SettableTimes().pool(), CONDENSED_MAKER.version)
    assert pool is not None
    implement = SectionedImplement(pool, {(BOOM, TURN_ON): time_ms, (BOOM, TURN_OFF): 400})
    assert (implement.on_for_us, implement.off_for_us) == (0, 400 * MS)
    implement.heard((BOOM, TURN_OFF), time_ms)
    assert implement.off_for_us == 0
    assert not np.any(implement.actual)
