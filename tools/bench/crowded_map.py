"""A recording of as many robots as a fleet may have, for the page of the map.

To simulate a hundred robots takes minutes, and the page draws what it is told. So here robots drive along
swaths of a real field, without a fleet: their frames are those of the protocol as often as robots of a
large fleet send them, and their intents are as long as those of tractors.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import atan2, ceil, cos, dist, sin
from pathlib import Path
from random import Random
from typing import Any

from agent.interface.geometry import Point
from agent.interface.lifecycle import State
from crdt import Phase
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member, Pose
from protocol.frames.work_frames import TaskClaim, WorkProgress
from sim.record.mcap_log import MCAP, McapLog
from sim.record.robot_intent import POINTS_MAX
from sim.record.scene_builder import scene_of
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load

BEAT_US = 200_000  # of poses and intents, as in the largest fleets
HEARTBEATS, PROGRESSES = 7, 10  # a heartbeat and a progress in so many beats
SPEED_M_S = 2.0
FIRST_ADDRESS = 0x80
UNITS = 40  # of a block
NEAR_M, NEAR_MAX = 12.0, 8  # who is avoided


@dataclass
class _Driver:
    slot: int
    rng: Random
    sections: list[Any]
    section: int = 0
    claims: int = 0
    way: list[Point] = field(default_factory=list)  # what is left, without the place
    here: Point = (0.0, 0.0)
    heading_rad: float = 0.0

    def drive(self, distance_m: float) -> bool:
        """Whether another section was begun."""
        begun = not self.way
        if begun:
            chosen = self.rng.choice(self.sections)
            self.section, self.claims = int(chosen["id"]), self.claims + 1
            self.here, *self.way = [(x, y) for swath in chosen["swaths"] for x, y in swath]
        while self.way and distance_m > 0.0:
            (x, y), (to_x, to_y) = self.here, self.way[0]
            left_m = dist(self.here, self.way[0])
            if left_m <= distance_m:
                self.here = self.way.pop(0)
            else:
                self.heading_rad = atan2(to_y - y, to_x - x)
                self.here = (
                    x + distance_m * cos(self.heading_rad), y + distance_m * sin(self.heading_rad)
                )  # fmt: skip
            distance_m -= left_m
        return begun

    def frames(self, beat: int, begun: bool) -> Iterator[Any]:
        if beat == 0:
            yield Member(self.slot, 1, 7)
        if begun:
            epoch = min(self.claims, 255)
            yield TaskClaim(self.section, epoch, Phase.STARTED, 1, beat, self.slot)
        yield Pose(*self.here, self.heading_rad, SPEED_M_S, State.WORKING, False, 255)
        if (beat + self.slot) % HEARTBEATS == 0:
            yield Heartbeat(beat % 250, State.WORKING, False, False, True, False, 1.0, beat, 1)
        if (beat + self.slot) % PROGRESSES == 0:
            yield WorkProgress(self.section, 0, (1 << min(beat + 1, UNITS)) - 1)

    def intent(self, drivers: list["_Driver"]) -> dict[str, Any]:
        near = sorted((dist(self.here, other.here), other.slot) for other in drivers)
        avoids = [slot for apart_m, slot in near if slot != self.slot and apart_m < NEAR_M]
        vx, vy = SPEED_M_S * cos(self.heading_rad), SPEED_M_S * sin(self.heading_rad)
        return {
            "slot": self.slot, "x": round(self.here[0], 3), "y": round(self.here[1], 3),
            "heading": round(self.heading_rad, 3), "vx": round(vx, 3), "vy": round(vy, 3),
            "wanted": [round(vx, 2), round(vy, 2)],
            "path": [[round(x, 2), round(y, 2)] for x, y in self.way[:POINTS_MAX]],
            "avoids": avoids[:NEAR_MAX], "hears": [other.slot for other in drivers], "strange": [],
            "holds": [], "tool": True,
        }  # fmt: skip


def record(folder: Path, robots: int, seconds: float, seed: int) -> None:
    """Leave a run of so many simulated seconds in a folder. Raises McapMissing."""
    scene = scene_of(FieldSetup(load("oxted").changed(robots, seed)))
    log = McapLog(folder / MCAP, scene)
    drivers = [
        _Driver(slot, Random(f"{seed}/crowded map/{slot}"), scene["sections"])
        for slot in range(robots)
    ]
    for beat in range(ceil(seconds * 1e6 / BEAT_US)):
        for driver in drivers:
            t_us = beat * BEAT_US + driver.slot * BEAT_US // robots
            begun = driver.drive(SPEED_M_S * BEAT_US / 1e6)
            for message in driver.frames(beat, begun):
                log.write(t_us, encode(message, FIRST_ADDRESS + driver.slot))
            log.tell(t_us, driver.intent(drivers))
    log.close()
