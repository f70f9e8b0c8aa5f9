"""What an operator has been shown of the stops that hold robots, and so what a reset may clear.

Latched robots send their stops by name, some at a time, and all of them in sum (STOPS_HELD). With keys
a robot's sum has a tag, and names are believed only if they add up to it. The reason: any device can
send a stop that was never pressed, and could keep a reset signed for it until that stop is pressed.
A stop that is pressed after the operator asked for a release was not shown, so it is not cleared.
"""

from collections.abc import Collection
from secrets import randbits

from crdt.stops import RemoteStopDot, RemoteStopSet, StopDot, StopSet, held_digest
from protocol.authentication import Keyring
from protocol.fleet_tags import QUESTION_BITS, HeldTags
from protocol.frames.safety_frames import EmergencyStop, StopsHeld

NAMED_MAX = 64  # resets by name; more are cleared in sum. With tags, twice each, 0.1 s of bus
HEARD_MAX = 4096  # names that are kept; a device that sends more of them floods the bus


class ShownStops:
    """Collects stops by name and in sum, as robots tell them. Stops that are pressed after the operator
    asked for a release are left alone."""

    def __init__(self, keyring: Keyring | None) -> None:
        secret = None if keyring is None else keyring.keys.operator
        self.signed = keyring is not None
        self._tags = None if keyring is None or secret is None else HeldTags(keyring.keys)
        self.question = randbits(QUESTION_BITS)  # unknown to others before it is asked
        self.near: set[tuple[int, int, int]] = set()
        self.recounted: set[StopDot] = set()  # names that were heard since the newest `recount`
        self.recounted_far: set[RemoteStopDot] = set()
        self.counts: dict[int, int] = {}  # of stops that robots hold, told since then
        self.far: set[RemoteStopDot] = set()
        self.spent: set[tuple[int, int, int]] = set()  # names that robots say were used before
        self.told: dict[int, StopsHeld] = {}  # by robots; with keys only what they have signed
        self.latched: set[int] = set()  # robots that have answered the newest question
        self.refused = 0  # answers without a valid tag
        self._asked = self._releasing = False
        self._pressed: set[StopDot | RemoteStopDot] = set()  # since the operator asked
        # What robots that had not answered before said after such a press: it may hold them, too.
        self._told_late: dict[int, StopsHeld] = {}

    def hear_stop(self, m: EmergencyStop) -> None:
        """Take a stop of this segment. A press that comes after a release was asked for is not cleared.

        A robot repeats its press until the others have echoed it, for a moment. So a press that is heard
        may have begun earlier, and waits for the next release."""
        dot = StopDot(m.slot, m.incarnation, m.counter)
        if m.spent:
            if len(self.spent) < HEARD_MAX:
                self.spent.add(dot)
            return
        if len(self.recounted) < HEARD_MAX:
            self.recounted.add(dot)
        if self._is_shown(dot, dot in self.near, m.echo) and len(self.near) < HEARD_MAX:
            self.near.add(dot)

    def _is_shown(self, dot: StopDot | RemoteStopDot, known: bool, told: bool) -> bool:
        """Whether a stop was there when the operator asked. `told`: it is repeated, and no new press."""
        if known or not self._asked:
            return True
        if not told and len(self._pressed) < HEARD_MAX:
            self._pressed.add(dot)
        return dot not in self._pressed and len(self._pressed) < HEARD_MAX

    def hear_held(self, m: StopsHeld) -> None:
        """Take what one robot says of all its stops. With keys its tag must fit our question."""
        if self.signed and (self._tags is None or self._tags.sign(m, self.question) != m):
            self.refused += 1
            return
        self.latched.add(m.slot)
        self.counts[m.slot] = m.stops
        before = self.told.get(m.slot)
        if self._asked and before is not None and m.stops > before.stops:
            return
        if not self._pressed:
            self.told[m.slot] = m
        elif before is None:
            self._told_late[m.slot] = m

    def hear_far(self, dot: RemoteStopDot, told: bool) -> None:
        """Take a stop of another segment. `told`: it is repeated, and no new press."""
        if len(self.recounted_far) < HEARD_MAX:
            self.recounted_far.add(dot)
        shown = self._is_shown(dot, dot in self.far, told) and not self._releasing
        if shown and len(self.far) < HEARD_MAX:
            self.far.add(dot)

    def ask(self) -> None:
        """The operator asks for a release: a press that comes from now on was not shown."""
        self._asked = True

    def release(self) -> None:
        """From now on no stop of another segment is new."""
        self._asked = self._releasing = True

    def recount(self) -> None:
        """From now on `recounted` has what robots still hold. The names that were shown stay, because a
        robot does not say that it holds a stop no more."""
        self.recounted.clear()
        self.recounted_far.clear()
        self.counts.clear()

    @property
    def unnamed(self) -> bool:
        """Whether a robot holds more stops than were named since the newest `recount`."""
        away = sum(StopDot(*far[:3]) not in self.recounted for far in self.recounted_far)
        return max(self.counts.values(), default=0) > len(self.recounted) + away

    def ask_again(self) -> None:
        """From now on only answers to a new question count: an earlier one may be repeated by anybody."""
        self.question = randbits(QUESTION_BITS)
        self.latched.clear()

    @property
    def still_latched(self) -> frozenset[int]:
        """Robots that have signed that they are latched since the newest question, whatever is said in
        their names. Without keys nobody signs."""
        return frozenset(self.latched) if self.signed else frozenset()

    @property
    def sums(self) -> list[int]:
        """Digests of all that robots hold. One that was told after a press counts if the names of what
        was shown add up to it."""
        sums = {held.digest for held in self.told.values() if held.stops}
        late = {held.digest for held in self._told_late.values() if held.stops}
        if late - sums:
            late &= {_digest([StopDot(*dot) for dot in self.near], self.far)}
        return sorted(sums | late)

    @property
    def named(self) -> tuple[list[StopDot], list[RemoteStopDot]]:
        """Stops to clear by name: so that a robot that has missed one does not latch by a late echo."""
        near, far = [StopDot(*dot) for dot in self.near], sorted(self.far)
        if len(near) + len(far) > NAMED_MAX or (self.signed and not self._adds_up(near, far)):
            return [], []
        return sorted(near), far

    def _adds_up(self, near: Collection[StopDot], far: Collection[RemoteStopDot]) -> bool:
        return _digest(near, far) in self.sums


def _digest(near: Collection[StopDot], far: Collection[RemoteStopDot]) -> int:
    """Of stops by name. A stop of the robots' own segment is said in both ways, and held once."""
    stops, beyond = StopSet(), RemoteStopSet()
    for dot in near:
        stops.press(dot)
    for away in far:
        if StopDot(*away[:3]) not in stops.active:
            beyond.press(away)
    return held_digest(stops, beyond)
