"""What one peer keeps over a restart: the record keys and what they hold.

Own operations are numbered before they are sent. Registers and progress are kept so that a fleet
that loses power as a whole loses no work. The stop records belong to
`agent/safety/stop_controller.py`.

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
from agent.peer.part import NOTHING, Outputs, Part, StepContext
from crdt import FieldAllocationCRDT, Progress
from crdt.occupancy import PATCH_BYTES, OccupancyMap

U16, U32, U64 = Struct("<H"), Struct("<I"), Struct("<Q")
VOTE = Struct("<HB")

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
        self.term = VOTE.unpack(raw)[0] + 1 if len(raw) == VOTE.size else 0

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

    def restore(self, allocation: FieldAllocationCRDT, progress: Progress) -> None:
        """Restore the records. One that does not parse is skipped, because peers have it too."""
        for key, raw in sorted(self.recalled.items()):
            if key.startswith(REGISTER) and len(raw) == U64.size:
                allocation.apply(int(key.removeprefix(REGISTER)), U64.unpack(raw)[0])
            elif key.startswith(PROGRESS) and len(raw) == U64.size:
                section, block = key.removeprefix(PROGRESS).split("/")
                progress.apply(int(section), int(block), U64.unpack(raw)[0])

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
    def operation(count: int, section: int, key: int) -> tuple[tuple[str, bytes], ...]:
        """The records of an own operation: the register after it, and the number of operations so
        far.
        """
        return (f"{REGISTER}{section}", U64.pack(key)), (OPERATIONS, U32.pack(count))

    @staticmethod
    def progress(section: int, block: int, bits: int) -> tuple[str, bytes]:
        """The record of 40 units of a section: key and value. `bits`: one for each unit."""
        return f"{PROGRESS}{section}/{block}", U64.pack(bits)

    @staticmethod
    def vote(term: int, candidate: int) -> tuple[str, bytes]:
        """The record of our newest vote: key and value. `candidate`: the slot that we voted for."""
        return ELECTION, VOTE.pack(term, candidate)
