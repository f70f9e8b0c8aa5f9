"""A ROS 2 node of ours in a thread of its own: rclpy waits there, and this process goes on.

Callbacks run in that thread, one at a time. With more than one thread those of a reentrant group run
beside the others. A caller of another thread reads one attribute that holds a
whole value, or passes them on with `loop.call_soon_threadsafe`.
"""

import threading
from contextlib import suppress
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import (
    ExternalShutdownException,
    MultiThreadedExecutor,
    SingleThreadedExecutor,
)
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.utilities import try_shutdown

SPIN_S = 0.1  # the longest wait for a callback, and so for `close`
KEPT = 10  # messages that wait for a slow reader; an older command is useless
RECORDED = 1000  # the same of topics that people record: ten seconds of five robots
# Every message arrives, in order: commands, stops, places.
RELIABLE = QoSProfile(depth=KEPT, reliability=QoSReliabilityPolicy.RELIABLE)
COMPLETE = QoSProfile(depth=RECORDED, reliability=QoSReliabilityPolicy.RELIABLE)
# As reliable, and a late reader gets the newest one: states, maps.
LATCHED = QoSProfile(
    depth=1, reliability=QoSReliabilityPolicy.RELIABLE,
    durability=QoSDurabilityPolicy.TRANSIENT_LOCAL,
)  # fmt: skip
# The newest counts, and one that was lost is not sent again; readers of this kind hear both kinds.
SENSED = QoSProfile(depth=KEPT, reliability=QoSReliabilityPolicy.BEST_EFFORT)


class Ros2Node:
    """A node with its own context, so that several of them are in one process."""

    def __init__(
        self, name: str, namespace: str = "", domain: int | None = None, threads: int = 1
    ) -> None:
        """`domain`: ROS_DOMAIN_ID; None: that of the environment. Raises OSError."""
        self.context = Context()
        try:
            rclpy.init(args=[], context=self.context, domain_id=domain)
            self.node = Node(name, context=self.context, namespace=namespace)
        except Exception as problem:  # rclpy raises what its C library reports, of several classes
            raise OSError(f"ROS 2: {problem}") from None
        self._executor = (
            SingleThreadedExecutor(context=self.context) if threads == 1
            else MultiThreadedExecutor(threads, context=self.context)
        )  # fmt: skip
        self._executor.add_node(self.node)
        self._closing = False
        self._thread = threading.Thread(target=self._spin, daemon=True, name=f"ros2 {name}")
        self._thread.start()

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):
            while not self._closing:
                self._executor.spin_once(timeout_sec=SPIN_S)

    def now_ns(self) -> int:
        """The time that stamps are compared with."""
        return int(self.node.get_clock().now().nanoseconds)

    def stamp(self) -> Any:
        """The present, for the header of a message."""
        return self.node.get_clock().now().to_msg()

    def close(self) -> None:
        """End the thread, then leave the graph: rclpy aborts the process in the other order."""
        self._closing = True
        self._executor.wake()
        self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        try_shutdown(context=self.context)
