"""The senders that vouched for each fact, so that what a revoked member has said can be taken out.

Registers are maxima and blocks are unions, so a fact does not say where it came from. This keeps it
beside them: of a register what each member has said of it, of a block which units each member was the
first to tell, and which units this robot has covered itself.

**What is void at a revocation.** What the revoked member said, what it is the owner of, and *hearsay*:
what a member that is on the bus now may have heard from it, because a frame was lost here or this robot
was off. A claim that its owner told is no hearsay. What others said in our own name, and we did not, is
void whenever it was said. Units always may be: a frame with units does not say
which robot covered them. Nothing true is lost by that. Every robot keeps its own words, and what robots
told that are not on the bus any more. All tell that again (`Synchronizer.void`). No robot tells a lie
again: those that heard it from the thief have taken it out.

What was said of a register is joined by maximum for each member, so the order of frames does not matter.
A member is one more maximum: it can push out nothing that another one said.
"""

from array import array
from collections.abc import Iterator
from typing import Final, NamedTuple

from crdt.claim_register import owner_of

# Values kept of one register and one member: the first ones and the greatest. A section has three of each
# holder, and changes hands a few times. More only matters for what was said before a stated point.
RISES_MAX: Final = 8
BLOCK_UNITS_MAX: Final = 40  # of a block: each entry adds one of its 40 units at least
# The sender of units that a robot remembers from before a restart, and has not covered itself: not known.
UNKNOWN: Final = -1


class Vouched(NamedTuple):
    """One value that a member has said of a register, and when we heard it."""

    value: int
    at_us: int


class ToldUnits(NamedTuple):
    """Units of a block that one member was the first to tell.

    A robot keeps one for nearly each unit of a field, so they are kept as numbers of eight bytes, one
    behind the other. As objects they were most of what a robot grew by in a day.
    """

    bits: int
    sender: int
    at_us: int


FIELDS: Final = len(ToldUnits._fields)
INT64: Final = "q"  # type code of `array`
assert BLOCK_UNITS_MAX < 63, "the units of a block are the bits of one number"


def _read(told: "array[int]") -> Iterator[ToldUnits]:
    for k in range(0, len(told), FIELDS):
        yield ToldUnits(told[k], told[k + 1], told[k + 2])


class Revocation(NamedTuple):
    """The member whose words are void, since when, and the ones that can tell again what they know."""

    revoked: int
    compromised_at_us: int | None  # what was heard before it remains; None: nothing does
    live: frozenset[int]  # the members on the bus, which take out the same


class Vouchers:
    """What each member has said, by register and by block, as one robot has heard it."""

    def __init__(self, slot: int, generation: int = 0) -> None:
        """`slot`: ours. `generation`: of the fleet's keys under which we hear."""
        self.slot, self.generation = slot, generation
        # Our memory is lost: what members say that we have said counts as our word. Nobody else may say
        # it in our name, so without this nobody could tell it to a member that lacks it.
        self.forgot = False
        self._said: dict[int, dict[int, list[Vouched]]] = {}  # section -> member -> rising values
        self._units: dict[int, array[int]] = {}  # by name of the block, `ToldUnits` in a row
        self._own: dict[int, int] = {}  # by name of the block: units that we covered ourselves

    def register(self, section: int, key: int, sender: int, now_us: int) -> None:
        """A member has said this of a section; ours too."""
        said = self._said.setdefault(section, {}).setdefault(sender, [])
        if said and key <= said[-1].value:
            return
        if len(said) == RISES_MAX:
            said.pop()
        said.append(Vouched(key, now_us))

    def adopts(self, key: int, sender: int) -> bool:
        """Whether a register that a member told becomes our word. `key`: of the register."""
        return self.forgot and owner_of(key) == self.slot != sender

    def said_by(self, section: int, member: int) -> int:
        """The greatest that a member has said of a section; 0: nothing that we heard."""
        said = self._said.get(section, {}).get(member)
        return said[-1].value if said else 0

    def units(self, name: int, new_bits: int, sender: int, now_us: int) -> None:
        """A member told units that were new to us. `name`: of the block."""
        told = self._units.get(name)
        if told is None:
            told = self._units[name] = array(INT64)
        told.extend((new_bits, sender, now_us))
        assert len(told) <= BLOCK_UNITS_MAX * FIELDS

    def cover(self, name: int, bits: int) -> None:
        """We covered units ourselves. `name`: of the block."""
        self._own[name] = self._own.get(name, 0) | bits

    def own(self, name: int) -> int:
        """The units of a block that we covered ourselves, one bit each. `name`: of the block."""
        return self._own.get(name, 0)

    @property
    def own_blocks(self) -> list[int]:
        """The names of all blocks of which we covered units."""
        return sorted(self._own)

    def forget(self, section: int) -> dict[int, list[Vouched]]:
        """The register of a section was taken out; returns what was said of it."""
        return self._said.pop(section, {})

    def restore(self, section: int, said: dict[int, list[Vouched]]) -> None:
        """The register of a section has come back, as it was."""
        for member, values in said.items():
            for value in values:
                self.register(section, value.value, member, value.at_us)

    def registers_without(self, void: Revocation, present: dict[int, int]) -> dict[int, int | None]:
        """The sections whose register changes, and the greatest value that remains; None: nothing.

        `present`: all registers. A value for which nobody vouched remains, except of its owner."""
        found: dict[int, int | None] = {}
        for section, key in present.items():
            said, kept = self._said.get(section, {}), dict[int, list[Vouched]]()
            for sender, values in said.items():
                left = [v for v in values if not self._is_void(v, sender, void)]
                if left:
                    kept[sender] = left
            rest = [values[-1].value for values in kept.values()]
            nobodys = all(values[-1].value != key for values in said.values())
            if nobodys and (void.compromised_at_us is not None or owner_of(key) != void.revoked):
                rest.append(key)
            if kept:
                self._said[section] = kept
            else:
                self._said.pop(section, None)
            greatest = max(rest, default=None)
            if greatest != key:
                found[section] = greatest
        return found

    def _is_void(self, said: Vouched, sender: int, void: Revocation) -> bool:
        # We never tell what others said in our name, so a lie that we alone heard would stay here alone.
        # Our own words are vouched for by us, and robots that believe the lie tell it to us again.
        if owner_of(said.value) == self.slot != sender and not self.forgot:
            return True
        if void.compromised_at_us is not None and said.at_us < void.compromised_at_us:
            return False
        owner = owner_of(said.value)
        if void.revoked in (sender, owner):
            return True
        return sender not in (owner, self.slot) and sender in void.live

    def blocks_without(self, void: Revocation) -> dict[int, int]:
        """By name of the block: the units that are void."""
        found: dict[int, int] = {}
        for name, told in list(self._units.items()):
            kept, bits = array(INT64), 0
            for units in _read(told):
                late = void.compromised_at_us is None or units.at_us >= void.compromised_at_us
                if units.sender == UNKNOWN:  # whenever that was
                    late = True
                if late and (units.sender in (void.revoked, UNKNOWN) or units.sender in void.live):
                    bits |= units.bits
                else:
                    kept.extend(units)
            if bits:
                self._units[name] = kept
                found[name] = bits & ~self.own(name)
        return found
