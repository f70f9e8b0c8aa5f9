"""The fleet's screen as an object pool of a virtual terminal (ISO 11783-6, version 3 and later).

One data mask with a line for each robot, the covered share and a picture of the field; one alarm mask;
soft keys STOP, RELEASE and acknowledge. What changes later are texts, numbers and the picture, which is
sent again as an object of its own.
"""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from struct import pack
from typing import Final, NamedTuple

WORKING_SET, DATA_MASK, ALARM_MASK, SOFT_KEYS, ALARM_KEYS = 0, 1000, 1001, 2000, 2001
STOP_KEY, RELEASE_KEY, ACKNOWLEDGE_KEY = 3000, 3001, 3002  # objects
STOP_CODE, RELEASE_CODE, ACKNOWLEDGE_CODE = 1, 2, 3  # of keys
TITLE, COVERED, COVERED_WORD, ALARM_TEXT, PICTURE = 4000, 4001, 4002, 4003, 4004
STOP_WORD, RELEASE_WORD, ACKNOWLEDGE_WORD, DESIGNATOR = 4010, 4011, 4012, 4013
FIRST_ROW: Final = 4100  # texts of robots, in their order
FONT, FONT_LIGHT = 5000, 5001
NO_OBJECT: Final = 0xFFFF
ROW_CHARACTERS: Final = 24
ALARM_CHARACTERS: Final = 48
ROWS_MAX: Final = 20  # robots on one screen
DOTS_MIN: Final = 200  # edge of the smallest data mask of the standard
DOTS_MAX: Final = 2000  # more than any terminal has; positions are 16 bits with a sign
ROW_DOTS, TEXT_DOTS, FONT_DOTS = 9, 8, 6  # height of a row and of a text, width of a character
HEAD_DOTS: Final = 24  # above the rows
# Dots; four bits each: 1,920 bytes, so that the picture alone goes by the extended transport, too.
PICTURE_WIDTH, PICTURE_HEIGHT = 48, 80
BLACK, WHITE, GREEN, SILVER, RED, YELLOW = 0, 1, 2, 7, 12, 14  # standard colours


class ScreenPicture(NamedTuple):
    """A picture of 16 colours, row by row from the top; `PICTURE_WIDTH` x `PICTURE_HEIGHT` dots."""

    dots: bytes


def field_picture(
    outline: Sequence[tuple[float, float]],
    worked: Iterable[Sequence[tuple[float, float]]],
    robots: Sequence[tuple[float, float]],
) -> ScreenPicture:
    """The outline of a field, what is worked in it, and where robots are.

    `outline`, `robots`: places, metres east and north. `worked`: lines along which an implement has been,
    in metres as well. Without an outline the robots alone are drawn.
    """
    dots = bytearray((SILVER,)) * (PICTURE_WIDTH * PICTURE_HEIGHT)
    places = [*outline, *robots]
    if not places:
        return ScreenPicture(bytes(dots))
    west, south = min(p[0] for p in places), min(p[1] for p in places)
    east, north = max(p[0] for p in places), max(p[1] for p in places)
    scale = min(
        (PICTURE_WIDTH - 3) / max(east - west, 1.0), (PICTURE_HEIGHT - 3) / max(north - south, 1.0)
    )

    def put(x_m: float, y_m: float, colour: int) -> None:
        column = 1 + round((x_m - west) * scale)
        row = PICTURE_HEIGHT - 2 - round((y_m - south) * scale)
        dots[
            min(max(row, 0), PICTURE_HEIGHT - 1) * PICTURE_WIDTH
            + min(max(column, 0), PICTURE_WIDTH - 1)
        ] = colour

    def line(points: Sequence[tuple[float, float]], colour: int) -> None:
        for (x_m, y_m), (next_x_m, next_y_m) in pairwise(points):
            longer_m = max(abs(next_x_m - x_m), abs(next_y_m - y_m))
            steps = 1 + int(2 * scale * longer_m)
            for step in range(steps + 1):
                share = step / steps
                put(x_m + share * (next_x_m - x_m), y_m + share * (next_y_m - y_m), colour)

    if outline:
        for each in worked:
            line(each, GREEN)
        line([*outline, outline[0]], BLACK)
    for x_m, y_m in robots:
        put(x_m, y_m, RED)
    return ScreenPicture(bytes(dots))


def screen_pool(
    name: str, rows: Sequence[str], covered_percent: int, picture: ScreenPicture, dots: int
) -> bytes:
    """All objects. `name`: of the fleet. `rows`: a text for each robot. `dots`: edge of the data mask."""
    rows = rows[:ROWS_MAX]
    dots = max(dots, DOTS_MIN)
    numbers = [FIRST_ROW + k for k in range(len(rows))]
    left, right = 4, dots - PICTURE_WIDTH - 4
    shown = [
        (TITLE, left, 2),
        (COVERED, right, 2),
        (COVERED_WORD, right + 20, 2),
        (PICTURE, right, HEAD_DOTS),
    ]
    shown += [(number, left, HEAD_DOTS + ROW_DOTS * k) for k, number in enumerate(numbers)]
    objects = [
        _head(WORKING_SET, 0) + pack("<BBHBBB", BLACK, 1, DATA_MASK, 1, 0, 1)
        + _placed([(DESIGNATOR, 4, 4)]) + b"en",
        _head(DATA_MASK, 1) + pack("<BHBB", WHITE, SOFT_KEYS, len(shown), 0) + _placed(shown),
        _head(ALARM_MASK, 2) + pack("<BHBBBB", RED, ALARM_KEYS, 0, 0, 1, 0)
        + _placed([(ALARM_TEXT, 4, 40)]),
        _head(SOFT_KEYS, 4) + pack("<BBBHH", SILVER, 2, 0, STOP_KEY, RELEASE_KEY),
        _head(ALARM_KEYS, 4) + pack("<BBBHH", SILVER, 2, 0, STOP_KEY, ACKNOWLEDGE_KEY),
        _key(STOP_KEY, RED, STOP_CODE, STOP_WORD), _key(RELEASE_KEY, GREEN, RELEASE_CODE, RELEASE_WORD),
        _key(ACKNOWLEDGE_KEY, YELLOW, ACKNOWLEDGE_CODE, ACKNOWLEDGE_WORD),
        _text(STOP_WORD, "STOP", 8, FONT_LIGHT), _text(RELEASE_WORD, "RELEASE", 8, FONT_LIGHT),
        _text(ACKNOWLEDGE_WORD, "ACK", 8, FONT), _text(DESIGNATOR, "fleet", 6, FONT_LIGHT),
        _text(TITLE, name, ROW_CHARACTERS, FONT), _text(COVERED_WORD, "%", 4, FONT),
        _text(ALARM_TEXT, "", ALARM_CHARACTERS, FONT_LIGHT),
        _head(COVERED, 12) + pack("<HHBHBHIifBBBB", 3 * FONT_DOTS, TEXT_DOTS, WHITE, FONT, 1, NO_OBJECT,
                                  covered_percent, 0, 1.0, 0, 0, 2, 0),
        _picture(picture),
        _head(FONT, 23) + pack("<BBBBB", BLACK, 0, 0, 0, 0),
        _head(FONT_LIGHT, 23) + pack("<BBBBB", WHITE, 0, 0, 0, 0),
    ]  # fmt: skip
    objects += [
        _text(number, row, ROW_CHARACTERS, FONT) for number, row in zip(numbers, rows, strict=True)
    ]
    return b"".join(objects)


def picture_object(picture: ScreenPicture) -> bytes:
    """The picture alone: a terminal that gets it puts it in the place of the one that it has."""
    return _picture(picture)


def padded(text: str, characters: int) -> bytes:
    """A text as a terminal shows it: ISO 8859-1, filled up with blanks."""
    return text.encode("latin-1", "replace")[:characters].ljust(characters)


def _head(number: int, kind: int) -> bytes:
    return pack("<HB", number, kind)


def _placed(objects: Sequence[tuple[int, int, int]]) -> bytes:
    return b"".join(pack("<Hhh", *each) for each in objects)


def _key(number: int, colour: int, code: int, word: int) -> bytes:
    return _head(number, 5) + pack("<BBBB", colour, code, 1, 0) + _placed([(word, 2, 20)])


def _text(number: int, text: str, characters: int, font: int) -> bytes:
    value = padded(text, characters)
    head = pack(
        "<HHBHBHBH", characters * FONT_DOTS, TEXT_DOTS, WHITE, font, 1, NO_OBJECT, 0, characters
    )
    return _head(number, 11) + head + value + b"\x00"


def _picture(picture: ScreenPicture) -> bytes:
    dots = picture.dots
    assert len(dots) == PICTURE_WIDTH * PICTURE_HEIGHT
    data = bytes(dots[k] << 4 | dots[k + 1] for k in range(0, len(dots), 2))
    head = pack("<HHHBBBIB", PICTURE_WIDTH, PICTURE_WIDTH, PICTURE_HEIGHT, 1, 0, 0, len(data), 0)
    return _head(PICTURE, 20) + head + data
