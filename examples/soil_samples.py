"""A mission of one's own: robots take a sample of soil at each post of a field.

A post is a section of the shared state with one unit, so that claims, hand-overs, stops and the record
of what is done are those that field work has. `docs/use/missions.md` goes through it.
"""

from collections.abc import Mapping, Sequence
from math import hypot

from agent.interface.config import S
from agent.interface.mission import STILL, ClaimRequest, FleetView, Mission, MotionRequest
from agent.motion.path_tracker import PathTracker
from agent.paths.route import Route
from agent.runtime.peer_factory import NO_MEMORY, MissionParts
from crdt import Phase
from sim.fleet.event_loop import EventLoop
from sim.fleet.scheduler import Script
from sim.fleet.simulated_fleet import Cluster
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load

Point = tuple[float, float]
DIG_US = 3 * S


class SoilSamples(Mission):
    def __init__(
        self, posts: Sequence[Point], route: Route, speed_m_s: float, braking_m_s2: float
    ) -> None:
        self.posts, self.route = posts, route
        self.speed_m_s, self.braking_m_s2 = speed_m_s, braking_m_s2
        self.section, self.goal = -1, (0.0, 0.0)
        self.tracker: PathTracker | None = None
        self.there_us: int | None = None

    @property
    def section_units(self) -> Mapping[int, int]:
        return dict.fromkeys(range(len(self.posts)), 1)

    @property
    def remaining_path(self) -> list[Point]:
        """For the map and the report."""
        return [] if self.tracker is None else self.tracker.remaining_path

    def choose(self, view: FleetView) -> ClaimRequest | None:
        """The nearest post that is free, or whose owner is silent for good."""
        open_posts = [
            (hypot(x - view.here.x_m, y - view.here.y_m), section, free)
            for section, (x, y) in enumerate(self.posts)
            if (free := view.allocation.phase_of(section) is Phase.FREE)
            or self._orphan(section, view)
        ]
        if not open_posts:
            return None
        away_m, section, free = min(open_posts)
        return ClaimRequest(section, bid=min(31, int(away_m / 5.0)), takeover=not free)

    def _orphan(self, section: int, view: FleetView) -> bool:
        owner = view.allocation.owner_of(section)
        held = view.allocation.phase_of(section) in (Phase.CLAIMED, Phase.STARTED)
        silent_at_us = view.fell_silent_at_us.get(-1 if owner is None else owner)
        return held and silent_at_us is not None and view.now_us - silent_at_us > 20 * S

    def approach(self, section: int, view: FleetView) -> MotionRequest:
        return self.travel(self.posts[section], view)

    def begin(self, section: int, view: FleetView) -> None:
        self.section, self.there_us = section, None

    def work(self, view: FleetView) -> MotionRequest:
        wish = self.travel(self.posts[self.section], view)
        if self.tracker is None or not self.tracker.arrived:
            return wish
        self.there_us = view.now_us if self.there_us is None else self.there_us
        if view.now_us - self.there_us < DIG_US:
            return STILL._replace(tool_on=True)  # the auger is down
        return STILL._replace(covered=(0,), finished=True)

    def travel(self, goal: Point, view: FleetView) -> MotionRequest:
        here = (view.here.x_m, view.here.y_m)
        if self.tracker is None or self.goal != goal:
            way = list(self.route.path(here, goal))
            self.goal, self.tracker = goal, PathTracker(way, self.speed_m_s, self.braking_m_s2)
        self.tracker.locate(*here)
        return MotionRequest(*self.tracker.velocity(*here))

    def accepts_goal(self, goal: Point) -> bool:
        return self.route.admits(goal)

    def abandon(self) -> None:
        self.section, self.tracker = -1, None

    def on_implement_raised(self) -> None:
        """The auger is up, or a stop came between: dig again."""
        self.there_us = None


class SoilSetting(FieldSetup):
    """A field whose work is not swaths but posts."""

    posts: Sequence[Point] = (
        (-25.0, -15.0),
        (0.0, -15.0),
        (25.0, -15.0),
        (25.0, 15.0),
        (0.0, 15.0),
        (-25.0, 15.0),
    )

    @property
    def section_count(self) -> int:
        return len(self.posts)

    def parts(
        self, slot: int, now_us: int = 0, recalled: Mapping[str, bytes] = NO_MEMORY
    ) -> MissionParts:
        route, vehicle = self.plan.route, self.vehicle
        deceleration_m_s2 = 0.5 * vehicle.acceleration_m_s2
        mission = SoilSamples(self.posts, route, vehicle.speed_m_s, deceleration_m_s2)
        return super().parts(slot, now_us, recalled)._replace(mission=mission)


def sample(robots: int = 3, seed: int = 1, limit_s: float = 300.0) -> tuple[float, Cluster]:
    """Until every replica knows that every post is done; seconds, and the cluster as it was then."""
    event_loop = EventLoop()
    cluster = Cluster(SoilSetting(load("small").changed(robots, seed)), "soil", None, event_loop)

    def play() -> Script[float]:
        cluster.boot_all()
        while not cluster.finished and event_loop.now_us() < limit_s * S:
            yield event_loop.now_us() + S // 2
            cluster.check()
        cluster.world.advance(event_loop.now_us())
        return event_loop.now_us() / S

    try:
        return event_loop.run(play()), cluster
    finally:
        cluster.end()


if __name__ == "__main__":
    seconds, fleet = sample()
    allocation = fleet.robots[0].peer.allocation
    owners = {f"S{section}": allocation.owner_of(section) for section in allocation.sections()}
    told = f"{allocation.done_count()} samples in {seconds:.0f} s"
    print(f"{told}, {len(fleet.world.contacts)} contacts, by {owners}")
