"""The result of a run, measured from the world's truth and the wire, never from a robot's
belief."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from sim.world.reachable_ground import Unreached

COVERAGE_MIN = 0.99995  # prints as 100.00 %


class FieldOutcome(NamedTuple):
    """The figures of one run, as its report has them."""

    scenario: str
    robots: int
    seed: int
    silence_policy: str
    authenticated: bool
    finished: bool  # every section within reach DONE on every running replica, and digests equal
    coverage: float  # share of the area asked for that the implement swept
    reachable: float  # share of that area that these bodies can work at all
    reached: float  # share worked of what they can work; the run is judged by it
    makespan_s: float  # when the last part was worked
    worked_twice: float  # share swept by two robots: overlaps of neighbours and real duplicates
    units_twice: int  # units announced by two robots: duplicate work
    contacts: int  # of bodies; contacts of implements are counted separately
    # Steps in which a robot that had to stand was commanded to move, or moved.
    moved_after_stop: int
    closest_m: float  # smallest gap between two bodies seen
    replicas_equal: bool
    frames: Mapping[str, int]  # by kind
    bus_load: float  # share of the bus in use, exact bits
    bus_load_worst_case: float  # the same frames at worst-case stuffing
    claims_lost: int
    malformed: int
    refused: (
        # stops, resets and commands without valid authority, counted by each robot that received
        # them.
        int
    )
    trace_hash: str
    sections: int
    work_m: float  # total length of all swaths
    travel_m: float  # distance driven by all robots
    simulated_s: float
    wall_s: float
    # Steps of 10 ms made by pymunk; none in a protocol run, which has no bodies.
    pymunk_steps: int = 0
    # Ground of the field that the bodies cannot work, and why.
    unreached: tuple[Unreached, ...] = ()
    # What they could have worked and did not: how much, where, and which robot stands there.
    missed: str = ""
    # Contacts of lowered implements with each other or with bodies. They do not count for
    # `success`: robots that steer, and robots that lose frames, do not avoid all of them.
    implement_contacts: int = 0
    # People, vehicles and boxes that lowered implements were drawn over, or that moved into them.
    things_under_bars: int = 0
    first_contact: str = ""  # its time, robots and place; empty: none

    @property
    def success(self) -> bool:
        """Whether all reachable ground is worked, no robot touched anything or moved after a stop,
        and all replicas are equal."""
        return (
            self.finished
            and self.reached >= COVERAGE_MIN
            and self.contacts == 0
            and self.moved_after_stop == 0
            and self.replicas_equal
        )

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain values for JSON."""
        return {
            **self._asdict(), "frames": dict(self.frames), "success": self.success,
            "unreached": [part._asdict() for part in self.unreached],
        }  # fmt: skip
