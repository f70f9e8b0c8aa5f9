"""What durable memory recalls at boot: whether it makes sense, and how a journal says that it was lost.

A record with a right check sum and no meaning was written by other software, or by a fault of ours.
Then nobody knows what else is wrong, so none of the memory counts: the robot stands latched
(BOOT_UNCONFIRMED) until a person has looked.
"""

from collections.abc import Callable, Mapping

from agent.peer.durable_records import (
    ELECTION,
    INCARNATION,
    MAP,
    OPERATIONS,
    PROGRESS,
    REGISTER,
    U16,
    U32,
    U64,
    VOTE,
)
from agent.safety.stop_controller import (
    COUNTER_KEY,
    FAR_KEY,
    FREE,
    HELD,
    HOLD_KEY,
    LATCHED,
    STOPS_KEY,
)
from crdt.allocation import SECTION_MAX
from crdt.occupancy import PATCH_BYTES
from crdt.stops import RemoteStopSet, StopSet

LOST = "lost"  # a record in place of a memory that is gone; its value says why
BLOCK_MAX = 0xFF  # of a section's progress
PATCH_MAX = 0xFFFF  # of the fleet's map
DIGITS_MAX = 5  # of a number in a key
COUNTER_BYTES = (1, 4)  # the first life's beginning, and what is written down later


def _size(*sizes: int) -> Callable[[bytes], bool]:
    return lambda raw: len(raw) in sizes


def _parses(parse: Callable[[bytes], object]) -> Callable[[bytes], bool]:
    def sensible(raw: bytes) -> bool:
        try:
            parse(raw)
        except ValueError:
            return False
        return True

    return sensible


_VALUES: Mapping[str, Callable[[bytes], bool]] = {
    INCARNATION: _size(U16.size),
    OPERATIONS: _size(U32.size),
    ELECTION: _size(VOTE.size),
    STOPS_KEY: _parses(StopSet.deserialize),
    FAR_KEY: _parses(RemoteStopSet.deserialize),
    COUNTER_KEY: _size(*COUNTER_BYTES),
    HOLD_KEY: lambda raw: raw in (FREE, HELD, LATCHED),
}
_FAMILIES: Mapping[str, tuple[tuple[int, ...], int]] = {  # greatest numbers in the key; bytes
    REGISTER: ((SECTION_MAX,), U64.size),
    PROGRESS: ((SECTION_MAX, BLOCK_MAX), U64.size),
    MAP: ((PATCH_MAX,), PATCH_BYTES),
}


def senseless(recalled: Mapping[str, bytes]) -> str:
    """The first record that makes no sense, as a line for a person; empty where all do."""
    for key, raw in sorted(recalled.items()):
        check = _VALUES.get(key)
        if not (_known(key, raw) if check is None else check(raw)):
            return f"record {key!r} makes no sense: {raw[:16].hex()}"
    return ""


def _known(key: str, raw: bytes) -> bool:
    """A record of a family; one of a key that is not ours is no business of ours."""
    for family, (greatest, size) in _FAMILIES.items():
        if key.startswith(family):
            numbers = key.removeprefix(family).split("/")
            fits = len(raw) == size and len(numbers) == len(greatest)
            return fits and all(map(_number, numbers, greatest))
    return True


def _number(text: str, most: int) -> bool:
    digits = text.isascii() and text.isdecimal() and len(text) <= DIGITS_MAX
    return digits and int(text) <= most


def sensible(recalled: Mapping[str, bytes]) -> Mapping[str, bytes]:
    """The same memory, or the record that it is lost."""
    why = senseless(recalled)
    return {LOST: why.encode()} if why else recalled


def remembers(recalled: Mapping[str, bytes]) -> bool:
    """Whether it is the memory of an earlier life."""
    return INCARNATION in recalled
