"""What the feed of a fleet needs of a ROS graph: kinds of messages, publishers, and the present.

Two graphs have it: `dds_graph` by rclpy, and `zenoh_graph` without ROS, on the keys of rmw_zenoh.
"""

from collections.abc import Callable
from enum import Enum
from types import SimpleNamespace
from typing import Any, Final, NamedTuple, Protocol

from numpy import int8
from numpy.typing import NDArray


class Quality(Enum):
    """What a topic promises its readers, and how many messages wait for a slow one."""

    RELIABLE = "every message, in order: commands, stops, diagnostics; 10 wait"
    COMPLETE = "the same of topics that people record; 1000 wait"
    LATCHED = "and a late reader gets the newest one: states, maps; 1 waits"


# Full names of the messages that the feed publishes and takes.
KINDS: Final = (
    "diagnostic_msgs/msg/DiagnosticArray", "diagnostic_msgs/msg/DiagnosticStatus",
    "diagnostic_msgs/msg/KeyValue", "geometry_msgs/msg/Point", "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/Quaternion", "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/OccupancyGrid", "nav_msgs/msg/Odometry", "nav_msgs/msg/Path", "std_msgs/msg/Bool",
    "std_msgs/msg/ColorRGBA", "std_msgs/msg/String", "tf2_msgs/msg/TFMessage",
    "visualization_msgs/msg/Marker", "visualization_msgs/msg/MarkerArray",
)  # fmt: skip
TAKEN: Final = "std_msgs/msg/Bool"


class Publisher(Protocol):
    """Sends messages of one kind to all that read one topic."""

    def publish(self, message: Any, /) -> None:
        """To all that read it."""


class GoalPlace(NamedTuple):
    """A place that a client asks for."""

    frame: str  # of its coordinates; empty: the client does not say
    x_m: float
    y_m: float


class Ended(Enum):
    """How a goal of an action ended."""

    SUCCEEDED = "the robot is there"
    CANCELLED = "the client took it back, and the fleet has confirmed that"
    ABORTED = "it will not be reached"


class ActionGoal(Protocol):
    """A goal of an action that was accepted and has not ended."""

    places: list[GoalPlace]

    @property
    def cancelled(self) -> bool:
        """Whether the client wants it to be given up."""

    def tell(self, at: GoalPlace, left_m: float, places_left: int) -> None:
        """Feedback: where the robot is, and the straight way to the next place in metres.

        `places_left`: poses still to be reached, this one included."""

    def end(self, how: Ended, why: str) -> None:
        """Give the client its result, once. `why`: for people."""


class Graph(Protocol):
    """A node in a graph of ROS 2."""

    kinds: SimpleNamespace  # classes of messages, by the last part of their names

    def publisher(self, kind: str, topic: str, quality: Quality) -> Publisher:
        """`kind`: the last part of a name. `topic`: of the node's namespace, or with a slash."""

    def hear(self, topic: str, heard: Callable[[Any], None]) -> None:
        """Call back, in another thread, for each std_msgs/Bool on a topic."""

    def serve(self, name: str, answer: Callable[[Any, Any], Any]) -> None:
        """Serve a std_srvs/Trigger, in another thread; a graph without services leaves it out."""

    def act(
        self, name: str, kind: str, accepts: Callable[[list[GoalPlace]], bool],
        taken: Callable[[ActionGoal], None],
    ) -> None:  # fmt: skip
        """Serve an action of nav2_msgs; `accepts` and `taken` are called in another thread. A graph that
        does not know the kind leaves it out."""

    def octets(self, cells: NDArray[int8]) -> Any:
        """`cells` (rows, columns) of a grid as its message takes them: row by row, (rows * columns,)."""

    def stamp(self) -> Any:
        """The present, for the header of a message."""

    def close(self) -> None:
        """Leave the graph: topics of ours end, and nothing more is heard."""
