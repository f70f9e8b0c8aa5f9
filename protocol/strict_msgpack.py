"""MessagePack from senders that are not trusted: bounded memory, strict types, one kind of error.

What comes off a bus is a frame (`protocol/frames/`). Structured messages that travel beside the bus
(between gateways, from robots to a map) are MessagePack arrays, read with this.
"""

from collections.abc import Sequence
from math import isfinite
from typing import Any

from msgpack import Unpacker, packb
from msgpack.exceptions import UnpackException

U8, U16, U32 = 8, 16, 32  # bits of an unsigned number


def packed(value: object) -> bytes:
    """The bytes of a value made of numbers, strings, bytes, lists, tuples and dicts."""
    data: bytes = packb(value)
    return data


class StrictReader:
    """Reads the values of one message in order. Every method raises ValueError for other bytes.

    An array allocates its announced length before its elements have arrived. So elements are read
    with `value` under `array_max`, which is small, and long arrays item by item after `count`.
    """

    def __init__(
        self, data: bytes, array_max: int = 0, map_max: int = 0, bytes_max: int = 0, text_max: int = 0
    ) -> None:  # fmt: skip
        self._size = len(data)
        self._unpacker: Any = Unpacker(
            max_buffer_size=max(self._size, 1), use_list=False, raw=False, strict_map_key=False,
            max_array_len=array_max, max_map_len=map_max, max_bin_len=bytes_max,
            max_str_len=text_max, max_ext_len=0,
        )  # fmt: skip
        self._unpacker.feed(data)

    def count(self, most: int) -> int:
        """The number of elements of the array that begins here, at most `most`."""
        try:
            number: int = self._unpacker.read_array_header()
        except (ValueError, UnpackException):
            raise ValueError("no array") from None
        if number > most:
            raise ValueError("length")
        return number

    def value(self) -> Any:
        """The next value, of any type within the limits."""
        try:
            return self._unpacker.unpack()
        except (ValueError, TypeError, UnpackException):  # a dict as a key is a TypeError
            raise ValueError("no value") from None

    def numbers(self, widths: Sequence[int]) -> list[int]:
        """As many unsigned numbers as there are widths, each of so many bits."""
        return unsigned([self.value() for _ in widths], widths)

    def end(self) -> None:
        """Nothing follows."""
        if self._unpacker.tell() != self._size:
            raise ValueError("length")


def unsigned(values: Sequence[object], widths: Sequence[int]) -> list[int]:
    """The values, if they are unsigned numbers of these bits. Raises ValueError.

    >>> unsigned((1, 255), (U8, U8))
    [1, 255]
    """
    if len(values) != len(widths):
        raise ValueError("length")
    found = []
    for value, bits in zip(values, widths, strict=True):
        if not isinstance(value, int) or isinstance(value, bool) or value >> bits:
            raise ValueError("range")
        found.append(value)
    return found


def finite(values: Sequence[object]) -> list[float]:
    """The values as floats, in the unit that they came in. Raises ValueError unless all are
    numbers, neither infinite nor NaN."""
    found = []
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
            raise ValueError("no number")
        found.append(float(value))
    return found
