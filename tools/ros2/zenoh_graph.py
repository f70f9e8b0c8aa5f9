"""A graph of ROS 2 without ROS: standard messages by `rosbags`, on the keys of rmw_zenoh.

Nodes that run with RMW_IMPLEMENTATION=rmw_zenoh_cpp read these topics as those of any node: a key is
`DOMAIN/TOPIC/TYPE/HASH`, a message is CDR with the attachment that rmw_zenoh asks for, and liveliness
tokens tell what there is. https://github.com/ros2/rmw_zenoh/blob/jazzy/docs/design.md
"""

import asyncio
import os
import time
from collections.abc import Callable
from hashlib import blake2b
from typing import Any, Final

import zenoh
import zenoh.ext
from numpy import int8
from numpy.typing import NDArray

from protocol.links.zenoh_link import LinkError, configure
from tools.ros2.bag_messages import jazzy, kinds_of
from tools.ros2.graph import KINDS, TAKEN, ActionGoal, GoalPlace, Publisher, Quality

DOMAIN_MAX: Final = 232
TOKENS: Final = "@ros2_lv"
NONE: Final = "%"  # an empty part of a token, and a slash in one
GID_BYTES: Final = 16
OPEN_MS: Final = 5_000  # for a router to answer
DEPTHS: Final = {Quality.RELIABLE: 10, Quality.COMPLETE: 1000, Quality.LATCHED: 1}


def dds_type(name: str) -> str:
    """A type as a key has it.

    >>> dds_type("nav_msgs/msg/Odometry")
    'nav_msgs::msg::dds_::Odometry_'
    """
    package, group, kind = name.split("/")
    return f"{package}::{group}::dds_::{kind}_"


def quality_key(quality: Quality) -> str:
    """A quality as a token has it: what is standard is left out.

    >>> quality_key(Quality.LATCHED), quality_key(Quality.RELIABLE)
    (':1:,1:,:,:,,', '::,10:,:,:,,')
    """
    durability = "1" if quality is Quality.LATCHED else ""
    return f":{durability}:,{DEPTHS[quality]}:,:,:,,"


def attachment(number: int, at_ns: int, gid: bytes) -> bytes:
    """What rmw_zenoh wants with a message: its number, its time since 1970, and its sender."""
    return (
        number.to_bytes(8, "little", signed=True)
        + at_ns.to_bytes(8, "little", signed=True)
        + bytes((len(gid),))
        + gid
    )


def domain_of(domain: int | None) -> int:
    """The number of a ROS graph, ROS_DOMAIN_ID; `domain` None: that of the environment, or 0. Raises
    ValueError."""
    if domain is not None:
        return domain
    told = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    if not (told.isascii() and told.isdecimal() and len(told) <= 3 and int(told) <= DOMAIN_MAX):
        raise ValueError(f"ROS_DOMAIN_ID is {told!r}: a number from 0 to {DOMAIN_MAX}")
    return int(told)


class _ZenohPublisher:
    """Of one topic. It never waits: a reader that is too slow misses messages, as with rmw_zenoh."""

    def __init__(
        self, session: zenoh.Session, key: str, gid: bytes, quality: Quality,
        packed: Callable[[Any], bytes],
    ) -> None:  # fmt: skip
        """`packed`: makes CDR of a message."""
        self._gid, self._packed, self._count = gid, packed, 0
        self._publisher: Any
        options: dict[str, Any] = {
            "congestion_control": zenoh.CongestionControl.DROP, "reliability": zenoh.Reliability.RELIABLE,
        }  # fmt: skip
        if quality is Quality.LATCHED:  # late readers ask for what is kept
            options |= {"cache": zenoh.ext.CacheConfig(1), "publisher_detection": True}
            self._publisher = zenoh.ext.declare_advanced_publisher(session, key, **options)
        else:
            self._publisher = session.declare_publisher(key, **options)

    def publish(self, message: Any, /) -> None:
        """Now."""
        self._count += 1
        about = attachment(self._count, time.time_ns(), self._gid)
        self._publisher.put(self._packed(message), attachment=about)


class ZenohGraph:
    """A node, as rmw_zenoh describes one."""

    def __init__(self, session: zenoh.Session, name: str, namespace: str, domain: int) -> None:
        self._session, self._name, self._domain = session, name, domain
        self._namespace = namespace.strip("/")
        self._store = jazzy()
        self.kinds = kinds_of(self._store, KINDS)
        self._names = {kind.rpartition("/")[2]: kind for kind in KINDS}
        self._entities = 0
        self._kept: list[Any] = [self._token("NN")]  # tokens and subscribers, until they are closed

    @classmethod
    async def open(
        cls, endpoint: str, name: str, namespace: str, domain: int | None
    ) -> "ZenohGraph":
        """Join by a router of Zenoh, as `ros2 run rmw_zenoh_cpp rmw_zenohd` starts one. `domain`: the
        number of the ROS graph; None: that of the environment. Raises LinkError, ValueError."""
        number = domain_of(domain)
        config = configure([endpoint], [], "client")
        config.insert_json5("connect/timeout_ms", str(OPEN_MS))
        config.insert_json5("connect/exit_on_failure", "true")
        config.insert_json5(
            "timestamping/enabled", "true"
        )  # what late readers are told is in order
        try:
            session = await asyncio.to_thread(zenoh.open, config)
        except Exception as problem:  # the binding raises undocumented exceptions
            why = str(problem).splitlines()[0]
            raise LinkError(f"no router of Zenoh at {endpoint}: {why}") from None
        return cls(session, name, namespace, number)

    def _token(self, kind: str, *rest: str) -> Any:
        """Tell all that an entity of ours is there: NN a node, MP a publisher, MS a subscriber."""
        number = str(self._entities)
        self._entities += 1
        space = NONE + self._namespace.replace("/", NONE)
        key = "/".join((
            TOKENS, str(self._domain), str(self._session.info.zid()), "0", number, kind, NONE, space,
            self._name, *rest,
        ))  # fmt: skip
        self._newest = key
        return self._session.liveliness().declare_token(key)

    def _key(self, kind: str, topic: str) -> tuple[str, tuple[str, str, str]]:
        """The key of a topic, and topic, type and hash as a token has them."""
        whole = (
            topic.strip("/") if topic.startswith("/") else f"{self._namespace}/{topic}".strip("/")
        )
        name, check = dds_type(kind), self._store.hash_rihs01(kind)
        told = (NONE + whole.replace("/", NONE), name, check)
        return f"{self._domain}/{whole}/{name}/{check}", told

    def publisher(self, kind: str, topic: str, quality: Quality) -> Publisher:
        """On the key of the topic, with a token that tells nodes that it is there."""
        name = self._names[kind]
        key, told = self._key(name, topic)
        self._kept.append(self._token("MP", *told, quality_key(quality)))
        gid = blake2b(self._newest.encode(), digest_size=GID_BYTES).digest()

        def packed(message: Any) -> bytes:
            return bytes(self._store.serialize_cdr(message, name))

        return _ZenohPublisher(self._session, key, gid, quality, packed)

    def hear(self, topic: str, heard: Callable[[Any], None]) -> None:
        """Call back in a thread of Zenoh. What is no std_msgs/Bool is no message."""
        key, told = self._key(TAKEN, topic)

        def arrived(sample: zenoh.Sample) -> None:
            try:
                message = self._store.deserialize_cdr(sample.payload.to_bytes(), TAKEN)
            except Exception:  # rosbags says what it likes of bytes that anybody may send
                return
            heard(message)

        self._kept.append(self._session.declare_subscriber(key, arrived))
        self._kept.append(self._token("MS", *told, quality_key(Quality.RELIABLE)))

    def serve(self, name: str, answer: Callable[[Any, Any], Any]) -> None:
        """Left out: a stop has its topic, and a release `headland release`."""

    def act(
        self, name: str, kind: str, accepts: Callable[[list[GoalPlace]], bool],
        taken: Callable[[ActionGoal], None],
    ) -> None:  # fmt: skip
        """Left out: `headland order` does the same."""

    def octets(self, cells: NDArray[int8]) -> NDArray[int8]:
        """`cells` (rows, columns) as an array (rows * columns,), which rosbags takes."""
        return cells.ravel()

    def stamp(self) -> Any:
        """The time of day, as nodes without a simulated clock have it."""
        seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
        return self._store.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)

    def close(self) -> None:
        """Leave: tokens end with the session."""
        self._session.close()
