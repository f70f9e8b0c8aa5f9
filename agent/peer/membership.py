"""Who is in the fleet, as far as this peer hears: a fault detector over signs of life.

Any frame of a member is a sign of life, but for a claim of its address by one that may move: it has
been off the bus, and can say nothing else for a quarter of a second, not even that it was stopped. A
member that stops giving signs without having said that it leaves is *silent* after `beat.silence_us`;
what silence means is decided elsewhere (safety: brake; allocation: wait for the lease). There is no
suspicion level and no vote: on one bus segment everybody hears everybody, so a second opinion would
carry no information.

The oldest sign of life is looked for only when it may have become silence, a few times a second: what
is heard a thousand times a second, a beat, costs one write, that of its sender's newest pose.
"""

from enum import Enum, auto

from agent.interface.ports import Neighbour
from protocol.frames.fleet_frames import Pose

# After a farewell: frames that were sent before it, and wait behind those of others, have come by then.
FAREWELL_US = 250_000
DISBELIEVED_US = (
    10_000_000  # who went on speaking after a farewell had not said it: no other for so long
)


class MemberStatus(Enum):
    ABSENT = auto()  # configured, never heard since we booted
    LIVE = auto()
    SILENT = auto()  # was live, stopped without leaving
    LEFT = auto()  # said that it leaves
    WAIVED = auto()  # silent, and an operator said by name to go on without it


class Membership:
    def __init__(self, slot: int, configured: frozenset[int], silence_us: int, now_us: int) -> None:
        assert slot in configured
        self.slot, self.silence_us = slot, silence_us
        self.standing = {
            member: MemberStatus.ABSENT for member in sorted(configured) if member != slot
        }
        self.incarnation: dict[int, int] = {}
        self.neighbours: dict[int, Neighbour] = {}
        self.silent_since_us: dict[int, int] = {}
        self.changed_us = now_us  # when live or silent last changed
        self.live: frozenset[int] = frozenset({slot})
        self.silent: frozenset[int] = frozenset()
        self.slot_of: dict[int, int] = {}  # source address -> slot, from MEMBER frames
        self.strangers = 0  # frames of addresses that have not said which member they are
        self.signs_us: dict[int, int] = {}  # live others: last sign of life, but for newer poses
        self.void_farewells = 0  # of members that went on speaking
        self._left_us: dict[int, int] = {}
        self._void_us: dict[int, int] = {}
        self._oldest_us = now_us  # no sign of theirs is older

    def bind(self, source: int, slot: int, incarnation: int, now_us: int) -> bool:
        """A MEMBER frame: this address now speaks for that slot. False: not of this fleet."""
        if slot not in self.standing:
            return False
        for address in [a for a, s in self.slot_of.items() if s == slot and a != source]:
            del self.slot_of[address]  # the member has moved to another address
        self.slot_of[source] = slot
        self.incarnation[slot] = incarnation
        self.heard(slot, now_us)
        return True

    def unbind(self, source: int | None) -> None:
        """The address has changed hands: believe nothing from it until it says who it is."""
        if source is not None:
            self.slot_of.pop(source, None)

    @property
    def free(self) -> list[int]:
        """Members whose newest pose says that they do not stand stopped."""
        return [slot for slot, seen in self.neighbours.items() if not seen.pose.stopped]

    def stands(self, slot: int) -> bool:
        """Its newest pose says that it stands stopped."""
        seen = self.neighbours.get(slot)
        return seen is not None and seen.pose.stopped

    def heard(self, slot: int, now_us: int) -> bool:
        """A sign of life. True when this changed the membership."""
        heard = self.signs_us
        if slot in heard:
            heard[slot] = now_us
            return False
        if self.standing[slot] is MemberStatus.LEFT:
            if now_us - self._left_us[slot] <= FAREWELL_US:
                return False  # the tail of a farewell; a new MEMBER frame brings it back
            self.void_farewells += 1
            self._void_us[slot] = now_us
        if not heard:
            self._oldest_us = now_us
        heard[slot] = now_us
        self._stand(slot, MemberStatus.LIVE, now_us)
        return True

    def returned(self, slot: int, now_us: int) -> None:
        """A member that had left announces itself again."""
        if self.standing[slot] is MemberStatus.LEFT:
            self.standing[slot] = MemberStatus.ABSENT
            self.heard(slot, now_us)

    def pose(self, slot: int, pose: Pose, now_us: int) -> None:
        self.neighbours[slot] = Neighbour(pose, now_us)

    def leave(self, slot: int, now_us: int) -> None:
        """It says that it leaves. Void where it goes on speaking: then somebody else has said it."""
        if now_us - self._void_us.get(slot, now_us - DISBELIEVED_US) < DISBELIEVED_US:
            return
        if self.standing[slot] is MemberStatus.LEFT:
            return  # said again: its time counts from the first
        self._left_us[slot] = now_us
        self.signs_us.pop(slot, None)
        self.neighbours.pop(slot, None)
        self._stand(slot, MemberStatus.LEFT, now_us)

    def waive(self, slot: int, now_us: int) -> bool:
        """An operator accounts for a silent member by name."""
        if self.standing.get(slot) is not MemberStatus.SILENT:
            return False
        self._stand(slot, MemberStatus.WAIVED, now_us)
        return True

    @property
    def deadline_us(self) -> int | None:
        """When the oldest sign of life may become silence; `tick` puts that off in good time."""
        return self._oldest_us + self.silence_us if self.signs_us else None

    def tick(self, now_us: int) -> list[int]:
        """The members that have just fallen silent."""
        signs, silent_us = self.signs_us, now_us - self.silence_us
        if not signs or self._oldest_us > now_us - self.silence_us // 2:
            return []
        neighbours, oldest_us = self.neighbours, now_us
        fallen: list[tuple[int, int]] = []
        for slot, us in signs.items():
            seen = neighbours.get(slot)
            if seen is not None and seen.heard_us > us:
                us = seen.heard_us
            if us <= silent_us:
                fallen.append((us, slot))
            elif us < oldest_us:
                oldest_us = us
        self._oldest_us = oldest_us
        for _, slot in sorted(fallen):
            del signs[slot]
            self._stand(slot, MemberStatus.SILENT, now_us)
        return [slot for _, slot in sorted(fallen)]

    def forget_all(self, now_us: int) -> None:
        """We left the fleet ourselves: nobody's silence means anything to us now."""
        self.signs_us.clear()
        for slot in self.standing:
            self._stand(slot, MemberStatus.ABSENT, now_us)

    def _stand(self, slot: int, standing: MemberStatus, now_us: int) -> None:
        self.standing[slot] = standing
        self.changed_us = now_us
        if standing is MemberStatus.SILENT:
            self.silent_since_us[slot] = now_us
        elif standing is not MemberStatus.WAIVED:
            self.silent_since_us.pop(slot, None)
        states = self.standing.items()
        self.live = frozenset({self.slot, *(s for s, st in states if st is MemberStatus.LIVE)})
        self.silent = frozenset(s for s, st in states if st is MemberStatus.SILENT)
