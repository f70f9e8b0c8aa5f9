"""A robot that takes places and no velocities: Nav2's action NavigateToPose.

The peer decides twenty times a second where to. So the robot is given a place a little ahead on that
course, and a newer one before it is there: Nav2 replaces a goal by a later one. To stand, the goal is
cancelled. Callbacks come in the thread of the node.
"""

import time
from math import atan2, cos, hypot, pi, remainder, sin
from threading import Lock
from typing import Any, Final, NamedTuple

AHEAD_S: Final = 1.5  # of the wanted speed, from the robot to the place that it is given
AHEAD_MIN_M: Final = 0.3  # a nearer place is within the tolerance of Nav2's goal checker
RENEW_S: Final = 0.5  # a third of the way: the robot need not brake for the end of it
TURNED_RAD: Final = 0.35  # a course that differs by more is told at once
STANDS_M_S: Final = 0.02
# A goal that is not answered by then was lost with its server: Nav2 starts again. Answers take
# milliseconds, and seconds on a machine that is overloaded.
ANSWER_S: Final = 3.0


class _Told(NamedTuple):
    """The newest goal."""

    course_rad: float
    at_s: float  # on the monotonic clock


class NavigateGoals:
    """Sends one robot places ahead on its course, and cancels the newest to make it stand."""

    def __init__(self, node: Any, name: str) -> None:
        """`node`: of rclpy. `name`: of the action. Raises ValueError without nav2_msgs."""
        try:
            from nav2_msgs.action import NavigateToPose
        except ImportError:
            raise ValueError(f"{name}: needs nav2_msgs, which comes with Nav2") from None
        from rclpy.action.client import ActionClient

        self.name, self.kind, self.node = name, NavigateToPose, node
        self.client: Any = ActionClient(node, NavigateToPose, name)
        self.sent = 0
        self._lock = Lock()  # the bus's thread wants, and the node's answers
        self._told: _Told | None = None  # None: the robot is to stand
        self._unanswered = 0  # number of the goal that the robot is to accept or reject; 0: none
        self._handles: list[Any] = []  # of goals that may still be driven

    @property
    def is_served(self) -> bool:
        """Whether the robot has such an action."""
        return bool(self.client.server_is_ready())

    @property
    def is_under_way(self) -> bool:
        """Whether the robot has accepted a goal that was not cancelled."""
        return bool(self._handles)

    def want(self, place: tuple[float, float], velocity: tuple[float, float], frame: str) -> None:
        """Drive on: metres and metres a second in `frame`, the frame of the robot's odometry."""
        speed_m_s = hypot(*velocity)
        if speed_m_s < STANDS_M_S:
            self.stand()
            return
        course_rad, now_s = atan2(velocity[1], velocity[0]), time.monotonic()
        with self._lock:
            told = self._told
            if told is not None:
                turned = abs(remainder(course_rad - told.course_rad, 2 * pi)) > TURNED_RAD
                if now_s - told.at_s < (ANSWER_S if self._unanswered else 0.0):
                    return
                if now_s - told.at_s < RENEW_S and not turned:
                    return
            self._told = _Told(course_rad, now_s)
            self.sent += 1
            number = self._unanswered = self.sent
        ahead_m = max(AHEAD_MIN_M, AHEAD_S * speed_m_s)
        goal = self.kind.Goal()
        goal.pose.header.frame_id = frame
        goal.pose.header.stamp = self.node.get_clock().now().to_msg()
        goal.pose.pose.position.x = place[0] + ahead_m * cos(course_rad)
        goal.pose.pose.position.y = place[1] + ahead_m * sin(course_rad)
        goal.pose.pose.orientation.z = sin(course_rad / 2)
        goal.pose.pose.orientation.w = cos(course_rad / 2)
        sent = self.client.send_goal_async(goal)
        sent.add_done_callback(lambda answer: self._answered(number, answer))

    def _answered(self, number: int, answer: Any) -> None:
        handle = answer.result()
        with self._lock:
            newest = number == self.sent
            if newest:
                self._unanswered = 0
            if handle is None or not handle.accepted:
                return
            stands = self._told is None
            # Nav2 has ended the earlier goals by accepting this one.
            self._handles = [] if stands else [handle, *([] if newest else self._handles)]
        if stands:  # it was to stand before the robot had answered
            handle.cancel_goal_async()

    def stand(self) -> None:
        """Cancel what is being driven; once."""
        with self._lock:
            self._told = None
            handles, self._handles = self._handles, []
        for handle in handles:
            handle.cancel_goal_async()
