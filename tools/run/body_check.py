"""`headland body-check`: ten checks of a driver on a machine that may move some metres.

The driver is judged by what it senses. With the simulated machine (`headland machine`) muted, late,
inaccurate and jumped places are tried as well, and the truth of the machine is compared with what the
driver senses.
"""

import asyncio
import json
import time
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from itertools import combinations, pairwise
from math import atan2, cos, degrees, dist, hypot, isfinite, pi, radians, remainder, sin, sqrt
from pathlib import Path
from statistics import fmean, median, pstdev
from typing import Any, Final, NamedTuple

from rich.console import Console

from agent.interface.config import ACTUATOR_TTL_US, BRAKING_SHARE, CONTROL_PERIOD_US, S
from agent.interface.effects import HALT, Drive, GatedDrive
from agent.interface.observation import Observation
from agent.interface.vehicle import DriveTrain, Vehicle
from agent.motion.wheel_kinematics import WheelBase, WheelDrive
from agent.peer.place_jumps import (
    AGE_MAX_US,
    HEADING_ACCURACY_RAD,
    JUMP_M,
    POSITION_ACCURACY_M,
)
from agent.peer.sense_freshness import unusable
from agent.runtime.body_plugins import made, plugins
from agent.runtime.robot_body import DeclaredMachine, FactoryError, RobotBody, fault_text
from sim.files.strict_json import dumps
from tools.common.exit_codes import INTERRUPTED, wrong
from tools.common.findings import Finding, print_findings
from tools.common.options import PORT_MAX
from tools.run.machine_command import ANSWER_FOR_S
from tools.run.robot_command import import_from

SPEED_M_S: Final = 0.5  # at most, while it is tried
OPEN_S: Final = 10.0
STANDS_M_S: Final = 0.05  # slower is standing: a receiver is never quite still
ASIDE_RAD: Final = radians(20.0)  # a course may be off by this after the run-up
SHARE: Final = 0.3  # a speed may be off by this share
WINDOW_S: Final = 0.4  # speeds are taken over this time, for noise of a centimetre
SLEW_S: Final = 0.11  # two places at 20 Hz; twice the declared acceleration is allowed in it
DETECTED_S: Final = 0.25  # for standing to show in places that are noisy
TIMES_TRIALS: Final = 3  # of two seconds: other work seldom delays each of them
CALL_S: Final = 0.03  # `sense` and `drive` are called every 50 ms, in the thread of the bus
REACTS_S: Final = 0.1  # from a command to the brakes, and from a place to `sense`
EXTRA_LIFE_S: Final = 0.15  # between the last two commands, and to the watchdog of a controller
# If a period begins later, this program was not run, and what it measures says nothing of a body.
PAUSE_US: Final = CONTROL_PERIOD_US
PAUSES_MAX: Final = 5  # trials of five seconds
MUTED_S: Final = 0.8
LATE_S: Final = 0.5
INACCURATE_S: Final = 1.5
JUMPED_M: Final = 2.0
AGES_FOR_S: Final = 2.0  # forty places at 20 Hz, for noise of a centimetre
HIDDEN_S: Final = CONTROL_PERIOD_US / S  # a place may be older than it says by this
ASKED_EACH_S: Final = 0.02
ASKED_FOR_S: Final = 0.02  # between a question and its answer
ASKED_LEAST: Final = 10  # answers in time
TRUE_SHARE: Final = (
    0.1  # the true speed of a simulated machine, which does not slip, may be off by this
)
LOST_SHARE: Final = 0.1  # of the answers while it drives may say that it is told to stand
HINT_RAD: Final = radians(
    15.0
)  # a course that is nearer to one that a known fault gives has this fault


class SensedSample(NamedTuple):
    """What the driver sensed at a time."""

    at_us: int
    seen: Observation | None


class WrongError(Exception):
    """One line: why a check is not passed."""


@contextmanager
def calling(name: str) -> Iterator[None]:
    """Turns what a method of a driver raises into one line. OSError of `open` says what is not there.

    Raises WrongError."""
    try:
        yield
    except WrongError:
        raise
    except Exception as problem:
        if name == "open" and isinstance(problem, OSError):
            raise
        raise WrongError(f"{name} raised {fault_text(problem)}") from None


def checked(seen: object) -> Observation | None:
    """What `sense` has returned. Raises WrongError if it is no observation, or one that is no number."""
    if seen is None:
        return None
    if not isinstance(seen, Observation):
        raise WrongError(f"sense returned a {type(seen).__name__}, not an Observation or None")
    for name in (*Observation._fields[:5], "position_accuracy_m", "heading_accuracy_rad"):
        value = getattr(seen, name)
        if not isinstance(value, (int, float)) or isinstance(value, bool):
            raise WrongError(f"{name} is a {type(value).__name__}, not a number: {value!r}")
        # An infinite accuracy says that there is none.
        if not isfinite(value) and "accuracy" not in name:
            raise WrongError(f"{name} is {value}")
    if type(seen.sensed_at_us) is not int:
        raise WrongError(
            f"sensed_at_us is {seen.sensed_at_us!r}, not a whole number of microseconds"
        )
    for name, value in (("battery", seen.battery), ("health", seen.health)):
        if not isinstance(value, (int, float)) or not 0.0 <= value <= 1.0:
            raise WrongError(f"{name} is {value!r}, not a share from 0.0 to 1.0")
    ranges_m: object = seen.ranges_m
    if not isinstance(ranges_m, tuple) or not all(
        isinstance(each, (int, float)) and each >= 0.0 for each in ranges_m
    ):
        raise WrongError("ranges_m is not a tuple of distances")
    if not isinstance(seen.implement_down, bool | None):
        raise WrongError(f"implement_down is {seen.implement_down!r}, not True, False or None")
    return seen


class BodyTrial:
    """A body that is commanded every control period, and what it senses."""

    def __init__(self, body: RobotBody, vehicle: Vehicle, orders: tuple[str, int] | None) -> None:
        """`orders`: host and port of the simulated machine's orders, if it is one."""
        self.body, self.vehicle, self.orders = body, vehicle, orders
        self.speed_m_s = min(SPEED_M_S, vehicle.speed_m_s)
        self.drove_on_m: float | None = None  # after a command to stand
        self.slowest_call: tuple[float, str] = (0.0, "")  # seconds, method
        self.paused_for_us = 0  # the longest that a period began late

    def sense(self, now_us: int) -> Observation | None:
        """What the driver senses. Raises WrongError."""
        with calling("sense"):
            seen = self.body.sense(now_us)
        self._took((self.now_us() - now_us) / S, "sense")
        return checked(seen)

    def drive(self, command: Drive) -> None:
        """Command the driver. Raises WrongError."""
        now_us = self.now_us()
        with calling("drive"):
            self.body.drive(GatedDrive(command), now_us)
        self._took((self.now_us() - now_us) / S, "drive")

    def _took(self, for_s: float, name: str) -> None:
        self.slowest_call = max(self.slowest_call, (for_s, name))

    @staticmethod
    def now_us() -> int:
        """The clock of the contract."""
        return time.monotonic_ns() // 1000

    async def run(self, command: Drive | None, for_s: float) -> list[SensedSample]:
        """Command it for a time (None: say nothing), and sense every period."""
        samples = []
        start_us = due_us = self.now_us()
        while due_us < start_us + for_s * S:
            now_us = self.now_us()
            self.paused_for_us = max(self.paused_for_us, now_us - due_us)
            samples.append(SensedSample(now_us, self.sense(now_us)))
            if command is not None:
                self.drive(command)
            # After a pause of the computer no burst of commands follows.
            due_us = max(due_us + CONTROL_PERIOD_US, now_us)
            await asyncio.sleep(max(due_us - self.now_us(), 0) / S)
        return samples

    def here(self) -> Observation:
        """The newest observation. Raises WrongError."""
        seen = self.sense(self.now_us())
        if seen is None:
            raise WrongError("nothing is sensed")
        return seen

    def towards(self, angle_rad: float) -> Drive:
        """A command with this course from the present heading."""
        course_rad = self.here().heading_rad + angle_rad
        return Drive(self.speed_m_s * cos(course_rad), self.speed_m_s * sin(course_rad))

    async def order(self, line: str) -> Any:
        """The simulated machine's answer to an order. Raises WrongError."""
        assert self.orders is not None
        where = "{}:{}".format(*self.orders)
        try:
            async with asyncio.timeout(ANSWER_FOR_S):
                reader, writer = await asyncio.open_connection(*self.orders)
                with closing(writer):
                    writer.write(line.encode() + b"\n")
                    answer = (await reader.readline()).decode().strip()
            return json.loads(answer) if answer.startswith("{") else answer
        except TimeoutError:
            raise WrongError(f"no machine answers {line!r} at {where}") from None
        except OSError as problem:
            raise WrongError(f"no machine at {where}: {problem.strerror or problem}") from None
        except ValueError:  # no text, or no JSON
            raise WrongError(f"what answers at {where} is no machine") from None

    async def stand(self) -> None:
        """Let it stop."""
        await self.run(HALT, 0.5 + self.stops_in_s)

    @property
    def stops_in_s(self) -> float:
        """How long a robot plans to brake from the speed of a trial."""
        return self.speed_m_s / (BRAKING_SHARE * self.vehicle.acceleration_m_s2)


def seen_in(samples: Sequence[SensedSample]) -> list[Observation]:
    """The observations, each once. Raises WrongError if there are fewer than two."""
    seen = [sample.seen for sample in samples if sample.seen is not None]
    once = [*seen[:1], *(b for a, b in pairwise(seen) if b.sensed_at_us != a.sensed_at_us)]
    if len(once) < 2:
        raise WrongError("the place has no new times")
    return once


def speed_of(first: Observation, last: Observation) -> tuple[float, float]:
    """Metres a second and course between two observations."""
    passed_s = max(last.sensed_at_us - first.sensed_at_us, 1) / S
    x_m, y_m = last.x_m - first.x_m, last.y_m - first.y_m
    return hypot(x_m, y_m) / passed_s, atan2(y_m, x_m)


def windows(seen: Sequence[Observation]) -> list[tuple[Observation, Observation]]:
    """Pairs of observations that are `WINDOW_S` apart."""
    pairs, first = [], 0
    for last in seen:
        while last.sensed_at_us - seen[first].sensed_at_us > WINDOW_S * S:
            pairs.append((seen[first], last))
            first += 1
    return pairs


def last_window(seen: Sequence[Observation]) -> tuple[Observation, Observation]:
    """The newest pair. Raises WrongError where the times do not pass."""
    pairs = windows(seen)
    if not pairs:
        passed_ms = (seen[-1].sensed_at_us - seen[0].sensed_at_us) / 1000
        raise WrongError(f"the times of {len(seen)} places differ by {passed_ms:.0f} ms only")
    return pairs[-1]


def unit_of(sensed_at_us: float, now_us: int) -> str:
    """What is wrong with a time that is far from ours, if that is known."""
    for factor, unit in ((1_000_000, "in seconds"), (1000, "in milliseconds")):
        if abs(sensed_at_us * factor - now_us) < 60 * S:
            return f"; it seems to be {unit}, not in microseconds"
    if abs(sensed_at_us / 1000 - now_us) < 60 * S:
        return "; it seems to be in nanoseconds, not in microseconds"
    if abs(sensed_at_us - time.time() * S) < 86_400 * S:
        return "; it seems to be of time.time(), not of time.monotonic()"
    return ""


def side_of(off_rad: float) -> str:
    """An angle in words."""
    return f"{abs(degrees(off_rad)):.0f} degrees to the {'left' if off_rad > 0 else 'right'}"


def hint_of(commanded_rad: float, driven_rad: float) -> str:
    """Which known fault turns the commanded course into the driven one; empty: none."""
    for course_rad, fault in (
        (commanded_rad + pi, "are forward and backward exchanged?"),
        (-commanded_rad, "is the sign of y (north) wrong?"),
        (pi - commanded_rad, "is the sign of x (east) wrong?"),
        (pi / 2 - commanded_rad, "are x and y exchanged, or are headings bearings from north?"),
        (commanded_rad + pi / 2, "is the heading off by 90 degrees?"),
        (commanded_rad - pi / 2, "is the heading off by 90 degrees?"),
    ):
        if abs(remainder(driven_rad - course_rad, 2 * pi)) < HINT_RAD:
            return f"; {fault}"
    return ""


def moves(first: Observation, last: Observation) -> bool:
    """Whether the places of a window differ by more than their accuracy explains."""
    noise_m = 2 * (first.position_accuracy_m + last.position_accuracy_m)
    passed_s = (last.sensed_at_us - first.sensed_at_us) / S
    return dist(first[:2], last[:2]) > noise_m + STANDS_M_S * passed_s


async def opens(trial: BodyTrial) -> str:
    """It connects, and senses a place."""
    start_us = trial.now_us()
    try:
        async with asyncio.timeout(OPEN_S) as opening:
            with calling("open"):
                await trial.body.open()
            while trial.sense(trial.now_us()) is None:
                await asyncio.sleep(CONTROL_PERIOD_US / S)
    except TimeoutError:
        if opening.expired():
            raise WrongError(f"no place in {OPEN_S:.0f} s") from None
        raise  # of the driver
    return f"in {(trial.now_us() - start_us) / S:.1f} s"


async def has_current_times(trial: BodyTrial) -> str:
    """Each place has the time at which it was true, on our clock, and is never old.

    A busy computer makes one place old. A driver makes places old again and again, so one of
    `TIMES_TRIALS` trials without an old place is enough, and the others are told. Raises WrongError.
    """
    old_ms: list[str] = []
    slow: list[tuple[float, str]] = []
    for _ in range(TIMES_TRIALS):
        trial.slowest_call = (0.0, "")
        samples = await trial.run(HALT, 2.0)
        slow.append(trial.slowest_call)
        if min(slow)[0] > CALL_S:
            if len(slow) < TIMES_TRIALS:
                continue
            took_s, name = min(slow)
            raise WrongError(f"{name} took {took_s * 1000:.0f} ms, and must not wait")
        seen_in(samples)
        ages_us = [s.at_us - s.seen.sensed_at_us for s in samples if s.seen is not None]
        wrong_unit = unit_of(samples[-1].at_us - ages_us[-1], samples[-1].at_us)
        if wrong_unit:
            raise WrongError(f"sensed_at_us is {samples[-1].at_us - ages_us[-1]:.0f}{wrong_unit}")
        if min(ages_us) < 0:
            raise WrongError(f"sensed {-min(ages_us) / 1000:.0f} ms in the future")
        if max(ages_us) <= AGE_MAX_US:
            said = f"{min(ages_us) / 1000:.0f} to {max(ages_us) / 1000:.0f} ms old"
            return (
                f"{said}; {', '.join(old_ms)} ms in trials before: is this computer busy?"
                if old_ms
                else said
            )
        old_ms.append(f"{max(ages_us) / 1000:.0f}")
    raise WrongError(f"up to {', '.join(old_ms)} ms old; {AGE_MAX_US / 1000:.0f} ms stop a robot")


async def tells_its_accuracy(trial: BodyTrial) -> str:
    """Places are metres near the origin, and as accurate as the clearances need. Raises WrongError."""
    seen = seen_in(await trial.run(HALT, 2.0))
    here = seen[-1]
    if abs(here.heading_rad) > 4 * pi:
        raise WrongError(
            f"the heading is {here.heading_rad:.1f}; is it in degrees, not in radians?"
        )
    accuracy_m, turn_rad = here.position_accuracy_m, here.heading_accuracy_rad
    # Some receivers say by -1 that they do not know it.
    if not 0.0 <= accuracy_m <= POSITION_ACCURACY_M or not turn_rad <= HEADING_ACCURACY_RAD:
        raise WrongError(
            f"accurate to {accuracy_m:.2f} m and {degrees(turn_rad):.0f} degrees; a robot needs "
            f"{POSITION_ACCURACY_M} m and {degrees(HEADING_ACCURACY_RAD):.0f} degrees"
        )
    if stops := unusable(here, POSITION_ACCURACY_M, here.sensed_at_us):
        raise WrongError(
            f"{here.x_m:.0f} m east and {here.y_m:.0f} m north of the origin of the field: {stops}"
        )
    middle = sum(s.x_m for s in seen) / len(seen), sum(s.y_m for s in seen) / len(seen)
    wanders_m = max(dist(middle, s[:2]) for s in seen)
    if wanders_m > max(5 * accuracy_m, 0.02):
        raise WrongError(f"wanders {wanders_m:.2f} m standing, and says {accuracy_m:.3f} m")
    exact = "; 0.0 says that it is exact, as no receiver is" if accuracy_m == 0.0 else ""
    return f"{accuracy_m:.3f} m, wanders {wanders_m:.3f} m standing{exact}"


async def drives_ahead(trial: BodyTrial) -> str:
    """A command along the heading moves it there, with that speed, and it says so. Raises WrongError."""
    command, from_m = trial.towards(0.0), trial.here()
    samples = await trial.run(command, 1.0 + 3 * trial.stops_in_s)
    first, last = last_window(seen_in(samples))
    await trial.stand()
    speed_m_s, course_rad = speed_of(first, last)
    commanded_rad = atan2(command.vy_m_s, command.vx_m_s)
    off_rad = remainder(course_rad - commanded_rad, 2 * pi)
    if dist(from_m[:2], last[:2]) < trial.speed_m_s / 4:
        turned_rad = remainder(last.heading_rad - from_m.heading_rad, 2 * pi)
        turned = (
            f", and turned {side_of(turned_rad)}; is its heading wrong?"
            if abs(turned_rad) > ASIDE_RAD
            else " only"
        )
        raise WrongError(
            f"told to drive ahead, it moved {dist(from_m[:2], last[:2]):.2f} m{turned}"
        )
    if abs(off_rad) > ASIDE_RAD:
        raise WrongError(
            f"drives {side_of(off_rad)} of the commanded course{hint_of(commanded_rad, course_rad)}"
        )
    if abs(speed_m_s / trial.speed_m_s - 1) > SHARE:
        raise WrongError(f"told {trial.speed_m_s:.2f} m/s, drove {speed_m_s:.2f} m/s")
    points_rad = remainder(last.heading_rad - course_rad, 2 * pi)
    if trial.vehicle.drive is not DriveTrain.MECANUM and abs(points_rad) > ASIDE_RAD:
        raise WrongError(
            f"drives, and says a heading {degrees(points_rad):.0f} degrees off its course"
        )
    says_m_s = hypot(last.vx_m_s, last.vy_m_s)
    if hypot(last.vx_m_s - command.vx_m_s, last.vy_m_s - command.vy_m_s) > 2 * SHARE * speed_m_s:
        raise WrongError(
            f"drove {speed_m_s:.2f} m/s and says {says_m_s:.2f} m/s, or another course"
        )
    return f"told {trial.speed_m_s:.2f} m/s, drove {speed_m_s:.2f}, says {says_m_s:.2f}"


def check_velocity(seen: Sequence[Observation]) -> None:
    """The velocity that it says at the end has the course that its places have. Raises WrongError."""
    first, last = last_window(seen)
    middle = [each for each in seen if each.sensed_at_us >= first.sensed_at_us]
    east_m_s, north_m_s = fmean(s.vx_m_s for s in middle), fmean(s.vy_m_s for s in middle)
    course_rad = speed_of(first, last)[1]
    off_rad = remainder(atan2(north_m_s, east_m_s) - course_rad, 2 * pi)
    if abs(off_rad) <= ASIDE_RAD:
        return
    by_body = abs(remainder(off_rad + last.heading_rad, 2 * pi)) < HINT_RAD
    raise WrongError(
        f"the velocity that it says points {side_of(off_rad)} of its course"
        f"{'; is it that along the body, not east and north?' if by_body else ''}"
    )


async def turns_the_right_way(trial: BodyTrial) -> str:
    """Left is left: a course to either side is reached, and headings grow to the left, on the spot, too.

    Raises WrongError."""
    said = []
    for angle_rad in (radians(60.0), -radians(60.0)):
        before, command = trial.here(), trial.towards(angle_rad)
        samples = await trial.run(command, 6.0)
        first, last = last_window(seen_in(samples))
        await trial.stand()
        course_rad = atan2(command.vy_m_s, command.vx_m_s)
        driven_rad = speed_of(first, last)[1]
        off_rad = remainder(driven_rad - course_rad, 2 * pi)
        turned_rad = remainder(last.heading_rad - before.heading_rad, 2 * pi)
        side = "left" if angle_rad > 0 else "right"
        if abs(off_rad) > ASIDE_RAD:
            raise WrongError(
                f"told to the {side}, it drives {side_of(off_rad)} of the commanded course"
                f"{hint_of(course_rad, driven_rad)}"
            )
        if trial.vehicle.drive is not DriveTrain.MECANUM and turned_rad * angle_rad < 0:
            raise WrongError(
                f"told to the {side}, its heading turned {degrees(turned_rad):.0f} degrees"
            )
        check_velocity(seen_in(samples))
        said.append(f"{degrees(turned_rad):+.0f}")
    if trial.vehicle.drive is not DriveTrain.ACKERMANN:  # on the spot, as out of a corner
        before = trial.here()
        await trial.run(Drive(0.0, 0.0, 0.3), 2.0)
        turned_rad = remainder(trial.here().heading_rad - before.heading_rad, 2 * pi)
        await trial.stand()
        if abs(turned_rad / 0.6 - 1) > SHARE + 0.2:
            raise WrongError(
                f"told to turn left by 34 degrees on the spot, it turned {degrees(turned_rad):.0f}"
            )
        said.append(f"{degrees(turned_rad):+.0f}")
    return f"headings turned {', '.join(said)} degrees"


def greatest_change(seen: Sequence[Observation]) -> float:
    """The greatest change of the told velocity within `SLEW_S`, metres a second."""
    return max(
        (
            hypot(b.vx_m_s - a.vx_m_s, b.vy_m_s - a.vy_m_s)
            for a, b in combinations(seen, 2)
            if b.sensed_at_us - a.sensed_at_us <= SLEW_S * S
        ),
        default=0.0,
    )


async def speeds_up_as_declared(trial: BodyTrial) -> str:
    """It accelerates no faster than the file declares: the fleet plans with it. Raises WrongError."""
    noise_m_s = greatest_change(seen_in(await trial.run(HALT, 1.0)))
    seen = seen_in(await trial.run(trial.towards(0.0), 1.0 + trial.stops_in_s))
    await trial.stand()
    limit_m_s2 = trial.vehicle.acceleration_m_s2
    change_m_s, most_m_s = greatest_change(seen), 2 * limit_m_s2 * SLEW_S + 2 * noise_m_s
    said = f"{change_m_s:.2f} m/s in {SLEW_S} s; {most_m_s:.2f} m/s at most"
    if change_m_s > most_m_s:
        raise WrongError(said)
    check_velocity(seen)  # a mecanum body has another heading here than when it drove ahead
    return said


class StopWay(NamedTuple):
    """How a body has stopped."""

    line: str
    drove_on_m: float  # from the place of the last command to the one where it stood
    noise_m: float  # of that way


async def _stops(trial: BodyTrial, command: Drive | None, more_s: float) -> StopWay:
    run_up = seen_in(await trial.run(trial.towards(0.0), 1.0 + 2 * trial.stops_in_s))
    from_us = trial.now_us()
    if speed_of(*last_window(run_up))[0] < trial.speed_m_s / 2:
        raise WrongError("it did not drive before it was to stop")
    samples = await trial.run(command, 1.5 + trial.stops_in_s + more_s)
    await trial.stand()
    seen = seen_in(samples)
    pairs = windows(seen)
    moving = [pair for pair in pairs if moves(*pair)]
    stood_at_us = sum(seen.sensed_at_us for seen in moving[-1]) / 2 if moving else from_us
    took_s = (stood_at_us - from_us) / S
    most_s = trial.stops_in_s + more_s + DETECTED_S
    if moving and moving[-1] is pairs[-1]:
        raise WrongError("it does not stop")
    if took_s > most_s:
        raise WrongError(f"stood after {took_s:.2f} s; {most_s:.2f} s at most")
    line = f"stood after {max(took_s, 0.0):.2f} s, {most_s:.2f} at most"
    return StopWay(line, *_way_on(run_up, seen, from_us))


def _way_on(
    run_up: Sequence[Observation], seen: Sequence[Observation], from_us: int
) -> tuple[float, float]:
    """Metres along its course that it drove after a time, and how far noise may be in them."""
    rest = [s for s in seen if seen[-1].sensed_at_us - s.sensed_at_us < WINDOW_S * S]
    end_m = fmean(s.x_m for s in rest), fmean(s.y_m for s in rest)
    first, last = last_window(run_up)
    speed_m_s, course_rad = speed_of(first, last)
    middle = [s for s in run_up if last.sensed_at_us - s.sensed_at_us < WINDOW_S * S]
    # Each place of the run-up, driven on to the time of the command.
    ways_m = [
        (end_m[0] - s.x_m) * cos(course_rad)
        + (end_m[1] - s.y_m) * sin(course_rad)
        - speed_m_s * (from_us - s.sensed_at_us) / S
        for s in middle
    ]
    noise_m = fmean(dist(end_m, s[:2]) for s in rest)
    return fmean(ways_m), 4 * noise_m / sqrt(len(rest))


async def stops_when_told(trial: BodyTrial) -> str:
    """A command to stand is obeyed within the time and the way that the fleet plans with.

    A place that is late and does not say so shows here: it drives on after the body stands.
    Raises WrongError."""
    stop = await _stops(trial, HALT, CONTROL_PERIOD_US / S)
    trial.drove_on_m = stop.drove_on_m
    most_m = trial.speed_m_s * (CONTROL_PERIOD_US / S + REACTS_S + trial.stops_in_s / 2)
    said = f"{stop.drove_on_m:.2f} m; {most_m + stop.noise_m:.2f} m at most"
    if stop.drove_on_m > most_m + stop.noise_m:
        raise WrongError(
            f"its places go on for {said}: it brakes late, or its places are later than they say"
        )
    if trial.orders is not None:
        said = f"{said}; {await passes_commands_on(trial)}"
    return f"{stop.line}; {said}"


async def stops_when_nobody_speaks(trial: BodyTrial) -> str:
    """Without commands the wheels stand after their lifetime: it drives hardly further than when it is
    told to stand. Raises WrongError."""
    stop = await _stops(trial, None, ACTUATOR_TTL_US / S)
    if trial.drove_on_m is None:
        return stop.line
    longer_s = (stop.drove_on_m - trial.drove_on_m) / trial.speed_m_s
    # The command to stand came at once; the last command before the silence is one period old.
    most_s = (ACTUATOR_TTL_US - CONTROL_PERIOD_US) / S + EXTRA_LIFE_S
    if longer_s > most_s + 2 * stop.noise_m / trial.speed_m_s:
        raise WrongError(
            f"drives on for {(longer_s * S + CONTROL_PERIOD_US) / 1000:.0f} ms after the last command; "
            f"a command lives for {ACTUATOR_TTL_US / 1000:.0f} ms"
        )
    return stop.line


async def shows_missing_and_late_places(trial: BodyTrial) -> str:
    """A place that does not arrive grows old; one that arrives late says so, and so does one that is
    inaccurate. One that jumps is passed on as it is: the robot notices it, and a filter would hide it.

    Raises WrongError."""
    if trial.orders is None:
        return ""
    said = []
    for fault, for_s in (("muted", MUTED_S), (f"late {LATE_S}", LATE_S + MUTED_S)):
        answer = await trial.order(f"{fault} {for_s}")
        if answer != "ok":
            raise WrongError(f"the machine says: {answer}")
        samples = await trial.run(HALT, for_s)
        seen = samples[-1].seen
        age_us = S if seen is None else samples[-1].at_us - seen.sensed_at_us
        if age_us <= AGE_MAX_US:
            raise WrongError(f"{fault}: the place passes for {age_us / 1000:.0f} ms old")
        said.append(f"{fault.split()[0]} {age_us / 1000:.0f} ms old")
        await trial.run(HALT, 1.0 + LATE_S)
    await _worse_places(trial)
    truth, seen = await trial.order("where"), trial.here()
    try:
        apart_m = dist((truth["x_m"], truth["y_m"]), seen[:2])
    except (TypeError, KeyError):
        raise WrongError(f"where: the machine says {truth!r}, not where it truly is") from None
    if apart_m > POSITION_ACCURACY_M:
        raise WrongError(f"{apart_m:.2f} m from where the machine truly is")
    said.append(await _without_pause(trial, are_as_old_as_they_say))
    return f"{', '.join(said)}; {apart_m:.3f} m from the truth"


class TrueMotion(NamedTuple):
    """Where a simulated machine truly is at a time, and its velocity; metres, metres a second."""

    at_us: int
    x_m: float
    y_m: float
    vx_m_s: float
    vy_m_s: float
    is_told_to_move: bool | None  # None: this machine does not say it

    @property
    def speed_m_s(self) -> float:
        """Without its direction."""
        return hypot(self.vx_m_s, self.vy_m_s)


async def _true_motions(trial: BodyTrial, for_s: float) -> list[TrueMotion]:
    """What the machine says for a time. An answer that comes late says nothing of a time.

    Raises WrongError."""
    found, ends_at_us = [], trial.now_us() + for_s * S
    while (asked_at_us := trial.now_us()) < ends_at_us:
        truth = await trial.order("where")
        answered_at_us = trial.now_us()
        if answered_at_us - asked_at_us <= ASKED_FOR_S * S:
            try:
                heading_rad, ahead_m_s, left_m_s = (
                    truth[key] for key in ("heading_rad", "ahead_m_s", "left_m_s")
                )
                found.append(
                    TrueMotion(
                        (asked_at_us + answered_at_us) // 2, truth["x_m"], truth["y_m"],
                        ahead_m_s * cos(heading_rad) - left_m_s * sin(heading_rad),
                        ahead_m_s * sin(heading_rad) + left_m_s * cos(heading_rad),
                        truth.get("is_told_to_move"),
                    )
                )  # fmt: skip
            except (TypeError, KeyError):
                raise WrongError(f"where: the machine says {truth!r}") from None
        await asyncio.sleep(ASKED_EACH_S)
    return found


async def _moved_under(
    trial: BodyTrial, command: Drive, for_s: float
) -> tuple[list[SensedSample], list[TrueMotion]]:
    """What the driver sensed under a command, and the true motions. Raises WrongError."""
    asking = asyncio.create_task(_true_motions(trial, for_s))
    try:
        samples = await trial.run(command, for_s)
        return samples, await asking
    finally:
        asking.cancel()


async def _beside_truth(
    trial: BodyTrial, command: Drive, for_s: float
) -> list[tuple[TrueMotion, Observation]]:
    """True motions under a command, each with the place that the driver sensed last before it.

    Raises WrongError."""
    samples, truths = await _moved_under(trial, command, for_s)
    pairs = []
    for truth in truths:
        seen = next((s.seen for s in reversed(samples) if s.at_us <= truth.at_us), None)
        if seen is not None and truth.at_us - seen.sensed_at_us <= AGE_MAX_US:
            pairs.append((truth, seen))
    return pairs


async def are_as_old_as_they_say(trial: BodyTrial) -> str:
    """Places of a body that drives are where it truly was at their times.

    A place that is late each time and does not say so is behind the body while it drives, and not when
    it stands. Raises WrongError."""
    driven = await _beside_truth(trial, trial.towards(0.0), AGES_FOR_S + 2 * trial.stops_in_s)
    driven = [pair for pair in driven if pair[0].speed_m_s > trial.speed_m_s / 2]
    await trial.stand()
    still = await _beside_truth(trial, HALT, AGES_FOR_S)
    if min(len(driven), len(still)) < ASKED_LEAST:
        return "times not compared with the truth: this computer is busy"
    last, _ = driven[-1]
    east, north = last.vx_m_s / last.speed_m_s, last.vy_m_s / last.speed_m_s

    def ahead_m(truth: TrueMotion, seen: Observation) -> float:
        """How far the machine is ahead of a place that is driven on to the same time."""
        for_s = (truth.at_us - seen.sensed_at_us) / S
        x_m = truth.x_m - seen.x_m - truth.vx_m_s * for_s
        y_m = truth.y_m - seen.y_m - truth.vy_m_s * for_s
        return x_m * east + y_m * north

    ways_m = [ahead_m(*pair) for pair in driven]
    speed_m_s = fmean(truth.speed_m_s for truth, _ in driven)
    hidden_s = (median(ways_m) - median(ahead_m(*pair) for pair in still)) / speed_m_s
    fixes = len({seen.sensed_at_us for _, seen in driven})
    most_s = HIDDEN_S + 4 * pstdev(ways_m) / sqrt(fixes) / speed_m_s
    if hidden_s > most_s:
        raise WrongError(
            f"places are {hidden_s * 1000:.0f} ms older than they say; {most_s * 1000:.0f} ms at most"
        )
    return f"times right to {abs(hidden_s) * 1000:.0f} ms"


async def passes_commands_on(trial: BodyTrial) -> str:
    """Each command reaches a simulated machine, at once, and with its speed.

    Commands that wait in a queue hide in the way of braking, and so do some that say to stand between
    others. Raises WrongError."""
    _, driven = await _moved_under(trial, trial.towards(0.0), 1.0 + 2 * trial.stops_in_s)
    halted_at_us = trial.now_us()
    _, halted = await _moved_under(trial, HALT, 1.0)
    await trial.stand()
    driven = [truth for truth in driven if halted_at_us - truth.at_us < S]  # it had its speed then
    if any(truth.is_told_to_move is None for truth in driven + halted):
        return "this machine does not say what it is told"
    if min(len(driven), len(halted)) < ASKED_LEAST:
        return "commands not compared with the truth: this computer is busy"
    lost = sum(not truth.is_told_to_move for truth in driven)
    if lost > LOST_SHARE * len(driven):
        raise WrongError(
            f"told to drive, it lets the machine stand: {lost} of {len(driven)} times it was asked"
        )
    late_us = max(
        (truth.at_us - halted_at_us for truth in halted if truth.is_told_to_move), default=0
    )
    most_us = CONTROL_PERIOD_US + REACTS_S * S
    if late_us > most_us:
        raise WrongError(
            f"a command to stand reaches the machine after {late_us / 1000:.0f} ms; "
            f"{most_us / 1000:.0f} ms at most"
        )
    speed_m_s = median(truth.speed_m_s for truth in driven)
    if abs(speed_m_s / trial.speed_m_s - 1) > TRUE_SHARE:
        raise WrongError(
            f"told {trial.speed_m_s:.2f} m/s, the machine truly drove {speed_m_s:.2f} m/s"
        )
    return f"commands late by {late_us / 1000:.0f} ms, true speed {speed_m_s:.2f} m/s"


async def _worse_places(trial: BodyTrial) -> None:
    """Inaccurate places and places that jump. Raises WrongError."""
    if await trial.order(f"inaccurate {INACCURATE_S}") == "ok":
        samples = await trial.run(HALT, INACCURATE_S - 2 * CONTROL_PERIOD_US / S)
        seen = samples[-1].seen
        fresh = seen is not None and samples[-1].at_us - seen.sensed_at_us <= AGE_MAX_US
        if fresh and seen is not None and seen.position_accuracy_m <= POSITION_ACCURACY_M:
            raise WrongError(
                f"inaccurate: the place passes for accurate to {seen.position_accuracy_m:.3f} m"
            )
        await trial.run(HALT, 2.0)
    if await trial.order(f"jumped {JUMPED_M} 0 {MUTED_S}") == "ok":
        before = trial.here()
        samples = await trial.run(HALT, MUTED_S - 2 * CONTROL_PERIOD_US / S)
        steps_m = [
            dist(a.seen[:2], b.seen[:2])
            for a, b in pairwise(samples)
            if a.seen is not None and b.seen is not None
        ]
        last = samples[-1].seen
        hidden = all(sample.seen is not None for sample in samples) and max(steps_m) < JUMP_M
        if hidden and last is not None and dist(before[:2], last[:2]) > POSITION_ACCURACY_M:
            raise WrongError(
                f"jumped {JUMPED_M:.0f} m: the place goes there by steps of {max(steps_m):.2f} m, "
                "which no robot notices; pass a jump on as it is"
            )
        await trial.run(HALT, 1.0 + MUTED_S)


async def opens_again(trial: BodyTrial) -> str:
    """After `close` it stands, and can be opened again and driven. Raises WrongError."""
    await trial.run(trial.towards(0.0), 1.0)
    with calling("close"):
        trial.body.close()
    await asyncio.sleep(1.0 + trial.stops_in_s)
    said = await opens(trial)
    if moves(*last_window(seen_in(await trial.run(None, 1.0)))):
        raise WrongError("it drives after it was closed")
    from_m = trial.here()
    await trial.run(trial.towards(0.0), 1.0 + trial.stops_in_s)
    moved_m = dist(from_m[:2], trial.here()[:2])
    await trial.stand()
    if moved_m < trial.speed_m_s / 4:
        raise WrongError(f"opened again and told to drive, it moved {moved_m:.2f} m only")
    return said


Check = Callable[[BodyTrial], Awaitable[str]]
CHECKS: Final[dict[str, Check]] = {
    "opens": opens,
    "times": has_current_times,
    "accuracy": tells_its_accuracy,
    "ahead": drives_ahead,
    "sides": turns_the_right_way,
    "acceleration": speeds_up_as_declared,
    "stop": stops_when_told,
    "life of a command": stops_when_nobody_speaks,
    "missing places": shows_missing_and_late_places,
    "restart": opens_again,
}


# Checks that measure from the last command to standing, and what is measured again before each of them:
# a computer that pauses makes one such way too long or too short, and a driver does so each time.
MEASURED_AGAIN: Final[dict[str, tuple[Check, ...]]] = {
    "stop": (),
    "life of a command": (stops_when_told,),
}


async def confirmed(trial: BodyTrial, name: str, check: Check) -> str:
    """What a check says. Two of three trials decide where a busy computer can fail one.

    Raises WrongError."""
    if name not in MEASURED_AGAIN:
        return await check(trial)
    try:
        return await _without_pause(trial, check)
    except WrongError as problem:
        first = problem
    for _ in range(2):
        halt(trial.body)
        for before in MEASURED_AGAIN[name]:
            with suppress(WrongError):
                await _without_pause(trial, before)
        said = await _without_pause(trial, check)
    return f"{said}; in a trial before it {first}: is this computer busy?"


async def _without_pause(trial: BodyTrial, check: Check) -> str:
    """What a check says in a trial in which this program has not paused, or in the last of
    `PAUSES_MAX`. Raises WrongError."""
    for left in reversed(range(PAUSES_MAX)):
        trial.paused_for_us = 0
        try:
            said = await check(trial)
        except WrongError:
            if not left or trial.paused_for_us <= PAUSE_US:
                raise
        else:
            if not left or trial.paused_for_us <= PAUSE_US:
                return said
        halt(trial.body)
    raise AssertionError("the last trial decides")


async def judged(
    trial: BodyTrial, tell: Callable[[Finding], None], checks: Mapping[str, Check] = CHECKS
) -> list[Finding]:
    """Every check in order; a body that does not open ends it."""
    findings: list[Finding] = []
    for name, check in checks.items():
        try:
            said = await confirmed(trial, name, check)
            finding = Finding(name, True if said else None, said or "not tried: needs --machine")
        except (WrongError, OSError) as problem:
            finding = Finding(name, False, str(problem) or type(problem).__name__)
        if not finding.ok:
            halt(trial.body)
        findings.append(finding)
        tell(finding)
        if name == "opens" and not finding.ok:
            break
    try:
        with calling("close"):
            trial.body.close()
    except WrongError as problem:
        findings.append(Finding("close", False, str(problem)))
        tell(findings[-1])
    return findings


def rehearse(vehicle: Vehicle) -> None:
    """Load the kernels of wheels. This takes a second on a busy computer, in which no command is sent."""
    wheel_drive = WheelDrive(WheelBase.of(vehicle, wheel_radius_m=0.1))
    for command in (Drive(0.5, 0.0), Drive(0.0, 0.5), HALT):
        wheel_drive.speeds(GatedDrive(command), 0.0)


def halt(body: RobotBody) -> None:
    """Let it stand; a driver that fails at this has a finding already."""
    with suppress(Exception):
        body.drive(HALT, BodyTrial.now_us())


def body_check(
    name: str, options: Sequence[str], vehicle: Vehicle, origin: tuple[float, float] | None,
    machine: str | None, as_json: bool,
) -> int:  # fmt: skip
    """The exit code of `headland body-check`: 0 if no check failed, 1 if one did, 2 for a wrong argument.

    `name`: a plug-in, or "module:Name". `machine`: HOST:PORT of the simulated machine's orders.
    """
    import_from(Path())
    try:
        orders = None
        if machine is not None:
            orders = orders_at(machine)
        values = {key: _value(text) for key, _, text in (each.partition("=") for each in options)}
        plugin, factory = (None, name) if name not in plugins() and ":" in name else (name, None)
        body = made(plugin, factory, 0, values)
        body.declare(DeclaredMachine(vehicle, origin))
    except (FactoryError, ValueError) as problem:
        return wrong(str(problem) or type(problem).__name__)
    except OSError:  # a device that is not there, which every command tells
        raise
    except Exception as problem:  # drivers raise what they like
        return wrong(f"declare raised {fault_text(problem)}")
    rehearse(vehicle)
    console = Console(highlight=False)

    def tell(finding: Finding) -> None:
        if not as_json:
            print_findings(console, [finding._replace(what=f"{finding.what:<17}")])

    try:
        findings = asyncio.run(judged(BodyTrial(body, vehicle, orders), tell))
    except KeyboardInterrupt:
        with suppress(Exception):  # of a driver that is not open
            body.close()
        return INTERRUPTED
    bad = [finding for finding in findings if finding.ok is False]
    passed = sum(finding.ok is True for finding in findings)
    if as_json:
        print(dumps({"passed": passed, "findings": [finding._asdict() for finding in findings]}))
    else:
        console.print(f"{passed} of {len(CHECKS)} checks passed")
    return 1 if bad else 0


def orders_at(machine: str) -> tuple[str, int]:
    """Host and port of the orders of a machine. Raises ValueError.

    >>> orders_at("[::1]:5003")
    ('::1', 5003)
    """
    host, _, port = machine.rpartition(":")
    host = host[1:-1] if host.startswith("[") and host.endswith("]") else host
    if not host or not port.isdecimal() or not 0 < int(port) <= PORT_MAX:
        raise ValueError(f"--machine {machine}: it is HOST:PORT, as 127.0.0.1:5003")
    return host, int(port)


def _value(text: str) -> Any:
    """A value of an option: JSON if it is some, else the text itself."""
    try:
        return json.loads(text)
    except ValueError:
        return text
