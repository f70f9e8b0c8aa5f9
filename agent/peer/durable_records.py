"""What one peer keeps over a restart: the record keys and what they hold.

Own operations are numbered before they are sent. Registers and progress are kept so that a fleet
that loses power as a whole loses no work. The stop records belong to
`agent/safety/stop_controller.py`.

A robot with keys writes down which units it covered itself, and the generation of the keys under which
it believed the others. What it was told counts after a restart only under the same keys, and as told by
nobody known: a revocation takes it out, and the other robots tell it again. The end of a section that was
written under other keys waits for its units. No name is kept with a fact, because a name would prove
nothing: what an honest robot told may be what it heard from a thief. Records of older versions do not say
which units are our own. They count as told by nobody known, because they may hold units of a thief.

A peer without its incarnation has lost its memory. Its dots and operation numbers would be used
twice, so it takes a random new incarnation and stays latched until a person has checked it.
"""

from collections.abc import Mapping
from contextlib import suppress
from random import Random
from struct import Struct
from typing import Any

from agent.interface.effects import Persist
from agent.peer import notices
from agent.peer.leader_election import TERM_MAX
from agent.peer.part import NOTHING, Outputs, Part, StepContext
from crdt import FieldAllocationCRDT, Progress
from crdt.claim_register import KEY_BITS, Phase, phase_of
from crdt.occupancy import PATCH_BYTES, OccupancyMap
from crdt.progress import BLOCK_UNITS, FULL, name_of
from protocol.sync.vouchers import UNKNOWN, Vouchers

U16, U32, U64 = Struct("<H"), Struct("<I"), Struct("<Q")
VOTE = Struct("<HB")
BLOCK = Struct("<QQ")  # with keys: the units of a block and the generation; the units of our own
GENERATION_MASK = (1 << 64 - KEY_BITS) - 1  # room beside the key of a register: 15 bits

INCARNATION = "incarnation"
OPERATIONS = "operations"
ELECTION = "election"
REGISTER = "register/"
PROGRESS = "progress/"
MAP = "map/"


FIRST_INCARNATION = 1


class DurableRecords(Part):
    """What durable memory held at the boot, and the records of what has to be kept."""

    def __init__(self, recalled: Mapping[str, bytes], first_boot: bool, rng: Random) -> None:
        """`recalled`: durable memory by key. `first_boot`: an empty memory is no loss. `rng`: draws
        the new incarnation after a loss.
        """
        self.recalled = recalled
        self.incarnation = self._number(INCARNATION, U16, 0)
        self.fresh = not self.incarnation  # this incarnation is not on disk yet
        self.lost = self.fresh and not (first_boot and not recalled)
        if self.fresh:
            lot = rng.randint(FIRST_INCARNATION + 1, 0xFFFF) if self.lost else FIRST_INCARNATION
            self.incarnation = lot
        self.operations = self._number(OPERATIONS, U32, 0)
        raw = recalled.get(ELECTION, b"")
        self.term = 0
        self.voted: int | None = None  # for whom, in this term
        if len(raw) == VOTE.size:
            term, candidate = VOTE.unpack(raw)
            self.term = min(term + 1, TERM_MAX)
            if term == TERM_MAX:  # there is no later one: our vote in it stays
                self.voted = candidate

    def on_timer(self, ctx: StepContext) -> Outputs:
        """Make the incarnation durable before the first frame that could reveal it."""
        if not self.fresh:
            return NOTHING
        self.fresh = False
        outputs: list[Any] = [Persist(*self.identity()), notices.BootRemembered()]
        return outputs

    def _number(self, key: str, layout: Struct, default: int) -> int:
        raw = self.recalled.get(key, b"")
        return int(layout.unpack(raw)[0]) if len(raw) == layout.size else default

    def restore(
        self, allocation: FieldAllocationCRDT, progress: Progress, vouchers: Vouchers | None = None
    ) -> dict[int, int]:
        """Restore the records; returns ends of sections that wait for their units, section to key.

        One that does not parse is skipped, because peers have it too. `vouchers`: with keys."""
        ends: dict[int, int] = {}
        for key, raw in sorted(self.recalled.items()):
            if key.startswith(REGISTER) and len(raw) == U64.size:
                section, written = int(key.removeprefix(REGISTER)), key_of(raw)
                end = phase_of(written) == Phase.DONE and section in progress.units
                if end and vouchers is not None and _other_keys(raw, vouchers):
                    ends[section] = written
                    continue
                allocation.apply(section, written)
                if vouchers is not None:
                    vouchers.register(section, written, vouchers.slot, 0)
            elif key.startswith(PROGRESS) and len(raw) in (U64.size, BLOCK.size):
                section, block = map(int, key.removeprefix(PROGRESS).split("/"))
                bits, own = units_of(raw), _own_units(raw)
                if vouchers is not None and not _same_keys(raw, vouchers):
                    bits = own
                progress.apply(section, block, bits)
                if vouchers is not None:
                    known, name = progress.bits(section, block), name_of(section, block)
                    vouchers.cover(name, own & known)
                    if known & ~own:
                        vouchers.units(name, known & ~own, UNKNOWN, 0)
        return ends

    def restore_map(self, chart: OccupancyMap) -> None:
        """Restore the patches of the fleet's map. One that does not parse is skipped, because peers
        have it too.
        """
        for key, raw in sorted(self.recalled.items()):
            if key.startswith(MAP) and len(raw) == PATCH_BYTES:
                with suppress(ValueError):  # skip impossible cells; peers have them too
                    chart.join_bytes(int(key.removeprefix(MAP)), raw)

    @staticmethod
    def patch(chart: OccupancyMap, patch: int) -> tuple[str, bytes]:
        """The record of one patch of the map: key and value."""
        return f"{MAP}{patch}", chart.patch_bytes(patch)

    def identity(self) -> tuple[str, bytes]:
        """The record of our incarnation: key and value."""
        return INCARNATION, U16.pack(self.incarnation)

    @staticmethod
    def operation(
        count: int, section: int, key: int, vouchers: Vouchers | None = None
    ) -> tuple[tuple[str, bytes], ...]:
        """The records of an own operation: the register after it, and the number of operations so
        far. `vouchers`: with keys.
        """
        return DurableRecords.register(section, key, vouchers), (OPERATIONS, U32.pack(count))

    @staticmethod
    def register(section: int, key: int, vouchers: Vouchers | None) -> tuple[str, bytes]:
        """The record of a register that is our own word. `vouchers`: with keys."""
        if vouchers is not None:
            key |= (vouchers.generation & GENERATION_MASK) << KEY_BITS
        return f"{REGISTER}{section}", U64.pack(key)

    @staticmethod
    def progress(
        section: int, block: int, bits: int, vouchers: Vouchers | None = None
    ) -> tuple[str, bytes]:
        """The record of 40 units of a section: key and value. `bits`: one for each unit. `vouchers`: with
        keys, they know which are our own."""
        key = f"{PROGRESS}{section}/{block}"
        if vouchers is None:
            return key, U64.pack(bits)
        own = vouchers.own(name_of(section, block))
        return key, BLOCK.pack(bits | vouchers.generation << BLOCK_UNITS, own)

    @staticmethod
    def vote(term: int, candidate: int) -> tuple[str, bytes]:
        """The record of our newest vote: key and value. `candidate`: the slot that we voted for."""
        return ELECTION, VOTE.pack(term, candidate)


def key_of(raw: bytes) -> int:
    """The key in the record of a register; 0 if it is none."""
    return int.from_bytes(raw, "little") & (1 << KEY_BITS) - 1 if len(raw) == U64.size else 0


def units_of(raw: bytes) -> int:
    """All units in the record of a block; none if it is none."""
    if len(raw) not in (U64.size, BLOCK.size):
        return 0
    return int.from_bytes(raw[: U64.size], "little") & FULL


def _own_units(raw: bytes) -> int:
    return int.from_bytes(raw[U64.size :], "little") & FULL


def _same_keys(raw: bytes, vouchers: Vouchers) -> bool:
    """Whether the record of a block was written under the present keys. Old records do not say it."""
    old = len(raw) == U64.size
    return old or int.from_bytes(raw[: U64.size], "little") >> BLOCK_UNITS == vouchers.generation


def _other_keys(raw: bytes, vouchers: Vouchers) -> bool:
    """Whether the record of a register was written under keys that are not the present ones."""
    generation = int.from_bytes(raw, "little") >> KEY_BITS
    return generation != vouchers.generation & GENERATION_MASK
