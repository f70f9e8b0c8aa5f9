"""Which members differ from us, judged from the digests in heartbeats.

A digest that we have now, or had a short time ago, is *explained*: its sender is in step or behind.
A sender that is behind asks us. Any other digest is *odd*: the sender knows something that we do
not.

One odd digest proves nothing while work goes on, because a peer's own operation is in its digest
before its frame is on the bus. It counts when it is confirmed: by the next heartbeat of the same
peer, by another peer with the same digest, or immediately if it comes from a peer that was absent
until just now, where we expect a difference.
"""

from collections import Counter
from typing import NamedTuple

from protocol.sync.replica import NEVER, Replica, ReplicaVersion


class DigestMismatch(NamedTuple):
    """A peer's digest that is none of ours, present or past."""

    digest: int
    heard_at_us: int
    confirmed: bool


class Divergence:
    """What this peer knows about how far each live member's replica agrees with its own."""

    def __init__(self, slot: int, replica: Replica) -> None:
        self.slot, self.replica = slot, replica
        self.live: frozenset[int] = frozenset({slot})
        self.odd: dict[int, DigestMismatch] = {}
        self.suspects: set[int] = set()  # newly live peers, not received in step since
        self.reunion = False  # a suspect was odd: two parts of the bus met, or we are new here
        self._told: dict[int, int] = {}  # live slot -> digest in its latest heartbeat
        self._own_told: int | None = None  # digest in our latest heartbeat
        self._agreed: dict[int, ReplicaVersion] = {}  # slot -> our latest version that it also had
        # Slot -> sum of our entries when it appeared, until it agrees.
        self._met: dict[int, int] = {}

    def see(self, live: frozenset[int]) -> None:
        """Update the set of members that we receive now."""
        appeared = live - self.live - {self.slot}
        self.suspects = (self.suspects | appeared) & live
        self.live = live
        self._met.update(dict.fromkeys(appeared, self.replica.total))
        for slot in appeared | (self._told.keys() - live):
            self._told.pop(slot, None)
        for slot in self.odd.keys() - live:
            del self.odd[slot]
        self._end_of_reunion()

    def expect(self) -> None:
        """We join the bus, so expect every member to differ from us."""
        self.suspects = set(self.live - {self.slot})
        self._told.clear()

    def start_again(self) -> None:
        """All live members have changed their replicas: what they had says nothing of what they have."""
        others = self.live - {self.slot}
        self.odd.clear()
        self._agreed.clear()
        self._met = dict.fromkeys(others, self.replica.total)
        self.expect()

    def outgoing_digest(self) -> int:
        """The digest for our heartbeat. From now on it determines our position in the order."""
        self._own_told = self.replica.digest
        return self._own_told

    def on_digest(self, slot: int, digest: int, now_us: int) -> bool:
        """Process a live peer's digest; True if it is odd and confirmed."""
        self._told[slot] = digest
        moment = self.replica.when(digest)
        if moment is not None:
            self._met.pop(slot, None)
            self._explained(slot, moment)
            return False
        if slot in self._met:
            fork = self.replica.fork(digest, self._met[slot], self._agreed.get(slot, NEVER).version)
            if fork is not None:  # it has sent us all its entries; it will ask for those it lacks
                self._explained(slot, fork)
                return False
        before = self.odd.get(slot)
        confirmed = slot in self.suspects or any(
            odd.confirmed or odd.digest == digest for s, odd in self.odd.items() if s != slot
        )
        if before is not None and not confirmed:
            confirmed = before.confirmed or self.replica.when(before.digest) is None
        self.odd[slot] = DigestMismatch(digest, now_us, confirmed)
        if slot in self.suspects:
            self.suspects.discard(slot)
            self.reunion = True
        return confirmed

    def _explained(self, slot: int, moment: ReplicaVersion) -> None:
        known = self._agreed.get(slot, NEVER)
        if moment.version >= known.version:
            self._agreed[slot] = moment
        self.suspects.discard(slot)
        odd = self.odd.pop(slot, None)
        if odd is not None:  # one peer stands for its class: the others had the same digest
            for other in [s for s, o in self.odd.items() if o.digest == odd.digest]:
                del self.odd[other]
            self._end_of_reunion()

    def _end_of_reunion(self) -> None:
        if not self.odd:
            self.reunion = False

    def still_odd(self, start_at_us: int) -> bool:
        """Whether a digest received after `start_at_us` is still unexplained by what we learned."""
        for slot, odd in list(self.odd.items()):
            moment = self.replica.when(odd.digest)
            if moment is not None:
                self.odd.pop(slot)
                self._agreed[slot] = max(moment, self._agreed.get(slot, NEVER))
        self._end_of_reunion()
        return any(odd.confirmed and odd.heard_at_us > start_at_us for odd in self.odd.values())

    # ---------------------------------------------------------------- how far we agree

    def agreed_with(self, slot: int, digest: int) -> ReplicaVersion:
        """Our latest version that this peer, or one with the same digest, also had."""
        alike = [s for s, told in self._told.items() if told == digest]
        return max((self._agreed.get(s, NEVER) for s in (slot, *alike)), default=NEVER)

    def was_away(self, slot: int) -> bool:
        """Whether we have not agreed with it since it appeared."""
        return slot in self._met

    def forget(self, slot: int) -> None:
        """The peer agrees with no member, because its memory is younger than ours."""
        self._agreed.pop(slot, None)

    @property
    def base(self) -> ReplicaVersion:
        """The latest version that all odd peers also had, as far as known."""
        moments = [self.agreed_with(slot, odd.digest) for slot, odd in self.odd.items()]
        return min((moment for moment in moments if moment != NEVER), default=NEVER)

    def has(self, slot: int, digest: int) -> bool:
        """Whether this digest is the latest one of this peer."""
        return self._told.get(slot) == digest

    @property
    def in_step(self) -> bool:
        """Whether the latest digest of every live peer is ours."""
        digest = self.replica.digest
        return all(self._told.get(s) == digest for s in self.live if s != self.slot)

    @property
    def outvoted(self) -> bool:
        """Whether at least half of the live members are odd or not received since they
        appeared."""
        return 2 * len(self.odd.keys() | self.suspects) >= len(self.live)

    # ---------------------------------------------------------------- order of speaking

    def order(self, without: int | None = None) -> list[int]:
        """Slots in the order in which they send, ours among them.

        Peers with equal digests form a class and could send the same entries, so the lowest slot of
        each class comes first. Peers of digest `without`, and those without a digest, are left out.
        """
        told = dict(self._told)
        told[self.slot] = self.replica.digest if self._own_told is None else self._own_told
        size: Counter[int] = Counter()
        places = []
        for slot in sorted(told):
            digest = told[slot]
            if digest != without or slot == self.slot:
                places.append((size[digest], slot))
                size[digest] += 1
        return [slot for _, slot in sorted(places)]

    def place(self, without: int | None = None) -> int:
        """The index of our slot in `order`: 0 sends first. `without` is a digest, as there."""
        return self.order(without).index(self.slot)
