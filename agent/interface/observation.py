"""What a robot knows of its surroundings: its own sensors' reading, and the poses of others.

SI units. Field frame: x east, y north, metres.
"""

from collections.abc import Mapping
from typing import NamedTuple

from agent.interface.instants import NEVER_US
from protocol.frames.fleet_frames import Pose


class Neighbour(NamedTuple):
    """The newest pose of another member, and when it was received, microseconds."""

    pose: Pose
    heard_at_us: int


class VisibleParcel(NamedTuple):
    """A parcel within a carrier's reach, as its scanner sees it."""

    x_m: float
    y_m: float
    on_robot: bool  # it is on a robot that has died


NOTHING_SEEN: Mapping[int, VisibleParcel] = {}


class Observation(NamedTuple):
    """The current reading of the robot's own sensors. Field frame: x east, y north, metres."""

    x_m: float
    y_m: float
    heading_rad: float  # counter-clockwise from east
    vx_m_s: float
    vy_m_s: float
    # One per ray, counter-clockwise from the heading; inf: nothing. Empty: no range sensors, or no
    # scan that is new enough.
    ranges_m: tuple[float, ...] = ()
    battery: float = 1.0  # share of a full charge
    bodies: tuple[tuple[float, float], ...] = ()  # others in sight, metres east and north of us
    load: int = -1  # on a carrier, the number of the parcel aboard; -1: none
    parcels: Mapping[int, VisibleParcel] = NOTHING_SEEN  # parcels within a carrier's reach
    sensed_at_us: int = NEVER_US  # on the clock of the peer that receives it
    health: float = 1.0  # reported by the machine's own controller: 0.0 failed to 1.0 healthy
    # Standard deviation of the place, in metres and in each direction; 0.0: exact, as in a simulator.
    position_accuracy_m: float = 0.0
    heading_accuracy_rad: float = 0.0  # standard deviation
    implement_down: bool | None = None  # None: nothing senses it
    # Whether a machine that takes orders carries ours out. Before it does, and when it has ended one, its
    # place need not follow what it is told.
    under_way: bool = True
