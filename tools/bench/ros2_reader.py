"""Places of robots as a bus says them, and as an rclpy node that subscribes to their odometry is told."""

import threading
from typing import Any, Final

import can

from protocol.frames.codec import decode
from protocol.frames.fleet_frames import Member, Pose
from protocol.frames.frame import Frame
from protocol.links.bus import open_bus

KEPT: Final = 1000  # messages that wait for this reader, as many as the publisher keeps
SPIN_S: Final = 0.1
Place = tuple[float, float]  # x and y, metres, to the millimetre


class PlacesOfBus:
    """Listens to a bus by python-can in a thread of its own."""

    def __init__(self, group: str) -> None:
        """`group`: of udp_multicast."""
        self.places: dict[int, list[Place]] = {}  # by slot
        self._slots: dict[int, int] = {}  # source address -> slot
        self._bus = open_bus("udp_multicast", group).bus
        self._notifier = can.Notifier(self._bus, [self._hear], timeout=SPIN_S)

    def _hear(self, message: can.Message) -> None:
        source, told = decode(Frame(message.arbitration_id, bytes(message.data)))
        if isinstance(told, Member):
            self._slots[source] = told.slot
        elif isinstance(told, Pose) and told.placed and source in self._slots:
            place = round(told.x_m, 3), round(told.y_m, 3)
            self.places.setdefault(self._slots[source], []).append(place)

    def close(self) -> None:
        """Hear no more."""
        self._notifier.stop()
        self._bus.shutdown()


class PlacesOfTopics:
    """A node with a context of its own; nothing of ours is in it."""

    def __init__(self, domain: int, robots: int) -> None:
        import rclpy
        from nav_msgs.msg import Odometry
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        self.places: dict[int, list[Place]] = {slot: [] for slot in range(robots)}
        self._context: Any = Context()
        rclpy.init(args=[], context=self._context, domain_id=domain)
        self._node: Any = Node("reader", context=self._context)
        for slot in range(robots):
            topic = f"/headland/robot_{slot}/odom"
            self._node.create_subscription(Odometry, topic, self._taker(slot), KEPT)
        self._executor: Any = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._closing = False
        self._thread = threading.Thread(target=self._spin, daemon=True, name="reader")
        self._thread.start()

    def _taker(self, slot: int) -> Any:
        def take(message: Any) -> None:
            at = message.pose.pose.position
            self.places[slot].append((round(at.x, 3), round(at.y, 3)))

        return take

    def _spin(self) -> None:
        while not self._closing:
            self._executor.spin_once(timeout_sec=SPIN_S)

    def close(self) -> None:
        """End the thread, then leave the graph: rclpy aborts the process in the other order."""
        from rclpy.utilities import try_shutdown

        self._closing = True
        self._thread.join()
        self._executor.shutdown()
        self._node.destroy_node()
        try_shutdown(context=self._context)
