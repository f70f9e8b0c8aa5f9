"""When robots of a field stand: before they leave, while they have work, and after their last work."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from agent.interface.config import S
from sim.world.ground_truth import TrackPoint

STILL_M_S: Final = 0.05  # a slower robot stands


class StandingTimes(NamedTuple):
    """Seconds of a robot, in the mean of the fleet."""

    before_s: float  # until it moves for the first time
    meanwhile_s: float
    after_s: float  # its last work

    @property
    def total_s(self) -> float:
        """All of them."""
        return sum(self)


def standing_times(tracks: Sequence[Sequence[TrackPoint]], end_s: float) -> StandingTimes:
    """Of robots with these true tracks, up to `end_s`, seconds."""
    return StandingTimes(*np.mean([_of_one(track, end_s) for track in tracks], axis=0).tolist())


def _of_one(track: Sequence[TrackPoint], end_s: float) -> tuple[float, float, float]:
    rows = np.array([point[:4] for point in track], dtype=np.float64)
    rows = rows[rows[:, 0] <= end_s * S]
    at_s = rows[:, 0] / S
    passed_s = np.diff(at_s)
    driven_m = np.hypot(np.diff(rows[:, 1]), np.diff(rows[:, 2]))
    stood = driven_m < STILL_M_S * np.maximum(passed_s, 1e-9)
    moves, works = np.flatnonzero(~stood), np.flatnonzero(rows[:, 3])
    first_s = at_s[moves[0]] if moves.size else end_s
    last_s = at_s[works[-1]] if works.size else 0.0
    before = stood & (at_s[1:] <= first_s)
    after = stood & ~before & (at_s[1:] > last_s)
    unseen_s = max(0.0, end_s - float(at_s[-1]))  # a track may end where the robot stands
    return (
        float(passed_s[before].sum()),
        float(passed_s[stood & ~before & ~after].sum()),
        float(passed_s[after].sum()) + unseen_s,
    )
