"""Fleets in fields that change while they work: a robot dies at half time, or joins at a third.

The opponent plans again at that moment (`tools/bench/field.py`): what is left of every section, from
where the live bodies are. It knows of the death at once, and no section is held. The time is that from
the start to the last finish.
"""

from enum import Enum
from typing import NamedTuple

from agent.interface.config import S
from agent.interface.geometry import Point, Polyline
from sim.fleet.outcome import FieldOutcome
from sim.fleet.simulated_fleet import Cluster
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load


class FleetChange(Enum):
    """What happens to the last robot."""

    DIES = "dies"
    JOINS = "joins"


SHARES = {FleetChange.DIES: 0.5, FleetChange.JOINS: 1 / 3}  # of the time that the whole fleet takes
KINDS = {FleetChange.DIES: "crash", FleetChange.JOINS: "join"}  # of the fault


class Moment(NamedTuple):
    """The truth at one moment."""

    at_s: float
    places: list[Point]  # of the robots that are switched on, metres
    left: list[list[Polyline]]  # of each section with uncovered units


class DrivenChange(NamedTuple):
    """A run with a change, and the truth at its moment."""

    setup: FieldSetup
    moment: Moment
    outcome: FieldOutcome


class WatchedRun(FieldRun):
    """A run that notes the first look after a moment."""

    moment: Moment | None = None

    def __init__(self, setting: FieldSetup, at_s: float) -> None:
        super().__init__(setting)
        self.at_s = at_s

    def look(self, cluster: Cluster) -> None:
        """Note the moment, once."""
        super().look(cluster)
        now_s = cluster.host.now_us() / S
        if self.moment is not None or now_s < self.at_s:
            return
        cluster.world.advance(cluster.host.now_us())
        best = max((robot.peer.progress for robot in cluster.running), key=lambda p: p.fraction())
        places = []
        for robot in cluster.running:
            _, x_m, y_m, _ = cluster.world.robots[robot.slot].track.points[-1]
            places.append((x_m, y_m))
        left = []
        for section in self.setting.field.sections:
            number = section.id
            stretches = section.stretches(lambda unit, number=number: not best.has(number, unit))  # type: ignore[misc]
            lines = [line for line, _ in stretches]
            if lines:
                left.append(lines)
        self.moment = Moment(now_s, places, left)


def changed_run(name: str, robots: int, seed: int, change: FleetChange) -> DrivenChange:
    """Run a shipped scenario in which its last robot dies, or joins late."""
    plain = FieldRun(FieldSetup(load(name).changed(robots, seed))).run()
    at_s = round(SHARES[change] * plain.makespan_s, 1)
    fault = {"kind": KINDS[change], "at_s": at_s, "robot": robots - 1}
    setup = FieldSetup(load(name).changed(robots, seed, faults=[fault]))
    run = WatchedRun(setup, at_s)
    outcome = run.run()
    assert run.moment is not None, "the run lasts longer than to the change"
    return DrivenChange(setup, run.moment, outcome)
