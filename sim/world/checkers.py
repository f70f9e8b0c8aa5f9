"""The rules of the physical world, each judged from true positions and commands alone.

A checker does not know the agents. It gets what people did (pressed, released) and the field, and
it observes the bodies. `violations` is empty if the rule held. S1 and S7 are names of
invariants; ARCHITECTURE.md lists them.
"""

from collections.abc import Collection, Mapping, Sequence
from math import inf
from operator import attrgetter
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from agent.interface.config import ACTUATOR_TTL_US, S
from sim.world.ground_truth import Track
from sim.world.swath_truth import ALONG_COS, NEVER_US, SAMPLE_M, LineTruth, Polyline
from sim.world.world import STEP_US, World

# A broken rule is broken at every step; the first thousand are enough.
MOVES: Final = "moves after a stop"
VIOLATIONS_MAX: Final = 1_000
PAUSE_US: Final = 5 * S  # of a pass: a robot at 0.1 m/s comes to the next sample meanwhile
BESIDE_SHARE: Final = 0.6  # of the way between samples: one further ahead than this is not beside


class Violation(NamedTuple):
    """A rule that was broken: when, by which robots, and what happened, as text for a person."""

    rule: str
    t_us: int
    slots: tuple[int, ...]
    what: str
    last_at_us: int = 0  # of exclusive work: when the first of both ended its pass


class _Watch(NamedTuple):
    slots: frozenset[int]
    silent_at_us: int  # from here on no command to move may be in force
    still_at_us: int  # from here on no body may move


def lapse_for_us(lapsed_at_us: int | None, silent_at_us: int) -> int:
    """How long after `silent_at_us` the last command ends of a robot that died or hung before it."""
    if lapsed_at_us is None or lapsed_at_us >= silent_at_us:
        return 0
    return max(0, lapsed_at_us + ACTUATOR_TTL_US - silent_at_us)


class MotionAfterStopChecker:
    """S1: between a stop's bound and its release, no robot is commanded to move and none moves.

    Every step is checked. A robot that is carried, or shoved by another, is not excused
    automatically; leave it out of `slots` when pressing.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self.violations: list[Violation] = []
        self._watches: dict[int, _Watch] = {}
        self._lapsed_at_us: dict[int, int] = {}
        self._pressed = 0
        world.guards.append(self)

    def press(
        self,
        t_us: int,
        bound_for_us: int,
        slots: Collection[int],
        standing_for_us: int | None = None,
    ) -> int:
        """A stop pressed at `t_us`; returns the number to release it by.

        All commands to `slots` must end within `bound_for_us`, and all of these robots must stand after
        `standing_for_us` more (default: their longest braking time).
        """
        braking_for_us = [
            round(self.world.robots[slot].chassis.stopping_for_s * 1e6) for slot in slots
        ]
        longest_for_us = (
            max(braking_for_us, default=0) if standing_for_us is None else standing_for_us
        )
        self._pressed += 1
        silent_at_us = t_us + bound_for_us
        self._watches[self._pressed] = _Watch(
            frozenset(slots), silent_at_us, silent_at_us + longest_for_us
        )
        self.world.guard()
        return self._pressed

    def release(self, number: int, slots: Collection[int] | None = None) -> None:
        """A person released some robots, or all of them, from that stop."""
        watch = self._watches.pop(number)
        if slots is not None and watch.slots - frozenset(slots):
            self._watches[number] = watch._replace(slots=watch.slots - frozenset(slots))
        self.world.guard()

    def bound(self, number: int) -> frozenset[int]:
        """The robots that this stop still binds."""
        return self._watches[number].slots

    def lapses(self, slot: int, now_us: int) -> None:
        """The robot has died or hangs, so its last command holds until it expires in the
        actuator."""
        self._lapsed_at_us[slot] = now_us
        self.world.guard()

    def limits(self) -> dict[int, tuple[float, float]]:
        """The limits of the robots that must stand, see `sim.world.world.Guard`."""
        limits: dict[int, tuple[float, float]] = {}
        for watch in self._watches.values():
            for slot in watch.slots:
                silent_at_us, still_at_us = limits.get(slot, (inf, inf))
                late_for_us = lapse_for_us(self._lapsed_at_us.get(slot), watch.silent_at_us)
                silent_at_us = min(silent_at_us, watch.silent_at_us + late_for_us)
                limits[slot] = silent_at_us, min(still_at_us, watch.still_at_us + late_for_us)
        return limits

    def look(self, world: World) -> None:
        """Called after a step in which a robot moved although it had to stand."""
        if len(self.violations) >= VIOLATIONS_MAX:
            return
        now_us = world.now_us
        # Commands in force during the step were those at its beginning.
        begun_at_us = now_us - STEP_US
        for slot, (silent_at_us, still_at_us) in sorted(self.limits().items()):
            body = world.robots[slot]
            if begun_at_us >= silent_at_us and body.commanded_at_us == begun_at_us:
                self._add(now_us, slot, "told to move after a stop")
            if now_us >= still_at_us and body.moved_at_us == now_us:
                self._add(now_us, slot, MOVES)

    def _add(self, t_us: int, slot: int, what: str) -> None:
        self.violations.append(Violation("motion after stop", t_us, (slot,), what))


class ExclusiveWorkChecker:
    """S7: at no time do two robots work in one section.

    Work in a section means passing along its lines with the implement down. Crossing the lines is
    not work, and neither is lowering the implement a little early, in line with the neighbour's
    end. An implement that stays down against its command does no work of its robot either: how far
    a robot may drag it is the matter of S22. Where lines of two sections are so near to each other that
    one robot passes along both at once, neither counts.
    """

    def __init__(
        self, sections: Mapping[int, Sequence[Polyline]], tolerance_m: float, least_m: float = 0.0
    ) -> None:
        """`least_m`: shorter distances worked at a stretch do not count."""
        self.least = 1 + round(least_m / SAMPLE_M)  # samples at both ends of this distance
        lines = [(number, line) for number, group in sorted(sections.items()) for line in group]
        self.truth = LineTruth([line for _, line in lines], tolerance_m)
        section_of = np.array([number for number, _ in lines], dtype=np.int64)
        self.sample_section = section_of[self.truth.line_of]
        self.is_clear = ~self._shared(2 * tolerance_m)

    def _shared(self, within_m: float) -> NDArray[np.bool_]:
        """(samples,): whether a line of another section runs beside it, this near or nearer."""
        places, courses = self.truth.samples[:, :2], self.truth.samples[:, 2:]
        shared = np.zeros(len(places), dtype=np.bool_)
        if len(places):
            a, b = KDTree(places).query_pairs(within_m, output_type="ndarray").T
            parallel = np.abs(np.sum(courses[a] * courses[b], axis=1)) >= ALONG_COS
            # Not in line with it: there the other section goes on.
            ahead_m = np.abs(np.sum((places[b] - places[a]) * courses[a], axis=1))
            beside = parallel & (ahead_m < BESIDE_SHARE * SAMPLE_M)
            both = beside & (self.sample_section[a] != self.sample_section[b])
            shared[a[both]] = shared[b[both]] = True
        return shared

    def violations(
        self,
        tracks: Mapping[int, Track],
        spans_down: Mapping[int, Sequence[tuple[int, int]]] = MappingProxyType({}),
    ) -> list[Violation]:
        """One for each pass of a robot in a section in which another one is at work, when it begins.

        A robot works there from the first to the last sample of a pass along one line, of `least` samples
        or more. A pass ends where it is at no new sample for `PAUSE_US`. `spans_down`: by robot, pairs of
        times, microseconds. Between them its implement was down against its command.
        """
        passes: dict[int, list[tuple[int, int, int]]] = {}  # section: begin, end and robot
        for slot, track in sorted(tracks.items()):
            points = track.to_array()
            for begin_at_us, end_at_us in spans_down.get(slot, ()):
                points[(begin_at_us <= points[:, 0]) & (points[:, 0] < end_at_us), 3] = 0.0
            for section, begin_at_us, end_at_us in self._passes(points):
                passes.setdefault(section, []).append((begin_at_us, end_at_us, slot))
        found: list[Violation] = []
        for section, spans in sorted(passes.items()):
            open_spans = list[tuple[int, int, int]]()
            for begin_at_us, end_at_us, slot in sorted(spans):
                open_spans = [span for span in open_spans if span[1] > begin_at_us]
                for other in sorted({span[2] for span in open_spans} - {slot}):
                    pair, what = tuple(sorted((slot, other))), f"section {section} worked by both"
                    ends_at_us = max(span[1] for span in open_spans if span[2] == other)
                    last_at_us = min(end_at_us, ends_at_us)
                    found.append(Violation("exclusive work", begin_at_us, pair, what, last_at_us))
                open_spans.append((begin_at_us, end_at_us, slot))
        return sorted(found, key=attrgetter("t_us"))[:VIOLATIONS_MAX]

    def _passes(self, points: NDArray[np.float64]) -> list[tuple[int, int, int]]:
        """Section, begin and end of each pass, microseconds.

        What a robot works while its implement stays down is judged by itself, because it may come to a
        sample again later."""
        found: list[tuple[int, int, int]] = []
        down = points[:, 3] != 0.0
        edges = np.flatnonzero(np.diff(down, prepend=False, append=False))
        for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            worked_at_us = self.truth.worked_at_us(points[begin : end + 1])
            mine = np.flatnonzero((worked_at_us != NEVER_US) & self.is_clear)
            mine = mine[np.lexsort((worked_at_us[mine], self.truth.line_of[mine]))]
            lines, at_us = self.truth.line_of[mine], worked_at_us[mine]
            cuts = np.flatnonzero((np.diff(lines) != 0) | (np.diff(at_us) > PAUSE_US)) + 1
            for run in np.split(mine, cuts):
                if len(run) >= self.least:
                    section = int(self.sample_section[run[0]])
                    first, last = worked_at_us[run[[0, -1]]].tolist()
                    found.append((section, first, last))
        return found
