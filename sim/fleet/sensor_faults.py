"""The position receiver between a body and its robot, with its driver, and their faults.

A receiver lives in the world's time and reports in its robot's time. A fault lasts until its time
is over, even if the robot's process restarts meanwhile, because it is a fault of the machine.
"""

from collections import deque
from math import hypot, inf
from random import Random

from agent.interface.config import S
from agent.interface.effects import GatedDrive
from agent.interface.observation import Observation
from agent.interface.ports import Body
from sim.fleet.scheduler import Host

# A receiver works on while nobody asks it, so what it said before is not what its filter repeats.
UNASKED_US = 1 * S
# A driver passes on a greater difference as it is: the robot is to see a jump.
PASSED_ON_M = 0.25
HISTORY_MAX = 4_000  # delayed observations: 200 s of control periods


class Scanner:
    """The faults of one robot's range sensors, in microseconds of the world.

    Of two faults of one kind that overlap, the later end holds, and the newer noise.
    """

    def __init__(self) -> None:
        self._dead_ends_at_us = self._stuck_ends_at_us = self._noisy_ends_at_us = -1
        self._noise: tuple[Random, float, float] = (Random(0), 0.0, 0.0)
        self._scan: tuple[float, ...] = ()  # what arrived last

    def dead(self, end_at_us: int) -> None:
        """No scan arrives."""
        self._dead_ends_at_us = max(self._dead_ends_at_us, end_at_us)

    def stuck(self, end_at_us: int) -> None:
        """The last scan arrives again and again."""
        self._stuck_ends_at_us = max(self._stuck_ends_at_us, end_at_us)

    def noisy(self, end_at_us: int, rng: Random, spread_m: float, missing: float) -> None:
        """Each range is wrong by a normal error of `spread_m`; a share `missing` has no echo."""
        self._noisy_ends_at_us = max(self._noisy_ends_at_us, end_at_us)
        self._noise = rng, spread_m, missing

    def tells(self, seen: Observation, world_now_us: int) -> Observation:
        """The observation with the scan that arrives."""
        if world_now_us < self._dead_ends_at_us:
            return seen._replace(ranges_m=())
        if world_now_us < self._stuck_ends_at_us and self._scan:
            return seen._replace(ranges_m=self._scan)
        if world_now_us < self._noisy_ends_at_us:
            rng, spread_m, missing = self._noise
            seen = seen._replace(
                ranges_m=tuple(
                    inf if rng.random() < missing else max(0.0, range_m + rng.gauss(0.0, spread_m))
                    for range_m in seen.ranges_m
                )
            )
        self._scan = seen.ranges_m
        return seen


class FixRepeater:
    """A receiver that repeats one fix, beside wheels that are counted. The way of the wheels is the true
    one: they do not slip here."""

    def __init__(self) -> None:
        self._ends_at_us, self._fix_for_us, self._share = -1, 0, 1.0
        self._fix: tuple[float, float] | None = None  # what is repeated
        self._off_m = (0.0, 0.0)  # from the true place to the one that is told
        self._due_at_us = 0  # when the fix comes next

    def begin(self, end_at_us: int, fix_for_us: int, share: float) -> None:
        """It hangs until then."""
        self._ends_at_us = max(self._ends_at_us, end_at_us)
        self._fix_for_us, self._share = fix_for_us, share

    def tells(self, seen: Observation, world_now_us: int) -> Observation:
        """The place that the driver makes of it."""
        if world_now_us >= self._ends_at_us:
            self._fix = None
            return seen
        if self._fix is None:
            self._fix, self._off_m = (seen.x_m, seen.y_m), (0.0, 0.0)
            self._due_at_us = world_now_us + self._fix_for_us
        x_m, y_m = seen.x_m + self._off_m[0], seen.y_m + self._off_m[1]
        if world_now_us >= self._due_at_us:
            self._due_at_us += self._fix_for_us
            dx_m, dy_m = self._fix[0] - x_m, self._fix[1] - y_m
            share = self._share if hypot(dx_m, dy_m) < PASSED_ON_M else 1.0
            x_m, y_m = x_m + share * dx_m, y_m + share * dy_m
            self._off_m = x_m - seen.x_m, y_m - seen.y_m
        return seen._replace(x_m=x_m, y_m=y_m)


class Receiver:
    """The faults of one robot's senses, in microseconds of the world.

    Of two faults of one kind that overlap, the later end and the longer delay hold.
    """

    def __init__(self) -> None:
        # End of each fault.
        self._blind_ends_at_us = self._frozen_ends_at_us = self._late_ends_at_us = -1
        self._frozen_begins_at_us = -1
        self._jump_ends_at_us = self._deaf_ends_at_us = -1
        self._drift_begins_at_us = self._drift_ends_at_us = -1
        self._drift_m_s = (0.0, 0.0)
        self._hung = FixRepeater()
        self.scanner = Scanner()
        self._late_for_us = 0  # delay
        self._jump = (0.0, 0.0, 0.0)  # metres east and north, radians
        self._place: Observation | None = None  # what the filter repeats when it hangs
        self._last: Observation | None = None  # what arrived last
        self._way: deque[Observation] = deque(maxlen=HISTORY_MAX)

    def blind(self, end_at_us: int) -> None:
        """Nothing arrives: a muted antenna, a driver that is gone."""
        self._blind_ends_at_us = max(self._blind_ends_at_us, end_at_us)

    def frozen(self, now_us: int, end_at_us: int) -> None:
        """The old position with new timestamps: a filter that hangs."""
        if now_us >= self._frozen_ends_at_us:
            self._frozen_begins_at_us = now_us
        self._frozen_ends_at_us = max(self._frozen_ends_at_us, end_at_us)

    def hung_fixes(self, end_at_us: int, fix_for_us: int, share: float) -> None:
        """The old fix comes again after each `fix_for_us`. The driver adds the way of the wheels, and
        takes over `share` of the difference at each fix. Of two faults at once the later one holds."""
        self._hung.begin(end_at_us, fix_for_us, share)

    def jumped(self, end_at_us: int, by: tuple[float, float, float]) -> None:
        """A place that is wrong by this much: reflected signals, a wrong fix, swapped antennas.

        `by`: metres east and north, radians. Of two faults at once the later one holds.
        """
        self._jump_ends_at_us, self._jump = max(self._jump_ends_at_us, end_at_us), by

    def drifting(self, now_us: int, end_at_us: int, velocity_m_s: tuple[float, float]) -> None:
        """A place that is wrong by more and more, and says so: corrections that have ended."""
        self._drift_begins_at_us, self._drift_ends_at_us = now_us, end_at_us
        self._drift_m_s = velocity_m_s

    def deaf_wheels(self, end_at_us: int) -> None:
        """No command arrives at the wheels: a cable, a drive that is switched off."""
        self._deaf_ends_at_us = max(self._deaf_ends_at_us, end_at_us)

    def drives(self, world_now_us: int) -> bool:
        """Whether commands arrive at the wheels."""
        return world_now_us >= self._deaf_ends_at_us

    def late(self, end_at_us: int, late_for_us: int) -> None:
        """The true position, delayed: a buffer that fills."""
        if self._late_ends_at_us < 0:
            self._way.clear()
        self._late_ends_at_us, self._late_for_us = (
            max(self._late_ends_at_us, end_at_us),
            max(self._late_for_us, late_for_us),
        )

    def tells(self, seen: Observation, world_now_us: int) -> Observation | None:
        """The observation that arrives when this one is sensed.

        Its fix may be wrong or drift. It passes the filter, which may hang, then the antenna's driver,
        then the buffer.
        """
        seen = self.scanner.tells(seen, world_now_us)
        seen = self._hung.tells(seen, world_now_us)
        if world_now_us < self._jump_ends_at_us:
            x_m, y_m, turn_rad = self._jump
            seen = seen._replace(
                x_m=seen.x_m + x_m, y_m=seen.y_m + y_m, heading_rad=seen.heading_rad + turn_rad
            )
        if world_now_us < self._drift_ends_at_us:
            passed_for_s = (world_now_us - self._drift_begins_at_us) / S
            dx_m, dy_m = (passed_for_s * each for each in self._drift_m_s)
            accuracy_m = max(hypot(dx_m, dy_m), seen.position_accuracy_m)
            seen = seen._replace(
                x_m=seen.x_m + dx_m, y_m=seen.y_m + dy_m, position_accuracy_m=accuracy_m
            )
        place = self._place
        if (
            world_now_us < self._frozen_ends_at_us
            and place is not None
            and self._frozen_begins_at_us - place.sensed_at_us <= UNASKED_US
        ):
            seen = place._replace(sensed_at_us=world_now_us, implement_down=seen.implement_down)
        self._place = seen
        last, self._last = self._last, seen
        if world_now_us < self._blind_ends_at_us:
            self._last = last
            return last
        if world_now_us < self._late_ends_at_us:
            self._way.append(seen)
            arrived = last
            while self._way and self._way[0].sensed_at_us <= world_now_us - self._late_for_us:
                arrived = self._way.popleft()
            self._last = arrived
            return arrived
        self._late_ends_at_us, self._late_for_us = -1, 0
        return seen


class ReceivedBody:
    """The `Body` of a robot. It works in the world's time, whatever its robot's clock shows."""

    def __init__(self, body: Body, host: Host, receiver: Receiver) -> None:
        self._sense, self._drive, self._now_us = body.sense, body.drive, host.now_us
        self.receiver = receiver

    def sense(self, now_us: int) -> Observation | None:
        """What the receiver passes on now, with its time by the robot's clock; None if nothing
        arrives."""
        world_now_us = self._now_us()
        sensed = self._sense(world_now_us)
        seen = None if sensed is None else self.receiver.tells(sensed, world_now_us)
        if seen is None or now_us == world_now_us:
            return seen
        return seen._replace(sensed_at_us=now_us - (world_now_us - seen.sensed_at_us))

    def drive(self, command: GatedDrive, now_us: int) -> None:
        """Pass the command on at the world's time."""
        world_now_us = self._now_us()
        if self.receiver.drives(world_now_us):
            self._drive(command, world_now_us)
