"""A simulated ROS 2 robot: odometry and a laser out, `cmd_vel` in, and a place that follows from it.

It is a plain rclpy node, as of another maker: nothing is shared with the driver that it tries. Its
integrator is the truth. A velocity is in force for `life_s`, and then the base stands.
"""

import threading
import time
from math import atan2, cos, hypot, inf, sin
from typing import Any, Final, NamedTuple

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Bool

STEP_S: Final = 0.01  # of the integrator
ODOM_STEPS: Final = 4  # integrator steps between two messages: 25 Hz
LOST_AFTER_S: Final = 0.1  # a velocity that is not renewed for this long is over
BRAKING_FACTOR: Final = 2.0
TURNING_RAD_S2: Final = 4.0
BEAMS: Final = 72


class TracePoint(NamedTuple):
    """One step of the truth."""

    at_us: int  # on the monotonic clock
    x_m: float
    y_m: float
    implement: bool


class Ros2Machine:
    """A differential or omnidirectional base with the usual topics, and its trace."""

    def __init__(
        self, namespace: str, domain: int, x_m: float, y_m: float, heading_rad: float,
        acceleration_m_s2: float = 1.5, scan: bool = False,
    ) -> None:  # fmt: skip
        """Metres and radians in the frame of its odometry. `domain`: ROS_DOMAIN_ID."""
        self.x_m, self.y_m, self.heading_rad = x_m, y_m, heading_rad
        self.velocity = [0.0, 0.0, 0.0]  # forward, left, turn
        self.acceleration_m_s2, self.scan = acceleration_m_s2, scan
        self.trace: list[TracePoint] = []
        self.heard = 0  # velocities received
        self.others: list[Ros2Machine] = []  # what its laser sees, as circles of `RADIUS_M`
        self._told, self._told_at_s, self._implement = (0.0, 0.0, 0.0), -inf, False
        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain)
        self.node = Node("base", context=self.context, namespace=namespace)
        self._odom = self.node.create_publisher(Odometry, "odom", 10)
        self._scan = self.node.create_publisher(LaserScan, "scan", 10) if scan else None
        self._down = self.node.create_publisher(Bool, "implement_state", 10)
        self.node.create_subscription(Twist, "cmd_vel", self._take, 10)
        self.node.create_subscription(Bool, "implement", self._lower, 10)
        self._steps, self._last_at_s = 0, time.monotonic()
        self.node.create_timer(STEP_S, self._step)
        self._closing = False
        self._thread = threading.Thread(target=self.spin, daemon=True, name=f"base {namespace}")
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)

    def spin(self) -> None:
        """Until `close`."""
        while not self._closing:
            self._executor.spin_once(timeout_sec=0.1)

    def start(self) -> None:
        """Run in a thread of its own until `close`."""
        self._thread.start()

    def close(self) -> None:
        """End the thread, then leave the graph: rclpy aborts the process in the other order."""
        self._closing = True
        self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        try_shutdown(context=self.context)

    @property
    def speed_m_s(self) -> float:
        """Of the truth."""
        return hypot(self.velocity[0], self.velocity[1])

    def _take(self, message: Any) -> None:
        self.heard += 1
        self._told = (message.linear.x, message.linear.y, message.angular.z)
        self._told_at_s = time.monotonic()

    def _lower(self, message: Any) -> None:
        self._implement = bool(message.data)

    def _step(self) -> None:
        """As many steps as time has gone by: a machine does not slow down with its computer."""
        now_s = time.monotonic()
        while self._last_at_s + STEP_S <= now_s:
            self._last_at_s += STEP_S
            live = self._last_at_s - self._told_at_s < LOST_AFTER_S
            self._move(self._told if live else (0.0, 0.0, 0.0), live and self._implement)
            self._steps += 1
            if self._steps % ODOM_STEPS == 0 and now_s - self._last_at_s < ODOM_STEPS * STEP_S:
                self._tell()

    def _move(self, told: tuple[float, float, float], implement: bool) -> None:
        for axis, most in enumerate(
            (self.acceleration_m_s2, self.acceleration_m_s2, TURNING_RAD_S2)
        ):
            now, goal = self.velocity[axis], told[axis]
            slower = abs(goal) < abs(now) or goal * now < 0
            change = STEP_S * most * (BRAKING_FACTOR if slower else 1.0)
            self.velocity[axis] += min(max(goal - now, -change), change)
        ahead, left, turn = self.velocity
        middle = self.heading_rad + turn * STEP_S / 2
        self.x_m += (ahead * cos(middle) - left * sin(middle)) * STEP_S
        self.y_m += (ahead * sin(middle) + left * cos(middle)) * STEP_S
        self.heading_rad += turn * STEP_S
        if not self.trace or self.trace[-1].implement is not implement:
            self._down.publish(Bool(data=implement))
        self.trace.append(TracePoint(round(self._last_at_s * 1e6), self.x_m, self.y_m, implement))

    def _tell(self) -> None:
        odom = Odometry()
        odom.header.stamp = self.node.get_clock().now().to_msg()
        odom.header.frame_id, odom.child_frame_id = "odom", "base_link"
        odom.pose.pose.position.x, odom.pose.pose.position.y = self.x_m, self.y_m
        odom.pose.pose.orientation.z = sin(self.heading_rad / 2)
        odom.pose.pose.orientation.w = cos(self.heading_rad / 2)
        twist = odom.twist.twist
        twist.linear.x, twist.linear.y, twist.angular.z = self.velocity
        self._odom.publish(odom)
        if self._scan is not None:
            self._scan.publish(self._echoes(odom.header.stamp))

    def _echoes(self, stamp: Any) -> Any:
        """A laser that sees the other machines as points, from behind over the right to behind."""
        scan = LaserScan()
        scan.header.stamp, scan.header.frame_id = stamp, "base_link"
        scan.angle_min, scan.angle_increment = -3.14159265, 6.2831853 / BEAMS
        scan.angle_max = scan.angle_min + (BEAMS - 1) * scan.angle_increment
        scan.range_min, scan.range_max = 0.1, 20.0
        ranges = [inf] * BEAMS
        for other in self.others:
            east, north = other.x_m - self.x_m, other.y_m - self.y_m
            bearing = atan2(north, east) - self.heading_rad
            beam = round((bearing - scan.angle_min) / scan.angle_increment) % BEAMS
            ranges[beam] = min(ranges[beam], hypot(east, north))
        scan.ranges = ranges
        return scan
