"""Who vouched for each fact of a replica, so that the facts of a revoked member can be taken out.

Registers are maxima and blocks are unions, so a fact does not say where it came from. This keeps beside
them, for each register and block, what every received frame changed: the value before it, the value
after it, the member whose proof covered the frame, and when. The first who said it vouched for it: later
frames that repeat a fact may only repeat what that one said.

A claim also names its author, the owner. What a revoked member is the author of is void, too, whichever
robot relayed it.
"""

from typing import Final, NamedTuple

from crdt.claim_register import owner_of

CHAIN_MAX: Final = 16  # newest changes kept of a register; a section changes hands a few times
BLOCKS_MAX: Final = 40  # of a block: each adds one of its 40 units at least


class Vouched(NamedTuple):
    """One change by a received frame."""

    before: int | None  # None: there was no register
    value: int  # the register's key, or the units that were new in a block
    sender: int
    at_us: int


class Vouchers:
    """What each received frame changed, by register and by block."""

    def __init__(self) -> None:
        self._registers: dict[int, list[Vouched]] = {}
        self._blocks: dict[int, list[Vouched]] = {}

    def register(
        self, section: int, before: int | None, key: int, sender: int, now_us: int
    ) -> None:
        """A frame changed a register."""
        chain = self._registers.setdefault(section, [])
        chain.append(Vouched(before, key, sender, now_us))
        del chain[:-CHAIN_MAX]

    def block(self, name: int, new_bits: int, sender: int, now_us: int) -> None:
        """A frame added units to a block. `name`: of the block. `new_bits`: of the units in it."""
        chain = self._blocks.setdefault(name, [])
        chain.append(Vouched(None, new_bits, sender, now_us))
        assert len(chain) <= BLOCKS_MAX

    def forget(self, section: int) -> None:
        """The register of a section was taken out."""
        self._registers.pop(section, None)

    def registers_without(
        self, revoked: int, compromised_at_us: int | None, present: dict[int, int]
    ) -> dict[int, int | None]:
        """The sections whose register changes when a member's facts are void, and what remains.

        `present`: all registers. The rest is the greatest of the values that others vouched for and
        those that were there before."""
        found: dict[int, int | None] = {}
        for section, key in present.items():
            chain = self._registers.get(section, [])
            void = {
                v.value for v in chain if _is_void(v, revoked, compromised_at_us, owner_of(v.value))
            }
            if compromised_at_us is None and owner_of(key) == revoked:
                void.add(key)
            if key not in void:
                continue
            kept = {v.value for v in chain} | {v.before for v in chain if v.before is not None}
            if compromised_at_us is None:
                kept = {value for value in kept if owner_of(value) != revoked}
            found[section] = max(kept - void, default=None)
        for section, rest in found.items():
            chain = self._registers.get(section, [])
            self._registers[section] = [v for v in chain if rest is not None and v.value <= rest]
        return found

    def blocks_without(self, revoked: int, compromised_at_us: int | None) -> dict[int, int]:
        """By name of the block: the units that are void."""
        found: dict[int, int] = {}
        for name, chain in self._blocks.items():
            void = [v for v in chain if _is_void(v, revoked, compromised_at_us, None)]
            if void:
                bits = 0
                for vouched in void:
                    bits |= vouched.value
                found[name] = bits
                self._blocks[name] = [v for v in chain if v not in void]
        return found


def _is_void(
    vouched: Vouched, revoked: int, compromised_at_us: int | None, author: int | None
) -> bool:
    late = compromised_at_us is None or vouched.at_us >= compromised_at_us
    return late and revoked in (vouched.sender, author)
