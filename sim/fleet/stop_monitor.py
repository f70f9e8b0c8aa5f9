"""What people did about stops in a cluster, told to the checker of S1: who must stand, and from when.

A stop binds a robot until three things were done about it, in this order: an operator cleared a stop,
reset that machine, and gave it a start. What a robot believes about any of this plays no part.
"""

from collections.abc import Callable, Collection
from enum import IntEnum

from agent.interface.config import MS, beat_of
from protocol.frames.safety_frames import Command, EmergencyReset, OperatorCommand
from sim.can.can_segment import Wire
from sim.world.checkers import MotionAfterStopChecker, Violation
from sim.world.protocol_world import CommandChecker, ProtocolWorld
from sim.world.world import World

EVERYBODY, NOBODY = 255, -1
REACTION_US = 20 * MS  # a tick and a frame's jitter on top of the silence that stops in the end


def motions(world: World) -> MotionAfterStopChecker | CommandChecker:
    """A checker of who moves, that sees all of it from now on."""
    return world.checker() if isinstance(world, ProtocolWorld) else MotionAfterStopChecker(world)


class Stage(IntEnum):
    PRESSED = 0
    CLEARED = 1
    RESET = 2


class StopMonitor:
    def __init__(
        self,
        world: World,
        robots: int,
        up: Callable[[], Collection[int]] | None = None,
        mute: Callable[[], Collection[int]] = tuple,
        hearers: Callable[[], Collection[int]] = tuple,
        now_us: Callable[[], int] = lambda: 0,
    ) -> None:
        """`up`: the robots that are switched on; all of them, where nothing is given. `mute`: those of
        them that have no address. `hearers`: those that hear a device that comes on the bus, if all
        of them do."""
        self.checker = motions(world)
        self._up = up if up is not None else lambda: range(robots)
        self._mute, self._hearers, self._now_us = mute, hearers, now_us
        self.bound_us = beat_of(robots).silence_us + REACTION_US
        self._stages: dict[int, dict[int, Stage]] = {}  # press -> slot -> what was done since
        self._pressed_us: dict[int, int] = {}
        self._by: dict[int, int] = {}  # press -> who was pressed
        self._know: dict[int, set[int]] = {}  # press -> who heard it and has kept its memory since
        self._unheard: dict[int, frozenset[int]] = {}  # press -> those that have not heard it
        self._levels: dict[int, set[int]] = {}  # stops of devices that hold while they are said
        self._disturbed_us = 0  # until then not all hear all
        self.disturbances = 0
        self._unsaid: set[int] = set()  # presses of who had no address to say it from

    @property
    def violations(self) -> list[Violation]:
        return self.checker.violations

    def pressed(
        self, now_us: int, slots: Collection[int], unheard: Collection[int] = (), by: int = NOBODY
    ) -> None:
        """A stop that all of these have to obey; `unheard`: some of them only because who was pressed,
        `by`, is silent to them."""
        number = self.checker.press(now_us, self.bound_us, slots)
        self._pressed_us[number], self._by[number] = now_us, by
        self._stages[number] = dict.fromkeys(slots, Stage.PRESSED)
        self._know[number] = set(slots) - set(unheard)
        self._unheard[number] = frozenset(unheard)
        if by in self._mute():
            self._unsaid.add(number)

    # ---------------------------------------------------------------- levels

    @property
    def calm(self) -> bool:
        """All hear all."""
        return self._now_us() >= self._disturbed_us and bool(self._hearers())

    def level(self, bound_us: int) -> int | None:
        """A device that all hear begins to say a stop: nobody moves from `bound_us` on until it ends.
        None: nobody can tell who hears it."""
        if not self.calm:
            return None
        slots = self._hearers()
        number = self.checker.press(self._now_us(), bound_us, slots)
        self._levels[number] = set(slots)
        return number

    def obey(self, number: int | None) -> set[int]:
        """Those that such a stop binds still."""
        return set() if number is None else set(self._levels.get(number, ()))

    def end_level(self, number: int | None) -> None:
        if number is not None and number in self._levels:
            del self._levels[number]
            self.checker.release(number)

    def disturbed(self, until_us: int) -> None:
        """Trouble of links or members, until then."""
        self._disturbed_us, self.disturbances = (
            max(self._disturbed_us, until_us),
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
        """A frame that an operator sends."""
        if isinstance(order, EmergencyReset):
            self._never_said()
            self._advance(EVERYBODY, Stage.PRESSED)
        elif isinstance(order, OperatorCommand) and order.command == Command.MANUAL_RESET:
            self._unremembered()
            self._advance(order.target, Stage.CLEARED)
        elif isinstance(order, OperatorCommand) and order.command == Command.START:
            self._advance(order.target, Stage.RESET)

    def forgets(self, slot: int) -> None:
        """Its memory is lost. Where that of all who heard is, nobody can show an operator what to clear:
        who then resets and starts a machine that stands because it remembers nothing releases it; and
        who stood because of a silence is free when that is over."""
        for number, know in self._know.items():
            know.discard(slot)
            for other in [] if know else self._unheard[number]:
                self._free(number, other)

    def _unremembered(self) -> None:
        """A stop that only machines remember that are switched off is shown to no operator either. Who
        boots with it in its memory tells it, and all stand again."""
        up = set(self._up())
        for number, stages in self._stages.items():
            for slot, stage in [] if self._know[number] & up else list(stages.items()):
                stages[slot] = max(stage, Stage.CLEARED)

    def _never_said(self) -> None:
        """A stop that is cleared while who was pressed still waits for an address: nobody else has heard
        of it, or ever will."""
        mute = self._mute()
        for number in [number for number in self._unsaid if self._by[number] in mute]:
            for slot in set(self._stages.get(number, ())) - {self._by[number]}:
                self._free(number, slot)

    def interrupted(self, since_us: int) -> None:
        """A stop that was pressed since then may not have been heard but by who was pressed."""
        for number, pressed_us in self._pressed_us.items():
            if pressed_us > since_us:
                self._unheard[number] |= self._know[number] - {self._by[number]}
                self._know[number] &= {self._by[number]}

    def dies_hung(self, slot: int, since_us: int) -> None:
        """Its process hung since then: what was pressed meanwhile it has never read."""
        for number, pressed_us in self._pressed_us.items():
            if pressed_us >= since_us:
                self._know[number].discard(slot)
                self._unheard[number] |= {slot}

    def doubled(self, slot: int) -> None:
        """Another machine says that it is this robot: its silence holds nobody any longer."""
        for number, by in list(self._by.items()):
            for other in self._unheard[number] if by == slot else ():
                self._free(number, other)

    def boots(self, slot: int) -> None:
        """A new life has met nobody whose silence could stop it, and no device that says a stop."""
        self.disturbances += 1
        self._leave_levels(slot)
        for number, unheard in self._unheard.items():
            if slot in unheard:
                self._free(number, slot)

    def carried(self, slot: int) -> None:
        """A person moves this robot by hand: it no longer stands because it was told to."""
        self._leave_levels(slot)
        for number in list(self._stages):
            self._free(number, slot)

    def _free(self, number: int, slot: int) -> None:
        if self._stages.get(number, {}).pop(slot, None) is not None:
            self.checker.release(number, (slot,))

    def _advance(self, target: int, at: Stage) -> None:
        for number, stages in list(self._stages.items()):
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
    """Nodes that hear the sender, or somebody who does, on the bus as it is now."""
    found, ask = {sender}, [sender]
    while ask and wire.faults.loss < 1.0:
        node = ask.pop()
        for other in nodes:
            here, there = wire.nodes[node], wire.nodes[other]
            off = here.off_until_us is not None or there.off_until_us is not None
            cut = off or here.island != there.island
            if other not in found and not cut and (node, other) not in wire.faults.deaf:
                found.add(other)
                ask.append(other)
    return found
