"""The graph of a ROS 2 installation, by rclpy."""

from collections.abc import Callable
from importlib import import_module
from time import monotonic
from types import SimpleNamespace
from typing import Any

from numpy import int8
from numpy.typing import NDArray
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from agent.runtime.ros2_node import COMPLETE, LATCHED, RELIABLE, Ros2Node
from tools.ros2.graph import KINDS, ActionGoal, Ended, GoalPlace, Publisher, Quality

PROFILES = {
    Quality.RELIABLE: RELIABLE, Quality.COMPLETE: COMPLETE, Quality.LATCHED: LATCHED,
}  # fmt: skip


THREADS = 4  # a stop and a release of each of two clients, besides what is heard
ERROR = 1  # any other than NONE: the numbers of Nav2 are of its planners


class DdsGoal:
    """A goal of a client of rclpy. Its action has no thread of its own: the node only learns the end."""

    def __init__(self, action: Any, handle: Any, stamp: Callable[[], Any]) -> None:
        self.action, self.handle, self.stamp = action, handle, stamp
        self.places, self._begun_s = _places(handle.request), monotonic()

    @property
    def cancelled(self) -> bool:
        """Whether the client wants it to be given up."""
        return bool(self.handle.is_cancel_requested)

    def tell(self, at: GoalPlace, left_m: float, places_left: int) -> None:
        """Publish feedback. `left_m`: the straight way; `places_left`: poses still to be reached."""
        told = self.action.Feedback()
        told.current_pose.header.frame_id = at.frame
        told.current_pose.header.stamp = self.stamp()
        told.current_pose.pose.position.x, told.current_pose.pose.position.y = at.x_m, at.y_m
        told.current_pose.pose.orientation.w = 1.0
        told.distance_remaining = left_m
        told.navigation_time = Duration(seconds=monotonic() - self._begun_s).to_msg()
        if hasattr(told, "number_of_poses_remaining"):
            told.number_of_poses_remaining = places_left
        self.handle.publish_feedback(told)

    def end(self, how: Ended, why: str) -> None:
        """Let the node give the result."""

        def result(handle: Any) -> Any:
            """In the thread of the node."""
            made = self.action.Result()
            if how is Ended.SUCCEEDED:
                handle.succeed()
            elif how is Ended.CANCELLED and handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
                made.error_code = ERROR
                if hasattr(made, "error_msg"):  # Nav2 has it since 1.4
                    made.error_msg = why
            return made

        self.handle.execute(result)


def _places(request: Any) -> list[GoalPlace]:
    poses = request.poses if hasattr(request, "poses") else [request.pose]
    return [
        GoalPlace(pose.header.frame_id, pose.pose.position.x, pose.pose.position.y)
        for pose in poses
    ]


class DdsGraph:
    """A node of rclpy, whose callbacks come in its threads: those of services beside the others.

    A release waits for the bus, and meanwhile a stop has to be heard."""

    @classmethod
    def joined(cls, name: str, namespace: str, domain: int | None) -> "DdsGraph":
        """A new node in a graph. `domain`: ROS_DOMAIN_ID; None: of the environment. Raises OSError."""
        return cls(Ros2Node(name, namespace, domain, THREADS))

    def __init__(self, node: Ros2Node) -> None:
        self.node, self.kinds = node, SimpleNamespace()
        self._served: list[Any] = []
        self._beside = ReentrantCallbackGroup()
        for name in KINDS:
            package, _, kind = name.split("/")
            try:
                setattr(self.kinds, kind, getattr(import_module(f"{package}.msg"), kind))
            except ModuleNotFoundError:  # tf2_msgs, which is in no wheel
                setattr(self.kinds, kind, None)

    def publisher(self, kind: str, topic: str, quality: Quality) -> Publisher:
        """Its reader gets what the quality promises, by the profiles of our nodes."""
        made: Publisher = self.node.node.create_publisher(
            getattr(self.kinds, kind), topic, PROFILES[quality]
        )
        return made

    def hear(self, topic: str, heard: Callable[[Any], None]) -> None:
        """Call back in the thread of the node."""
        self.node.node.create_subscription(Bool, topic, heard, RELIABLE)

    def serve(self, name: str, answer: Callable[[Any, Any], Any]) -> None:
        """Answer in a thread of the node, beside other answers."""
        self.node.node.create_service(Trigger, name, answer, callback_group=self._beside)

    def act(
        self, name: str, kind: str, accepts: Callable[[list[GoalPlace]], bool],
        taken: Callable[[ActionGoal], None],
    ) -> None:  # fmt: skip
        """Serve it if nav2_msgs is installed; it comes with Nav2, and is in no wheel."""
        try:
            action = getattr(import_module("nav2_msgs.action"), kind)
        except ModuleNotFoundError:
            return

        def asked(request: Any) -> Any:
            return GoalResponse.ACCEPT if accepts(_places(request)) else GoalResponse.REJECT

        self._served.append(ActionServer(
            self.node.node, action, name, execute_callback=lambda handle: action.Result(),
            goal_callback=asked, cancel_callback=lambda handle: CancelResponse.ACCEPT,
            handle_accepted_callback=lambda handle: taken(DdsGoal(action, handle, self.stamp)),
        ))  # fmt: skip

    def octets(self, cells: NDArray[int8]) -> list[int]:
        """`cells` (rows, columns) as a list (rows * columns,), which rclpy takes."""
        values: list[int] = cells.ravel().tolist()
        return values

    def stamp(self) -> Any:
        """By the clock of the node, which may be that of a simulation."""
        return self.node.stamp()

    def close(self) -> None:
        """Leave the graph, and end the thread in which callbacks come."""
        self.node.close()
