"""Tells the checker of S1 what people did about stops: which robots must stand, and from when.

A stop binds a robot until three things were done, in this order: an operator cleared a stop, reset
that machine, and gave it a start. A robot's own belief about this does not matter.
"""

from collections.abc import Callable, Collection
from enum import IntEnum

from agent.interface.config import MS, STOP_SPACING_US, beat_of
from protocol.frames.safety_frames import EVERYBODY, Command, EmergencyReset, OperatorCommand
from sim.can.can_wire import Wire
from sim.world.checkers import MotionAfterStopChecker, Violation
from sim.world.protocol_world import CommandChecker, ProtocolWorld
from sim.world.world import World

NOBODY = -1
REACTION_US = 20 * MS  # a tick and a frame's jitter, in addition to the silence limit


def motions(world: World) -> MotionAfterStopChecker | CommandChecker:
    """A checker of motion that observes every robot from now on."""
    return world.checker() if isinstance(world, ProtocolWorld) else MotionAfterStopChecker(world)


class Stage(IntEnum):
    """How far people have come with the release of a stopped robot."""

    PRESSED = 0
    CLEARED = 1
    RESET = 2


class StopMonitor:
    """Follows presses, resets and starts of people, and tells the checker which robots must stand
    from when to when."""

    def __init__(
        self,
        world: World,
        robots: int,
        up: Callable[[], Collection[int]] | None = None,
        mute: Callable[[], Collection[int]] = tuple,
        hearers: Callable[[], Collection[int]] = tuple,
        now_us: Callable[[], int] = lambda: 0,
        silence_stops: bool = True,
    ) -> None:
        """`up`: the robots that are switched on; default: all. `mute`: those of them without an
        address. `hearers`: those that receive a device that joins the bus, if all of them do.
        `silence_stops`: whether the silence of a robot stops the others, by the fleet's policy."""
        self.checker = motions(world)
        self._up = up if up is not None else lambda: range(robots)
        self._mute, self._hearers, self._now_us = mute, hearers, now_us
        self._silence_stops = silence_stops
        beat = beat_of(robots)
        self.bound_for_us = beat.silence_for_us + REACTION_US
        # For robots that do not hear the pressed one: an attacker that sends beats in its name hides its
        # silence until its proofs expire.
        self.hidden_for_us = beat.life_for_us + self.bound_for_us
        self._imitated_ends_at_us: dict[int, int] = {}  # slot -> until when its beats may be forged
        self._stages: dict[int, dict[int, Stage]] = {}  # press -> slot -> what was done since
        self._pressed_at_us: dict[int, int] = {}
        self._by: dict[int, int] = {}  # press -> the robot that was pressed
        # Press -> robots that received it and have kept their memory since.
        self._know: dict[int, set[int]] = {}
        self._unheard: dict[int, frozenset[int]] = {}  # press -> robots that have not received it
        # Stops of devices that bind while they are being sent.
        self._levels: dict[int, set[int]] = {}
        self._disturbed_ends_at_us = 0  # until then not all robots receive each other
        self.disturbances = 0
        self.cleared_at_us = 0  # when an operator last cleared stops
        self._unsaid: set[int] = set()  # presses of robots that had no address to send them from
        self._unsent: set[int] = set()  # presses whose stop frame has not been on the wire
        # Pressed robot -> the press that its last ones repeat.
        self._first_press: dict[int, int] = {}

    @property
    def violations(self) -> list[Violation]:
        """Movements that a stop forbade."""
        return self.checker.violations

    def pressed(
        self, now_us: int, slots: Collection[int], unheard: Collection[int] = (), by: int = NOBODY
    ) -> None:
        """A stop that all these robots have to obey. `unheard`: robots that must obey only because
        the pressed robot, `by`, is silent to them."""
        know = set(slots) - set(unheard)
        if unheard and self.is_imitated(by, now_us):
            self._press(now_us, know, (), know, by, self.bound_for_us)
            self._press(now_us, unheard, unheard, know, by, self.hidden_for_us)
        else:
            self._press(now_us, slots, unheard, know, by, self.bound_for_us)

    def imitated(self, slots: Collection[int], end_at_us: int) -> None:
        """Until then somebody without a key may send beats in the names of these robots."""
        for slot in slots:
            now_ends_at_us = self._imitated_ends_at_us.get(slot, 0)
            self._imitated_ends_at_us[slot] = max(now_ends_at_us, end_at_us)

    def is_imitated(self, slot: int, now_us: int) -> bool:
        """Whether somebody may send beats in the name of this robot now."""
        return now_us < self._imitated_ends_at_us.get(slot, 0)

    def _press(
        self, now_us: int, slots: Collection[int], unheard: Collection[int], know: Collection[int],
        by: int, bound_for_us: int,
    ) -> None:  # fmt: skip
        number = self.checker.press(now_us, bound_for_us, slots)
        self._pressed_at_us[number], self._by[number] = now_us, by
        self._stages[number] = dict.fromkeys(slots, Stage.PRESSED)
        self._know[number] = set(know)
        self._unheard[number] = frozenset(unheard)
        if by in self._mute():
            self._unsaid.add(number)
        if by != NOBODY and not self._repeats(number, by, now_us):
            self._unsent.add(number)

    def _repeats(self, number: int, by: int, now_us: int) -> bool:
        """Whether the robot takes this press for one that it has sent already, so sends no other
        frame."""
        first = self._first_press.get(by)
        if first is not None and now_us - self._pressed_at_us[first] < STOP_SPACING_US:
            return first not in self._unsent
        self._first_press[by] = number
        return False

    @property
    def waits(self) -> bool:
        """Whether a pressed robot has not yet put its stop on the wire."""
        return bool(self._unsent)

    @property
    def unsent(self) -> frozenset[int]:
        """Slots of the pressed robots that have not yet put their stop on the wire."""
        return frozenset(self._by[number] for number in self._unsent)

    def sent(self, slot: int, t_us: int) -> None:
        """A stop frame that names this slot as its origin was on the wire, completely."""
        self._unsent -= {
            number for number in self._unsent
            if self._by[number] == slot and self._pressed_at_us[number] <= t_us
        }  # fmt: skip

    def repeats(self, slot: int) -> None:
        """The newest press of this slot repeats a stop that it has sent by itself."""
        self._unsent.discard(max(number for number, by in self._by.items() if by == slot))

    # ---------------------------------------------------------------- levels

    @property
    def calm(self) -> bool:
        """Whether all robots receive each other."""
        return self._now_us() >= self._disturbed_ends_at_us and bool(self._hearers())

    def level(self, bound_for_us: int) -> int | None:
        """A device that all robots receive begins to send a stop: no robot may move from `bound_for_us`
        until it ends. None if the receivers cannot be determined."""
        if not self.calm:
            return None
        slots = self._hearers()
        number = self.checker.press(self._now_us(), bound_for_us, slots)
        self._levels[number] = set(slots)
        return number

    def obey(self, number: int | None) -> set[int]:
        """The robots that such a stop still binds."""
        return set() if number is None else set(self._levels.get(number, ()))

    def end_level(self, number: int | None) -> None:
        """End the stop of a shortcut button, by its number; None and numbers that are not in force
        do nothing."""
        if number is not None and number in self._levels:
            del self._levels[number]
            self.checker.release(number)

    def disturbed(self, end_at_us: int) -> None:
        """There is trouble of links or members until then."""
        self._disturbed_ends_at_us, self.disturbances = (
            max(self._disturbed_ends_at_us, end_at_us),
            self.disturbances + 1,
        )
        for number in list(self._levels):
            self.end_level(number)

    def _leave_levels(self, slot: int) -> None:
        for number, slots in list(self._levels.items()):
            if slots == {slot}:
                self.end_level(number)
            elif slot in slots:
                slots.remove(slot)
                self.checker.release(number, (slot,))

    # ---------------------------------------------------------------- what people do

    def ordered(self, order: object) -> None:
        """Handle a frame that an operator sends."""
        if isinstance(order, EmergencyReset):
            self.cleared_at_us = self._now_us()
            self._never_said()
            self._advance(EVERYBODY, Stage.PRESSED, order.slot)
        elif isinstance(order, OperatorCommand) and order.command == Command.MANUAL_RESET:
            self._unremembered()
            self._advance(order.target, Stage.CLEARED)
        elif isinstance(order, OperatorCommand) and order.command == Command.START:
            self._advance(order.target, Stage.RESET)

    def forgets(self, slot: int) -> None:
        """Its memory is lost. If all robots that received the stop have lost their memory, no robot
        can show an operator what to clear. Then a reset and a start release a machine that stands
        because it remembers nothing, and a robot that stood because of a silence is free when the
        silence ends."""
        for number, know in self._know.items():
            know.discard(slot)
            for other in [] if know else self._unheard[number]:
                self._free(number, other)

    def _unremembered(self) -> None:
        """A stop that only switched-off machines remember is shown to no operator either. A machine
        that boots with it in its memory sends it, and all robots stand again."""
        up = set(self._up())
        for number, stages in self._stages.items():
            for slot, stage in [] if self._know[number] & up else list(stages.items()):
                stages[slot] = max(stage, Stage.CLEARED)

    def _never_said(self) -> None:
        """A stop is cleared while the pressed robot still waits for an address: no other robot has
        received it, or ever will."""
        mute = self._mute()
        for number in [number for number in self._unsaid if self._by[number] in mute]:
            for slot in set(self._stages.get(number, ())) - {self._by[number]}:
                self._free(number, slot)

    def interrupted(self, start_at_us: int) -> None:
        """A stop pressed since then, or one that still waits for a full bus, may be known only to
        the robot that was pressed."""
        for number, pressed_at_us in self._pressed_at_us.items():
            if pressed_at_us > start_at_us or number in self._unsent:
                self._unheard[number] |= self._know[number] - {self._by[number]}
                self._know[number] &= {self._by[number]}
            if number in self._unsent and not self._silence_stops:
                # The pressed robot may be the one that is cut off, and its silence stops no robot.
                for other in set(self._stages.get(number, ())) - {self._by[number]}:
                    self._free(number, other)

    def dies_hung(self, slot: int, start_at_us: int) -> None:
        """Its process has hung since then, so it has never read stops pressed meanwhile."""
        for number, pressed_at_us in self._pressed_at_us.items():
            if pressed_at_us >= start_at_us:
                self._know[number].discard(slot)
                self._unheard[number] |= {slot}

    def dies(self, slot: int) -> None:
        """Its power fails. A stop of its own that was not sent is then known to no other robot, and
        its silence stops others only by the fleet's policy."""
        self._first_press.pop(slot, None)
        for number in [n for n in self._unsent if self._by[n] == slot]:
            self._unsent.discard(number)
            others = set(self._stages.get(number, ())) - {slot}
            self._unheard[number] |= others
            self._know[number] -= others
            for other in () if self._silence_stops else others:
                self._free(number, other)

    def doubled(self, slot: int) -> None:
        """Another machine claims to be this robot, so its silence no longer stops other robots."""
        for number, by in list(self._by.items()):
            for other in self._unheard[number] if by == slot else ():
                self._free(number, other)

    def boots(self, slot: int) -> None:
        """A restarted robot has met no member whose silence could stop it, and no device with a
        stop."""
        self.disturbances += 1
        self._leave_levels(slot)
        for number, unheard in self._unheard.items():
            if slot in unheard:
                self._free(number, slot)

    def _free(self, number: int, slot: int) -> None:
        if self._stages.get(number, {}).pop(slot, None) is not None:
            self.checker.release(number, (slot,))

    def _advance(self, target: int, at: Stage, by: int = NOBODY) -> None:
        """`by`: only what this robot was pressed for, and stops of other devices."""
        for number, stages in list(self._stages.items()):
            if by not in (NOBODY, self._by[number]) and self._by[number] != NOBODY:
                continue
            for slot, stage in list(stages.items()):
                if target not in (slot, EVERYBODY) or stage is not at:
                    continue
                if stage is Stage.RESET:
                    del stages[slot]
                    self.checker.release(number, (slot,))
                else:
                    stages[slot] = Stage(stage + 1)
            if not stages:
                del self._stages[number]


def reached(wire: Wire, sender: int, nodes: Collection[int]) -> set[int]:
    """Nodes that the sender reaches, directly or through other nodes, on the bus as it is now."""
    found, ask = {sender}, [sender]
    while ask and wire.faults.loss < 1.0:
        node = ask.pop()
        for other in nodes:
            here, there = wire.nodes[node], wire.nodes[other]
            off = here.off_ends_at_us is not None or there.off_ends_at_us is not None
            cut = off or here.island != there.island
            if other not in found and not cut and (node, other) not in wire.faults.deaf:
                found.add(other)
                ask.append(other)
    return found
