"""S24: units whose work has been told are not worked once more, judged from true tracks.

A unit is part of a swath, as progress counts it (`agent/field/field_map.py`). It is worked when the
robot's centre has passed along all of it in one go, with the implement down throughout. Robots tell
units that they have worked; this checker is told when. Nothing is said of a unit that lies beside other
lines over all of its length, because a robot that follows these passes along it, too.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from agent.field.field_map import Section
from agent.interface.config import S
from sim.world.ground_truth import Track
from sim.world.swath_truth import NEVER_US, SAMPLE_M, LineTruth, Polyline

Unit = tuple[int, int]  # section, and number of the unit in it
KNOWN_US: Final = 1 * S  # a unit that was told this long ago is known to all that hear each other


class Pass(NamedTuple):
    """A whole unit that a robot has worked in one go."""

    unit: Unit
    slot: int
    begun_at_us: int
    ended_at_us: int


class RepeatedWorkChecker:
    """Which units of some sections robots have worked, and which of them although they were known."""

    def __init__(self, sections: Sequence[Section], tolerance_m: float) -> None:
        """`tolerance_m`: a robot no further from the line of a swath works it."""
        lines: list[Polyline] = []
        parts: list[tuple[int, int, int]] = []  # section, first unit and units of each line
        for section in sections:
            firsts = accumulate(section.units_of, initial=0)
            for swath, first, units in zip(section.swaths, firsts, section.units_of, strict=False):
                lines.append(swath)
                parts.append((section.id, first, units))
        self.truth = LineTruth(lines, tolerance_m)
        self.unit_of: list[Unit] = []  # of each sample
        for line, share in zip(
            self.truth.line_of.tolist(), self.truth.share_of.tolist(), strict=True
        ):
            section_id, first, units = parts[line]
            self.unit_of.append((section_id, first + min(int(share * units), units - 1)))
        self.samples_of = Counter(self.unit_of)
        self._beside_others = self._units_beside_other_lines()

    def _units_beside_other_lines(self) -> frozenset[Unit]:
        """Those whose samples all lie so near to another line that a robot on it may be on both."""
        line_of, near = self.truth.line_of, np.zeros(len(self.unit_of), np.bool_)
        reach_m = 2 * self.truth.tolerance_m + SAMPLE_M
        pairs = cKDTree(self.truth.samples[:, :2]).query_pairs(reach_m, output_type="ndarray")
        near[pairs[line_of[pairs[:, 0]] != line_of[pairs[:, 1]]].ravel()] = True
        alone = {
            unit for unit, beside in zip(self.unit_of, near.tolist(), strict=True) if not beside
        }
        return frozenset(self.samples_of.keys() - alone)

    def passes(self, slot: int, track: Track) -> list[Pass]:
        """The whole units that the robot of this track has worked, each time that it did."""
        found: list[Pass] = []
        points = track.to_array()
        down = points[:, 3] != 0.0
        edges = np.flatnonzero(np.diff(down, prepend=False, append=False)).tolist()
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            worked_at_us = self.truth.worked_at_us(points[begin : end + 1])
            passed_at_us: dict[Unit, list[int]] = {}
            for sample in np.flatnonzero(worked_at_us != NEVER_US).tolist():
                passed_at_us.setdefault(self.unit_of[sample], []).append(int(worked_at_us[sample]))
            found += [
                Pass(unit, slot, min(at_us), max(at_us))
                for unit, at_us in passed_at_us.items()
                if len(at_us) == self.samples_of[unit] and unit not in self._beside_others
            ]
        return found

    def repeated(self, tracks: Mapping[int, Track], told_at_us: Mapping[Unit, int]) -> list[Pass]:
        """The passes over units that some robot had told `KNOWN_US` or more before, in order of time.

        `told_at_us`: when each unit was told for the first time; one that is not in it never was.
        """
        return sorted(
            (
                each
                for slot, track in tracks.items()
                for each in self.passes(slot, track)
                if each.unit in told_at_us and each.begun_at_us > told_at_us[each.unit] + KNOWN_US
            ),
            key=lambda each: each.begun_at_us,
        )
