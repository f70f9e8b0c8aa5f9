"""What came of a run, measured from the world's truth and the wire, never from a robot's belief."""

from collections.abc import Mapping
from typing import Any, NamedTuple


class Outcome(NamedTuple):
    scenario: str
    robots: int
    seed: int
    silence_policy: str
    authenticated: bool
    finished: bool  # every section DONE on every running replica
    coverage: float  # share of the reachable area worked, by the world
    makespan_s: float  # last unit worked
    duplicate_share: float  # area worked by more than one robot's intent, over the area
    contacts: int
    closest_m: float  # smallest gap between two bodies seen
    replicas_equal: bool
    frames: Mapping[str, int]  # by kind
    bus_load: float  # share of the bus in use, exact bits
    bus_load_worst_case: float  # the same at worst-case stuffing
    claims_lost: int
    malformed: int
    trace_hash: str
    sections: int
    work_m: float  # length of all swaths
    travel_m: float  # what all robots drove
    wall_s: float

    @property
    def success(self) -> bool:
        return self.finished and self.coverage >= 0.9995 and self.contacts == 0 and self.replicas_equal

    def to_dict(self) -> dict[str, Any]:
        return {**self._asdict(), "frames": dict(self.frames), "success": self.success}
