"""Positions of silent members: obstacles for path planning, and where a dead robot's load is.

A robot that received the last beat knows the position. Robots that were away or have restarted
since get it by a FALLEN frame. For each member the latest frame counts, by time stamps of a clock
that the fleet shares (hybrid clock, `crdt/hybrid_clock.py`). So all robots know the same position,
bit for bit, and joint plans avoid it. A member that is received is not an obstacle. A position seen
to be free is announced as free, because a robot may have driven on while it was not received.

A stamp has 22 bits, so stamps return after twelve days. They are compared on a circle, where the half
ahead is later. So no position may grow older than a quarter: then it is forgotten if its member is
received, and otherwise every robot moves its stamp on by the same quarter.
"""

from collections.abc import Callable, Iterable

from agent.interface.config import MS, S
from agent.interface.geometry import Point
from agent.interface.mission import FleetView
from agent.motion.stopping_zone import seen_through
from crdt.hybrid_clock import HybridClock
from protocol.frames.agreement_frames import FALLEN, STAMP_MAX, SilentPosition
from protocol.frames.fleet_frames import NOWHERE_M

DEAD_US = 5 * S  # a member silent for this long is an obstacle, and rounds do not wait for it
TICK_US = 250 * MS  # period of the common clock
TOLD_US = 5 * S  # one robot repeats each position this often, for robots that were away
HURRY_US = 300 * MS  # repeat interval while a round waits until all know the same
SPACED_US = 40 * MS  # between slots, so that one robot sends and the others overhear it
WORDS_A_BEAT = 2
STAMPS = STAMP_MAX + 1
OLD_STAMPS = STAMPS // 4  # three days
TICKS_MAX = 1 << 48  # of the clock itself, which does not end
SURE_M = 2.0  # up to here two neighbouring rays are less than a body's radius apart


class SilentRobots:
    """The positions that one robot knows. `known`: newest frame by slot; `dead`: (x, y) metres by
    slot of the bodies that stand now.
    """

    def __init__(
        self, slot: int, now_us: int, on_map: Callable[[Point], bool] = lambda at: True
    ) -> None:
        """`slot`: ours. `on_map`: whether (x, y) metres is on the map of the building, which is the
        same for all robots; other places are counted in `refused`.
        """
        self.slot, self._on_map = slot, on_map
        self.refused = 0  # places beside the map, where no body can stand
        self.clock = HybridClock(now_us, TICK_US, TICKS_MAX)  # in full; stamps are its low bits
        self.known: dict[int, SilentPosition] = {}
        self.dead: dict[int, Point] = {}  # bodies that stand now
        self._due_at_us: dict[int, int] = {}  # slot -> when we send its position next
        self._heard_at_us: dict[int, int] = {}  # slot -> time of the beat in our record

    def observe(self, view: FleetView) -> None:
        """Once each control period: update which members are silent and which are back."""
        now_us = view.now_us
        self._renew(view)
        for slot, silent_at_us in view.fell_silent_at_us.items():
            neighbour = view.neighbours.get(slot)
            if neighbour is None or now_us - silent_at_us <= DEAD_US:
                continue
            if self._heard_at_us.get(slot) != neighbour.heard_at_us:
                self._heard_at_us[slot] = neighbour.heard_at_us
                stamp = self._stamp(neighbour.heard_at_us)
                word = SilentPosition(neighbour.pose.x_m, neighbour.pose.y_m, slot, stamp)
                # Pack and unpack, so that we store the same rounded numbers that we send.
                word = FALLEN.unpack(FALLEN.pack(word))
                if self._sound(word):
                    self._join(word, now_us)
                else:
                    self.refused += 1
        self.dead = {
            slot: (word.x_m, word.y_m)
            for slot, word in sorted(self.known.items())
            if slot not in view.live and self._silent(slot, view) and word.x_m > NOWHERE_M
        }
        for slot, place in list(self.dead.items()):
            # It drove on without being received, or was moved. Rays from a place that is not believed
            # tell nothing of it.
            if view.placed and seen_through(view.here, place, SURE_M):
                gone = SilentPosition(NOWHERE_M, NOWHERE_M, slot, self._stamp(now_us))
                self._join(gone, now_us)
                self._due_at_us[slot] = now_us
                del self.dead[slot]

    def _stamp(self, at_us: int) -> int:
        return self.clock.read(at_us) % STAMPS

    def _witness(self, stamp: int, now_us: int) -> None:
        """Follow a stamp ahead of us. Before the first stamp of our clock there was none, so there
        every other one is ahead."""
        own = self.clock.read(now_us)
        ahead = (stamp - own) % STAMPS
        if ahead < STAMPS // 2 or own + ahead < STAMPS:
            self.clock.witness(own + ahead, now_us)

    def _renew(self, view: FleetView) -> None:
        """Let no position grow so old that a later stamp could count as earlier."""
        now = self.clock.read(view.now_us)
        for slot, word in list(self.known.items()):
            age = (now - word.stamp) % STAMPS
            if not OLD_STAMPS <= age < STAMPS // 2:
                continue
            if slot in view.live:
                del self.known[slot]
                self._due_at_us.pop(slot, None)
            else:
                stamp = (word.stamp + age // OLD_STAMPS * OLD_STAMPS) % STAMPS
                self.known[slot] = word._replace(stamp=stamp)

    def _silent(self, slot: int, view: FleetView) -> bool:
        """Whether a member is silent for longer than between two beats.

        A member that we never received is known only from others' frames, and counts as silent.
        """
        silent_at_us = view.fell_silent_at_us.get(slot)
        return silent_at_us is None or view.now_us - silent_at_us > DEAD_US

    def on_message(self, word: SilentPosition, now_us: int) -> None:
        """Take in another robot's frame about a silent member; one about us is ignored."""
        if word.slot == self.slot:
            return
        if not self._sound(word):
            self.refused += 1
            return
        self._witness(word.stamp, now_us)
        self._join(word, now_us)

    def _sound(self, word: SilentPosition) -> bool:
        """Whether its place is on the map, or it says that the member stands nowhere."""
        return word.x_m <= NOWHERE_M or self._on_map((word.x_m, word.y_m))

    def _join(self, word: SilentPosition, now_us: int) -> None:
        known = self.known.get(word.slot)
        wait_for_us = TOLD_US
        if known is None or _outranks(word, known):
            self.known[word.slot] = word
        elif word != known:
            wait_for_us = 0  # the sender's knowledge is older, so answer without delay
        self._due_at_us[word.slot] = now_us + wait_for_us + self.slot * SPACED_US

    def outgoing(self, hurried: bool, now_us: int) -> Iterable[SilentPosition]:
        """The frames that are due with our beat, at most `WORDS_A_BEAT`.

        `hurried`: a round of agreement waits until all robots know the same, so repeat more often.
        """
        soon_for_us = TOLD_US - HURRY_US if hurried else 0
        due = [s for s, due_at_us in self._due_at_us.items() if due_at_us - soon_for_us <= now_us]
        for slot in due[:WORDS_A_BEAT]:
            self._due_at_us[slot] = now_us + TOLD_US + self.slot * SPACED_US
            yield self.known[slot]


def _outranks(word: SilentPosition, known: SilentPosition) -> bool:
    ahead = (word.stamp - known.stamp) % STAMPS
    if ahead:
        return ahead < STAMPS // 2
    return (word.x_m, word.y_m) > (known.x_m, known.y_m)
