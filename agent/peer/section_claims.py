"""The claims of one peer: contested for a window, then held, then worked, one section at a time.

A claim is a hint that avoids duplicate work; safety never depends on it. It is announced, contested
for `CONTENTION_US`, and only then started. Every better claim arrives within this window, because
the response-time bound of TASK_CLAIM with 108 peers is 213 ms. Started work outranks a claim.
"""

from agent.interface.config import CLAIM_AHEAD, CONTENTION_US
from agent.interface.mission import ClaimRequest
from crdt import FieldAllocationCRDT, Phase


class SectionClaims:
    """Our claims and our section. Methods that change a register return its key to be announced, or
    None if it did not change.
    """

    def __init__(self, slot: int, allocation: FieldAllocationCRDT) -> None:
        self.slot, self.allocation = slot, allocation
        self.contest_ends_at_us: dict[int, int] = {}  # in the order in which they will be worked
        self.current: int | None = None  # the section being worked
        self.lost = 0  # claims and sections lost to a better claim

    @property
    def room(self) -> bool:
        """Whether another section may be claimed now."""
        return len(self.contest_ends_at_us) < (CLAIM_AHEAD if self.current is not None else 1)

    @property
    def next(self) -> int | None:
        """The section that is worked next; None if none is claimed."""
        return next(iter(self.contest_ends_at_us), None)

    def claim(self, choice: ClaimRequest, now_us: int) -> int | None:
        """The register key to announce, or None if the section is not available.

        A section of our own that we cannot hand over is taken up again, without a key."""
        section = choice.section
        if choice.takeover:
            key = self.allocation.takeover(section, self.slot, choice.bid)
        else:
            key = self.allocation.claim(section, self.slot, choice.bid)
        if key is not None:
            self.contest_ends_at_us[section] = now_us + CONTENTION_US
        elif self._stays_ours(section) and section != self.current:
            self.contest_ends_at_us[section] = now_us
        return key

    def start_due(self, now_us: int) -> int | None:
        """The section whose contention window has passed while our claim is still the best."""
        if self.current is not None or not self.contest_ends_at_us:
            return None
        section = self.next
        assert section is not None
        return section if self.contest_ends_at_us[section] <= now_us else None

    def start(self, section: int) -> int | None:
        """Start a section whose contention window has passed; returns the register key to announce.
        Without one it is `current` if it was started before, else the claim was lost."""
        key = self.allocation.start(section, self.slot)
        del self.contest_ends_at_us[section]
        if key is not None or self._stays_ours(section):
            self.current = section
        return key

    def works(self, section: int) -> bool:
        """Whether we have started this section and hold it."""
        return self.current == section

    def _stays_ours(self, section: int) -> bool:
        return self.allocation.stays(section) and self.allocation.owner_of(section) == self.slot

    def finish(self) -> int | None:
        """The current section is done; returns the register key to announce, or None."""
        assert self.current is not None
        section, self.current = self.current, None
        return self.allocation.done(section, self.slot)

    def drop(self, section: int) -> int | None:
        """Give a section back, unfinished."""
        self.contest_ends_at_us.pop(section, None)
        if self.current == section:
            self.current = None
        return self.allocation.release(section, self.slot)

    def recheck(self, sections: frozenset[int] | set[int]) -> list[int]:
        """After a merge: which of these sections we have lost."""
        lost = []
        for section in sorted(sections):
            ours = section in self.contest_ends_at_us or section == self.current
            done = self.allocation.phase_of(section) is Phase.DONE
            if ours and (done or self.allocation.owner_of(section) != self.slot):
                self.contest_ends_at_us.pop(section, None)
                if self.current == section:
                    self.current = None
                self.lost += 1
                lost.append(section)
        return lost

    @property
    def due_at_us(self) -> int | None:
        """When the contention window of the next section ends; None if nothing waits."""
        if self.current is not None or not self.contest_ends_at_us:
            return None
        return next(iter(self.contest_ends_at_us.values()))
