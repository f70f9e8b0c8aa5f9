"""What came of a run, measured from the world's truth and the wire, never from a robot's belief."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from sim.world.reachable_ground import Unreached

COVERAGE_MIN = 0.99995  # 100.00 % as it is printed


class Outcome(NamedTuple):
    scenario: str
    robots: int
    seed: int
    silence_policy: str
    authenticated: bool
    finished: bool  # every section DONE on every running replica, and their digests equal
    coverage: float  # share of the area that can be asked for, swept by the implement
    reachable: float  # share of that area that these bodies can work at all
    reached: float  # share worked of what they can work; this is judged
    makespan_s: float  # when the last of it was worked
    worked_twice: float  # share swept by two robots: overlaps of neighbours, and real duplicates
    units_twice: int  # units that two robots announced: duplicate work
    contacts: int  # of bodies; those of implements are beside it
    moved_after_stop: int  # steps in which a robot was told to move, or moved, that had to stand
    closest_m: float  # smallest gap between two bodies seen
    replicas_equal: bool
    frames: Mapping[str, int]  # by kind
    bus_load: float  # share of the bus in use, exact bits
    bus_load_worst_case: float  # the same frames at worst-case stuffing
    claims_lost: int
    malformed: int
    refused: (
        int  # stops, resets and commands without authority, counted by each robot that heard them
    )
    trace_hash: str
    sections: int
    work_m: float  # length of all swaths
    travel_m: float  # what all robots drove
    simulated_s: float
    wall_s: float
    pymunk_steps: int = 0  # of 10 ms, that pymunk has made; none in a drill, which has no bodies
    unreached: tuple[Unreached, ...] = ()  # ground of the field that they cannot work, and why
    # Of implements that were down, with others or with bodies. No part of `success`: robots that steer,
    # and robots that lose frames, do not avoid all of them.
    implement_contacts: int = 0

    @property
    def success(self) -> bool:
        return (
            self.finished
            and self.reached >= COVERAGE_MIN
            and self.contacts == 0
            and self.moved_after_stop == 0
            and self.replicas_equal
        )

    def to_dict(self) -> dict[str, Any]:
        return {
            **self._asdict(), "frames": dict(self.frames), "success": self.success,
            "unreached": [part._asdict() for part in self.unreached],
        }  # fmt: skip
