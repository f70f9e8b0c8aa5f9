"""What is declared of a robot's vehicle: its size, its limits, and what its drive train can do."""

from enum import IntEnum
from math import radians, tan
from typing import NamedTuple

from agent.interface.config import ACTUATOR_TTL_US, BRAKING_SHARE, S
from agent.interface.motion_controller import BodyLimits


class DriveTrain(IntEnum):
    """How a vehicle can move; motion controllers and the simulator's physics depend on it."""

    MECANUM = 0  # moves in any direction without turning
    DIFFERENTIAL = 1  # turns on the spot
    ACKERMANN = 2  # steers like a tractor


class Vehicle(NamedTuple):
    """The declared vehicle of a fleet, equal for all its robots."""

    radius_m: float = 0.8  # of the circle round it
    speed_m_s: float = 2.5
    acceleration_m_s2: float = 1.5
    drive: DriveTrain = DriveTrain.MECANUM
    wheelbase_m: float = 1.2  # with ACKERMANN
    track_m: float = 1.0  # with DIFFERENTIAL and ACKERMANN
    steer_rad: float = radians(40.0)  # full lock, with ACKERMANN
    steer_rad_s: float = 0.8  # how fast the wheels are turned, with ACKERMANN

    @property
    def limits(self) -> BodyLimits:
        """What collision avoidance needs to know of the body."""
        return BodyLimits(self.radius_m, self.speed_m_s, self.acceleration_m_s2)

    @property
    def braking_m_s2(self) -> float:
        """The deceleration that missions plan with."""
        return BRAKING_SHARE * self.acceleration_m_s2

    def stopping_m(self, speed_m_s: float) -> float:
        """Metres until it stands after its newest command, as other robots reckon with it."""
        return speed_m_s * ACTUATOR_TTL_US / S + speed_m_s**2 / (2.0 * self.acceleration_m_s2)

    @property
    def turn_radius_m(self) -> float:
        """Radius of the tightest circle; 0 for vehicles that turn on the spot."""
        if self.drive is not DriveTrain.ACKERMANN:
            return 0.0
        return self.wheelbase_m / tan(self.steer_rad)
