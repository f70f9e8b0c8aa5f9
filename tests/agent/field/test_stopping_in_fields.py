"""In a field, a robot is never where it cannot stop before another one that halts or comes on."""

from dataclasses import dataclass
from math import atan2, hypot, pi
from random import Random

import pytest
from shapely.geometry import box

from agent.field.field_plan import FieldPlan, FieldValues, divided
from agent.interface.lifecycle import State
from agent.interface.mission import STILL
from agent.interface.observation import Neighbour, Observation
from agent.interface.vehicle import Vehicle
from agent.runtime.mission_parts import field_parts
from protocol.frames.fleet_frames import Pose

DT_S, PERIOD_US = 0.05, 50_000
VEHICLE = Vehicle()
LIMIT_M_S2 = VEHICLE.acceleration_m_s2
PLAN = FieldPlan(
    divided("square", box(-60, -60, 60, 60), (0.0, 0.0), FieldValues(), VEHICLE), VEHICLE
)


@pytest.mark.parametrize("seed", range(20))
def test_a_robot_that_is_pushed_ahead_meets_no_third_one(seed: int) -> None:
    """A working robot comes from behind, and another one crosses ahead and halts in our way.

    The other two give no way, as robots that are hemmed in; they brake before our body when that is
    just possible.
    """
    rng = Random(seed)
    motion = field_parts(0, PLAN).motion
    assert motion is not None
    motion.set_state(State.WORKING)
    here, speed_m_s = Moving(0.0, 0.0, VEHICLE.speed_m_s, 0.0), VEHICLE.speed_m_s
    behind = Moving(-rng.uniform(3.0, 4.0), rng.uniform(-0.5, 0.5), speed_m_s, 0.0)
    ahead_m, for_s = rng.uniform(8.0, 14.0), rng.uniform(3.0, 5.0)
    crosses = Moving(ahead_m, -for_s * speed_m_s, 0.0, speed_m_s)
    for k in range(160):
        now_us = k * PERIOD_US
        others = {1: behind, 2: crosses}
        for slot, other in others.items():
            gap_m = hypot(other.x_m - here.x_m, other.y_m - here.y_m) - 2 * VEHICLE.radius_m
            assert gap_m > 0.0, f"contact with {slot} after {now_us / 1e6} s, seed {seed}"
            other_m_s = hypot(other.vx_m_s, other.vy_m_s)
            if gap_m < 0.3 + 0.1 * other_m_s + other_m_s**2 / (2 * LIMIT_M_S2):
                other.steer(0.0, 0.0)
            other.move()
        seen = {slot: Neighbour(other.pose(), now_us) for slot, other in others.items()}
        sensed = Observation(here.x_m, here.y_m, 0.0, here.vx_m_s, here.vy_m_s, sensed_at_us=now_us)
        drive = motion.drive(sensed, STILL._replace(vx_m_s=-speed_m_s), seen, now_us)
        here.steer(drive.vx_m_s, drive.vy_m_s)
        here.move()


@dataclass
class Moving:
    """A body whose velocity follows what is wanted as its wheels can."""

    x_m: float
    y_m: float
    vx_m_s: float
    vy_m_s: float

    def steer(self, vx_m_s: float, vy_m_s: float) -> None:
        cx, cy = vx_m_s - self.vx_m_s, vy_m_s - self.vy_m_s
        part = min(1.0, LIMIT_M_S2 * DT_S / max(hypot(cx, cy), 1e-9))
        self.vx_m_s, self.vy_m_s = self.vx_m_s + cx * part, self.vy_m_s + cy * part

    def move(self) -> None:
        self.x_m, self.y_m = self.x_m + self.vx_m_s * DT_S, self.y_m + self.vy_m_s * DT_S

    def pose(self) -> Pose:
        course_rad = atan2(self.vy_m_s, self.vx_m_s) % (2 * pi)
        speed_m_s = hypot(self.vx_m_s, self.vy_m_s)
        return Pose(self.x_m, self.y_m, course_rad, speed_m_s, State.WORKING, False, 0, True)
