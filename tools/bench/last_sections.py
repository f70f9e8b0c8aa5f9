"""What a fleet could gain if a robot without work took the far end of a section that another one works.

The bound is computed from true tracks, with hindsight: a robot that has ended its last work knows who
will be last, and when. It drives straight to the end of that robot's work and works towards it until
they meet, as fast as the other one did with all its delays. It may do so again. Nothing is claimed and no
body is in the way, so no fleet gains as much.
"""

from collections.abc import Mapping, Sequence
from heapq import heapify, heappop, heappush
from math import hypot
from typing import Final, NamedTuple

import numpy as np

from agent.interface.config import S
from agent.interface.geometry import Point
from sim.world.ground_truth import TrackPoint

# To begin a stretch, besides the way: to brake, to turn, and to gain speed again. As long as ways of 3 m
# between rows take (docs/measured/fields.md).
BEGIN_S: Final = 3.0
WORTH_S: Final = 2.0  # a split that saves less is not made
TIMES_EACH: Final = 10  # splits at most, for each robot


class IdealSplit(NamedTuple):
    """Seconds from the start of a run."""

    end_s: float  # as driven
    mean_end_s: float  # of the robots' last work
    split_end_s: float  # with splits
    splits: int


def ideal_split(tracks: Mapping[int, Sequence[TrackPoint]], speed_m_s: float) -> IdealSplit:
    """The end of a run with ideal splits of the last sections. `speed_m_s`: on the way to them."""
    rows = {slot: np.array([p[:4] for p in track], float) for slot, track in tracks.items()}
    ends_s: dict[int, float] = {}
    far: dict[int, Point] = {}  # the end of the work that is left to each robot
    for slot, track in rows.items():
        down = np.flatnonzero(track[:, 3])
        if down.size:
            ends_s[slot] = float(track[down[-1], 0]) / S
            far[slot] = float(track[down[-1], 1]), float(track[down[-1], 2])
    if not ends_s:
        return IdealSplit(0.0, 0.0, 0.0, 0)
    end_s, mean_end_s = max(ends_s.values()), float(np.mean(list(ends_s.values())))
    driven_s, here, splits = dict(ends_s), dict(far), 0
    free = [(at_s, slot) for slot, at_s in ends_s.items()]
    heapify(free)
    while free and splits < TIMES_EACH * len(ends_s):
        now_s, slot = heappop(free)
        last = max(ends_s, key=lambda other: (ends_s[other], -other))
        if now_s < ends_s[slot] or last == slot:
            continue
        apart_m = hypot(far[last][0] - here[slot][0], far[last][1] - here[slot][1])
        met_at_s = (now_s + ends_s[last] + BEGIN_S + apart_m / speed_m_s) / 2
        if met_at_s > ends_s[last] - WORTH_S:
            continue
        splits += 1
        met = far[last]
        if met_at_s <= driven_s[last]:
            times, x, y = rows[last][:, 0] / S, rows[last][:, 1], rows[last][:, 2]
            met = float(np.interp(met_at_s, times, x)), float(np.interp(met_at_s, times, y))
        for each in (slot, last):
            ends_s[each], far[each], here[each] = met_at_s, met, met
            heappush(free, (met_at_s, each))
    return IdealSplit(end_s, mean_end_s, max(ends_s.values()), splits)
