"""Implements that change their description, activate it again and again, or number it wrongly.

Found by a review: each ended the task controller, or filled its memory."""

from random import Random
from struct import pack
from types import SimpleNamespace
from typing import Any, cast

from agent.implements.task_controller import TaskController, controller_name
from agent.interface.config import MS
from protocol.device_description import WIDTH, WORK_STATE
from protocol.frames.codec import encode
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.task_frames import PROCESS_DATA, ProcessData
from protocol.name import Name
from protocol.transport import ReceivedMessage

IMPLEMENT = 130
VERSION, ACTIVATE, DEACTIVATE, DELETE = b"\x10\x04", b"\x81\xff", b"\x81\x00", b"\xa1"


def text(words: str) -> bytes:
    return bytes((len(words),)) + words.encode()


def pool(element: int = 5, sections: int = 1) -> bytes:
    """The description of a boom with so many sections, numbered from `element` on."""
    out = b"DVC" + pack("<H", 0) + text("d") + text("1") + pack("<Q", 7) + text("s")
    out += b"l" * 7 + b"e" * 7 + b"\x00"
    for number, data, name in ((1, 134, "x"), (2, 135, "y"), (3, 67, "w")):
        out += b"DPD" + pack("<HHBB", number, data, 1, 31) + text(name) + pack("<H", 0xFFFF)
    for k in range(sections):
        out += b"DET" + pack("<HB", 10 + k, 4) + text("e")
        out += pack("<HHH", element + k, 0, 3) + pack("<HHH", 1, 2, 3)
    return out


class Field:
    """A task controller and the frames of one implement."""

    def __init__(self) -> None:
        self.now_us = 0
        nothing = SimpleNamespace(take=lambda *given: None)
        self.controller = TaskController(
            controller_name(1), cast(Any, SimpleNamespace()), cast(Any, nothing), 0.0, Random(1), 0
        )
        self.wait(1500 * MS)
        self.frame(AddressClaimed(Name(9, function=1).pack()), 255)
        self.say(VERSION)

    def wait(self, for_us: int) -> None:
        ends_at_us = self.now_us + for_us
        while self.now_us < ends_at_us:
            self.now_us += 10 * MS
            self.controller.on_timer(self.now_us)

    def frame(self, message: AddressClaimed | ProcessData, to: int | None = None) -> None:
        self.now_us += MS
        address = self.controller.claim.address
        assert address is not None
        self.controller.on_frame(
            encode(message, IMPLEMENT, address if to is None else to), self.now_us
        )

    def say(self, data: bytes) -> None:
        self.frame(ProcessData(data.ljust(8, b"\xff")))

    def upload(self, data: bytes) -> None:
        """What the transport protocol delivers."""
        self.now_us += MS
        whole = ReceivedMessage(IMPLEMENT, PROCESS_DATA.pgn, b"\x61" + data, False)
        self.controller._whole(whole, self.now_us)


def test_a_description_that_is_right_is_painted() -> None:
    field = Field()
    field.upload(pool())
    field.say(ACTIVATE)
    field.wait(2000 * MS)
    assert list(field.controller.implements) == [IMPLEMENT]


def test_an_element_that_no_command_has_room_for_is_refused() -> None:
    field = Field()
    field.upload(pool(element=4096))
    field.say(ACTIVATE)
    field.wait(2000 * MS)
    assert not field.controller.implements


def test_widths_that_change_after_the_log_in_are_followed() -> None:
    """A boom that was folded when it logged in stayed without a width."""
    field = Field()
    field.upload(pool())
    field.say(ACTIVATE)
    field.wait(2000 * MS)
    told = []
    for width_mm in (0, 3000, 4500):
        field.say(pack("<BBHi", 3 | 5 << 4, 0, WIDTH, width_mm))
        field.wait(2000 * MS)
        (implement,) = field.controller.implements.values()
        told.append([section.width_mm for section in implement.sections])
    assert told == [[], [3000], [4500]]


def test_a_section_that_is_on_stays_on_when_its_boom_unfolds() -> None:
    field = Field()
    field.upload(pool())
    field.say(ACTIVATE)
    field.wait(2000 * MS)
    on: list[list[bool]] = []
    for width_mm in (3000, 4500):
        field.say(pack("<BBHi", 3 | 5 << 4, 0, WIDTH, width_mm))
        field.wait(2000 * MS)
        if not on:
            field.say(pack("<BBHi", 3 | 5 << 4, 0, WORK_STATE, 1))
        on.append(field.controller.implements[IMPLEMENT].actual.tolist())
    assert on == [[True], [True]]


def test_a_width_that_is_told_again_changes_nothing() -> None:
    field = Field()
    field.upload(pool())
    field.say(ACTIVATE)
    field.wait(2000 * MS)
    before = []
    for _ in range(2):
        field.say(pack("<BBHi", 3 | 5 << 4, 0, WIDTH, 3000))
        field.wait(2000 * MS)
        before.append(field.controller.implements[IMPLEMENT])
    assert before[0] is before[1]


def test_a_description_that_is_replaced_at_once_ends_nothing() -> None:
    field = Field()
    field.upload(pool())
    field.say(ACTIVATE)
    field.upload(pool())
    field.say(DELETE)
    field.wait(2000 * MS)
    assert not field.controller.implements


def test_the_map_is_not_painted_by_a_description_that_was_replaced() -> None:
    field = Field()
    field.upload(pool())
    field.say(ACTIVATE)
    field.wait(2000 * MS)
    field.upload(pool(element=9, sections=3))
    field.wait(2000 * MS)
    assert not field.controller.implements
    field.say(ACTIVATE)
    field.wait(2000 * MS)
    assert list(field.controller.implements) == [IMPLEMENT]


def test_an_implement_that_activates_itself_again_and_again_fills_nothing() -> None:
    field = Field()
    field.upload(pool(sections=200))
    waiting = []
    for _ in range(3):
        for _ in range(50):
            field.say(ACTIVATE)
            field.say(DEACTIVATE)
        field.wait(10 * MS)
        waiting.append(len(field.controller._asks))
    assert max(waiting) < 1000 and waiting[-1] <= waiting[0]


def test_an_implement_whose_address_is_taken_goes_on_at_another_one() -> None:
    field = Field()
    field.upload(pool())
    field.say(ACTIVATE)
    field.wait(2000 * MS)
    controller = field.controller
    address = controller.claim.address
    assert address is not None
    told = ProcessData(b"\xff" * 4 + b"\x01\x00\x00\x00")
    for message, source in (
        (AddressClaimed(Name(8, function=1).pack()), IMPLEMENT),
        (AddressClaimed(Name(9, function=1).pack()), IMPLEMENT + 1),
        (told, IMPLEMENT + 1),
    ):
        to = address if message is told else 255
        controller.on_frame(encode(message, source, to), field.now_us)
    field.wait(2000 * MS)
    assert list(controller.implements) == [IMPLEMENT + 1]
