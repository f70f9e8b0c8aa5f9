"""The graph of a ROS 2 installation, by rclpy."""

from collections.abc import Callable
from importlib import import_module
from types import SimpleNamespace
from typing import Any

from numpy import int8
from numpy.typing import NDArray
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from agent.runtime.ros2_node import COMPLETE, LATCHED, RELIABLE, Ros2Node
from tools.ros2.graph import KINDS, Publisher, Quality

PROFILES = {
    Quality.RELIABLE: RELIABLE, Quality.COMPLETE: COMPLETE, Quality.LATCHED: LATCHED,
}  # fmt: skip


class DdsGraph:
    """A node of rclpy, whose callbacks come in its thread."""

    def __init__(self, node: Ros2Node) -> None:
        self.node, self.kinds = node, SimpleNamespace()
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
        """Answer in the thread of the node."""
        self.node.node.create_service(Trigger, name, answer)

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
