"""A ROS 2 robot as a body: odometry in, velocities out, laser scans as rays.

    [body]
    plugin = "ros2"
    options = { namespace = "/husky", scan = "scan" }

| topic | type | |
|---|---|---|
| `odom` | nav_msgs/Odometry | in: pose and velocity; the covariance of the pose is its accuracy |
| `scan` | sensor_msgs/LaserScan | in, if named: the nearest echo in each of `rays` directions |
| `cmd_vel` | geometry_msgs/Twist | out: 20 Hz, metres and radians a second in the frame of the robot |
| `implement` | std_msgs/Bool | out: whether the implement is to be down |
| `implement_state` | std_msgs/Bool | in, if named: whether it is down |

The frame of the odometry has to be that of the field: metres, x east, y north. `x_m`, `y_m` and
`heading_rad` say where its origin is otherwise. Odometry that drifts is no place in a field: give the
body the topic of a filter that fuses GNSS (`odom = "odometry/gps"`).

A command lives for 100 ms. After that the node sends a zero velocity, for as long as this process
lives. The driver of the base needs a time limit of its own, in ros2_control `cmd_vel_timeout: 0.1`.
"""

import asyncio
import time
from math import atan2, cos, inf, isfinite, pi, sin, sqrt
from typing import TYPE_CHECKING, Any, Final

from agent.interface.config import ACTUATOR_TTL_US, MS, SCAN_AGE_MAX_US
from agent.interface.effects import HALT, GatedDrive
from agent.interface.observation import Observation
from agent.interface.vehicle import DriveTrain
from agent.motion.wheel_kinematics import (
    WheelBase,
    WheelDrive,
    ackermann_body,
    differential_body,
    mecanum_body,
)
from agent.runtime.option_values import number, text, whole
from agent.runtime.robot_body import DeclaredMachine, RobotBody

if TYPE_CHECKING:
    from agent.runtime.ros2_goals import NavigateGoals
    from agent.runtime.ros2_node import Ros2Node

FIRST_S: Final = 10.0  # for the first odometry; discovery of other nodes takes up to some seconds
LOOK_S: Final = 0.02
RAYS: Final = 36
RAYS_MAX: Final = 360
DOMAIN_MAX: Final = 232  # of DDS: its ports end there
WHEEL_M: Final = 1.0  # any radius: wheel speeds are turned back into a velocity of the body
NO_ROS: Final = "the body ros2 needs rclpy: a ROS 2 installation, or pip install 'headland[ros2]'"
TTL_S: Final = ACTUATOR_TTL_US / 1e6
CANCEL_S: Final = 0.2  # for a goal on its way to be cancelled, before the node leaves
NORM_OFF: Final = 0.1  # of a rotation, from 1; the quaternion of a message that nobody filled is 0
CHECK_S: Final = 10 * MS / 1e6  # between two looks whether the command has expired
Twist3 = tuple[float, float, float]  # forward and left m/s, turn rad/s


class Ros2Body(RobotBody):
    """Sensors and actuators of one robot, by topics."""

    def __init__(
        self,
        slot: int,
        namespace: str = "",
        odom: str = "odom",
        cmd_vel: str = "cmd_vel",
        scan: str = "",
        rays: int = RAYS,
        domain: int | None = None,
        x_m: float = 0.0,
        y_m: float = 0.0,
        heading_rad: float = 0.0,
        implement_state: str = "",
        navigate: str = "",
    ) -> None:
        """Names of topics are relative to `namespace`; without one it is `/robot_N`. `scan`,
        `implement_state`: none if empty. `navigate`: an action NavigateToPose by which the robot is
        driven, in place of velocities. `domain`: ROS_DOMAIN_ID. Metres and radians: the origin of
        the odometry in the field. Raises ValueError, one line, for an option of another type or size."""
        rays = whole("rays", rays, 1, RAYS_MAX)
        domain = None if domain is None else whole("domain", domain, 0, DOMAIN_MAX)
        for name, topic in (("odom", odom), ("cmd_vel", cmd_vel)):
            text(name, topic, "the name of a topic")
        for name, topic in (
            ("namespace", namespace),
            ("scan", scan),
            ("implement_state", implement_state),
            ("navigate", navigate),
        ):
            if topic != "":  # without it there is none
                text(name, topic, "a name in ROS")
        self.slot, self.namespace = slot, namespace or f"/robot_{slot}"
        self.topics = (odom, cmd_vel, scan)
        self.implement_state, self.navigate = implement_state, navigate
        self.goals: NavigateGoals | None = None
        self._odom: tuple[float, float, str] = (0.0, 0.0, "")  # place and frame of the odometry
        self.rays, self.domain = rays, domain
        self.origin = (number("x_m", x_m), number("y_m", y_m), number("heading_rad", heading_rad))
        self.wheels: WheelDrive | None = None
        self.node: Ros2Node | None = None
        self._seen: Observation | None = None  # replaced as a whole, by the thread of the node
        self._scan: tuple[int, tuple[float, ...]] = (0, ())  # when it was true, and the ranges
        self._down: bool | None = None  # as its sensor said last
        self._lifts = self._lifts_told = 0  # times at which it was up; a short one counts too
        self._told: tuple[GatedDrive, float] = (HALT, 0.0)  # and when, on the monotonic clock

    def declare(self, machine: DeclaredMachine) -> None:
        """Take the drive train. Raises ValueError if rclpy is not installed."""
        self.wheels = WheelDrive(WheelBase.of(machine.vehicle, WHEEL_M))
        try:
            from agent.runtime import ros2_node  # noqa: F401
        except ImportError:
            raise ValueError(NO_ROS) from None

    async def open(self) -> None:
        """Join the graph, and wait for the first odometry. Raises OSError."""
        from geometry_msgs.msg import Twist
        from nav_msgs.msg import Odometry
        from sensor_msgs.msg import LaserScan
        from std_msgs.msg import Bool

        from agent.runtime.ros2_node import RELIABLE, SENSED, Ros2Node

        self._seen = None
        self.node = node = Ros2Node(f"headland_{self.slot}", self.namespace, self.domain)
        odom, cmd_vel, scan = self.topics
        self._twist, self._bool = Twist, Bool
        self._commands = node.node.create_publisher(Twist, cmd_vel, RELIABLE)
        if self.navigate:
            from agent.runtime.ros2_goals import NavigateGoals

            self.goals = NavigateGoals(node.node, self.navigate)
        self._implement = node.node.create_publisher(Bool, "implement", RELIABLE)
        node.node.create_subscription(Odometry, odom, self._placed, SENSED)
        if scan:
            node.node.create_subscription(LaserScan, scan, self._scanned, SENSED)
        if self.implement_state:
            node.node.create_subscription(Bool, self.implement_state, self._sensed, RELIABLE)
        node.node.create_timer(CHECK_S, self._expire)
        loop = asyncio.get_running_loop()
        ends_at_s = loop.time() + FIRST_S
        while missing := self._missing():
            if loop.time() > ends_at_s:
                self.close()
                raise OSError(f"ROS 2: nothing on {self.namespace}/{missing} in {FIRST_S:.0f} s")
            await asyncio.sleep(LOOK_S)

    def _missing(self) -> str:
        """What the robot does not have yet: a topic or an action; empty: all is there."""
        odom, _, scan = self.topics
        if self._seen is None:
            return odom
        if scan and not self._scan[1]:
            return scan
        return self.navigate if self.goals is not None and not self.goals.is_served else ""

    # ---------------------------------------------------------------- what the robot says

    def _placed(self, message: Any) -> None:
        """In the thread of the node."""
        assert self.node is not None
        now_us = time.monotonic_ns() // 1000
        at, turn, speed = (
            message.pose.pose.position,
            message.pose.pose.orientation,
            message.twist.twist,
        )
        norm = turn.w * turn.w + turn.x * turn.x + turn.y * turn.y + turn.z * turn.z
        if not abs(norm - 1.0) <= NORM_OFF:
            return  # no rotation, so no place
        x0_m, y0_m, h0_rad = self.origin
        heading_rad = h0_rad + atan2(
            2.0 * (turn.w * turn.z + turn.x * turn.y), 1.0 - 2.0 * (turn.y**2 + turn.z**2)
        )
        cos_0, sin_0 = cos(h0_rad), sin(h0_rad)
        cos_h, sin_h = cos(heading_rad), sin(heading_rad)
        values = (
            x0_m + cos_0 * at.x - sin_0 * at.y, y0_m + sin_0 * at.x + cos_0 * at.y, heading_rad,
            cos_h * speed.linear.x - sin_h * speed.linear.y,
            sin_h * speed.linear.x + cos_h * speed.linear.y,
        )  # fmt: skip
        if not all(map(isfinite, values)):
            return  # not a place; the robot stands when the last one is old
        self._odom = at.x, at.y, message.header.frame_id
        spread = message.pose.covariance
        known = isfinite(spread[0] + spread[7])
        accuracy_m = sqrt(max(spread[0], spread[7], 0.0)) if known else inf
        self._seen = Observation(
            *values, sensed_at_us=now_us - self._age_us(message.header.stamp),
            position_accuracy_m=accuracy_m, heading_accuracy_rad=sqrt(max(spread[35], 0.0)),
        )  # fmt: skip

    def _age_us(self, stamp: Any) -> int:
        """How long ago a message was true. One from the future is from a clock that is ahead."""
        assert self.node is not None
        age_ns: int = self.node.now_ns() - (stamp.sec * 1_000_000_000 + stamp.nanosec)
        return max(0, age_ns // 1000)

    def _scanned(self, message: Any) -> None:
        """In the thread of the node: the nearest valid echo of each sector, from the front on. A scan
        whose angles are none is no scan; the robot stands when the last one is old."""
        last_rad = message.angle_min + len(message.ranges) * message.angle_increment
        if not isfinite(last_rad + message.angle_min):
            return
        nearest = [inf] * self.rays
        for ray, range_m in enumerate(message.ranges):
            if message.range_min <= range_m <= message.range_max:
                angle = message.angle_min + ray * message.angle_increment
                sector = round(angle / (2 * pi) * self.rays) % self.rays
                nearest[sector] = min(nearest[sector], range_m)
        at_us = time.monotonic_ns() // 1000 - self._age_us(message.header.stamp)
        self._scan = at_us, tuple(nearest)

    def _sensed(self, message: Any) -> None:
        """In the thread of the node: the implement is down, or not."""
        self._down = bool(message.data)
        self._lifts += not self._down

    def sense(self, now_us: int) -> Observation | None:
        """The newest odometry, with the time of its stamp, and the newest scan unless it is old."""
        seen, (scanned_at_us, ranges_m) = self._seen, self._scan
        if time.monotonic_ns() // 1000 - scanned_at_us > SCAN_AGE_MAX_US:
            ranges_m = ()
        lifts, down = self._lifts, self._down
        if lifts != self._lifts_told:
            self._lifts_told, down = lifts, False
        under_way = self.goals is None or self.goals.is_under_way
        if seen is None:
            return None
        return seen._replace(ranges_m=ranges_m, implement_down=down, under_way=under_way)

    # ---------------------------------------------------------------- what the robot is told

    def drive(self, command: GatedDrive, now_us: int) -> None:
        """Publish the velocity now."""
        self._told = (command, time.monotonic())
        self._publish(self._velocity(command), command.tool_on)

    def _velocity(self, command: GatedDrive) -> Twist3:
        """In the frame of the robot, as far as its drive train can do it."""
        assert self.wheels is not None, "`declare` comes before `drive`"
        seen, base = self._seen, self.wheels.base
        if seen is None or command == HALT:
            return 0.0, 0.0, 0.0
        speeds = self.wheels.speeds(command, seen.heading_rad)
        wheels = speeds.wheels_rad_s
        if base.drive is DriveTrain.MECANUM:
            ahead, left, turn = mecanum_body(WHEEL_M, base.half_base_m + base.half_track_m, *wheels)
            return ahead, left, turn
        if base.drive is DriveTrain.DIFFERENTIAL:
            ahead, turn = differential_body(WHEEL_M, base.half_track_m, *wheels)
        else:
            ahead, turn = ackermann_body(WHEEL_M, base.half_base_m, wheels[0], speeds.steer_rad)
        return ahead, 0.0, turn

    def _publish(self, velocity: Twist3, tool_on: bool) -> None:
        self._implement.publish(self._bool(data=tool_on))
        if self.goals is not None:
            self._send_ahead(velocity)
            return
        twist = self._twist()
        twist.linear.x, twist.linear.y, twist.angular.z = map(float, velocity)
        self._commands.publish(twist)

    def _send_ahead(self, velocity: Twist3) -> None:
        """The course that is wanted, as a place on it; turning on the spot is left to the robot."""
        assert self.goals is not None
        command, _ = self._told
        if command == HALT or velocity == (0.0, 0.0, 0.0):
            self.goals.stand()
            return
        x_m, y_m, frame = self._odom
        turn_rad = -self.origin[2]
        cos_0, sin_0 = cos(turn_rad), sin(turn_rad)
        wanted = (
            cos_0 * command.vx_m_s - sin_0 * command.vy_m_s,
            sin_0 * command.vx_m_s + cos_0 * command.vy_m_s,
        )
        self.goals.want((x_m, y_m), wanted, frame)

    def _expire(self) -> None:
        """In the thread of the node: a command that nobody renews is over."""
        command, at_s = self._told
        if command != HALT and time.monotonic() - at_s > TTL_S:
            self._told = (HALT, at_s)
            self._lifts += command.tool_on
            self._publish((0.0, 0.0, 0.0), False)

    def close(self) -> None:
        """Stand, and leave the graph."""
        if self.node is None:
            return
        self._told = (HALT, 0.0)
        self._publish((0.0, 0.0, 0.0), False)
        if self.goals is not None:
            time.sleep(CANCEL_S)  # the node's thread takes the answer of a goal, and sends on
            self.goals = None
        self.node.close()
        self.node = None
