"""Checks the records of durable memory at boot, and how a journal reports that they are lost.

A record with a valid checksum and no meaning was written by other software, or by a fault of ours.
Then other records may be wrong too, so the whole memory is discarded: the robot stays latched
(BOOT_UNCONFIRMED) until a person has checked it.
"""

from collections.abc import Callable, Mapping

from agent.peer.durable_records import (
    BLOCK,
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
    key_of,
)
from agent.peer.key_renewal import FLEET_KEYS, RECORD_SIZES
from agent.peer.membership import SILENT_KEY
from agent.peer.operator_directive import DIRECTIVE_KEY, SENT, WORKS
from agent.peer.range_freshness import SCANNED, SCANS_KEY
from agent.peer.sense_freshness import BELIEVED, DOUBTED, FROZEN_RECORD, PLACE_KEY
from agent.safety.stop_controller import (
    COUNTER_KEY,
    FAR_KEY,
    FREE,
    HELD,
    HOLD_KEY,
    LATCHED,
    STOPS_KEY,
)
from crdt.allocation import BY_NUMBER, SECTION_MAX
from crdt.claim_register import phase_of
from crdt.occupancy import PATCH_BYTES
from crdt.stops import RemoteStopSet, StopSet

LOST = "lost"  # key of the record that replaces a lost memory; its value says why
BLOCK_MAX = 0xFF  # blocks of a section's progress
PATCH_MAX = 0xFFFF  # patches of the fleet's map
DIGITS_MAX = 5  # digits of a number in a key
COUNTER_BYTES = (1, 4)  # 1 byte at the first boot, 4 bytes as written later


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
    FLEET_KEYS: _size(*RECORD_SIZES),
    HOLD_KEY: lambda raw: raw in (FREE, HELD, LATCHED),
    PLACE_KEY: lambda raw: len(raw) == FROZEN_RECORD.size or raw in (BELIEVED, bytes((DOUBTED,))),
    SCANS_KEY: lambda raw: raw == SCANNED,
    DIRECTIVE_KEY: lambda raw: raw in (WORKS, SENT),
    SILENT_KEY: lambda raw: list(raw) == sorted(set(raw)),
}
# Greatest numbers in the key; bytes.
_FAMILIES: Mapping[str, tuple[tuple[int, ...], tuple[int, ...]]] = {
    REGISTER: ((SECTION_MAX,), (U64.size,)),
    PROGRESS: ((SECTION_MAX, BLOCK_MAX), (U64.size, BLOCK.size)),
    MAP: ((PATCH_MAX,), (PATCH_BYTES,)),
}


def senseless(recalled: Mapping[str, bytes]) -> str:
    """The first record that makes no sense, as a line for a person; empty if all are valid."""
    for key, raw in sorted(recalled.items()):
        check = _VALUES.get(key)
        if not (_known(key, raw) if check is None else check(raw)):
            return f"record {key!r} makes no sense: {raw[:16].hex()}"
    return ""


def _known(key: str, raw: bytes) -> bool:
    """Whether a record of a known family is valid; records with an unknown key are ignored."""
    for family, (greatest, sizes) in _FAMILIES.items():
        if key.startswith(family):
            numbers = key.removeprefix(family).split("/")
            fits = len(raw) in sizes and len(numbers) == len(greatest)
            fits = fits and all(map(_number, numbers, greatest))
            return fits and (family != REGISTER or phase_of(key_of(raw)) in BY_NUMBER)
    return True


def _number(text: str, most: int) -> bool:
    digits = text.isascii() and text.isdecimal() and len(text) <= DIGITS_MAX
    return digits and int(text) <= most


def sensible(recalled: Mapping[str, bytes]) -> Mapping[str, bytes]:
    """The same memory if it is valid, else only the record that it is lost."""
    why = senseless(recalled)
    return {LOST: why.encode()} if why else recalled


def remembers(recalled: Mapping[str, bytes]) -> bool:
    """Whether this memory was written before a restart."""
    return INCARNATION in recalled
