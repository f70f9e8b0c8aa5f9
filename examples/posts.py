"""A mission of one's own: a sample of soil at each of six posts of a field."""

from collections.abc import Mapping
from math import hypot

import headland as hl

# Metres east and north of the middle of the field.
POSTS = [(-25, -15), (0, -15), (25, -15), (25, 15), (0, 15), (-25, 15)]
DIG_US = 3_000_000


class SoilSamples(hl.Mission):
    def __init__(self, site: hl.Site) -> None:
        self.site = site
        self.tracker: hl.PathTracker | None = None  # of the way to our post
        self.digging_since_us: int | None = None

    @property
    def section_units(self) -> Mapping[int, int]:
        """A post is a section, and a section has one unit of work."""
        return dict.fromkeys(range(len(POSTS)), 1)

    def choose(self, view: hl.FleetView) -> hl.ClaimRequest | None:
        """The nearest post that nobody has. A lower bid wins it."""
        away_m = {
            number: hypot(x - view.here.x_m, y - view.here.y_m)
            for number, (x, y) in enumerate(POSTS)
            if view.allocation.phase_of(number) is hl.Phase.FREE
        }
        if not away_m:
            return None
        nearest = min(away_m, key=away_m.__getitem__)
        return hl.ClaimRequest(nearest, bid=min(31, int(away_m[nearest] / 5)))

    def begin(self, section: int, view: hl.FleetView) -> None:
        """The post is ours: plan the way there."""
        here, vehicle = (view.here.x_m, view.here.y_m), self.site.vehicle
        way = list(self.site.route.path(here, POSTS[section]))
        braking_m_s2 = vehicle.acceleration_m_s2 / 2
        self.tracker = hl.PathTracker(way, vehicle.speed_m_s, braking_m_s2)
        self.digging_since_us = None

    def work(self, view: hl.FleetView) -> hl.MotionRequest:
        """Twenty times a second: drive, dig for three seconds, be done."""
        here = (view.here.x_m, view.here.y_m)
        if self.tracker is None:  # it was switched off since
            return hl.STILL._replace(given_up=True)
        self.tracker.locate(*here)
        if not self.tracker.arrived:
            return hl.MotionRequest(*self.tracker.velocity(*here))
        self.digging_since_us = self.digging_since_us or view.now_us
        if view.now_us - self.digging_since_us < DIG_US:
            return hl.STILL._replace(tool_on=True)
        return hl.STILL._replace(covered=(0,), finished=True)


if __name__ == "__main__":
    run = hl.Fleet("small", robots=3, mission=SoilSamples).play(seed=1)
    print(f"finished: {run.finished} after {run.simulated_s:.0f} s")
    print(f"contacts: {run.contacts}")
    for robot in run.robots:
        print(robot)
