"""The door to ROS 2 by a file: the bag of a run, message by message, as two readers of others see it."""

from array import array
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from sim.record.mcap_log import read_recording
from sim.record.ros_bag import write_bag
from tools.bench.figure import Figure
from tools.bench.systems import CounterpartAbsent
from tools.run.run_field import run as work

RUN_S, RUN_QUICK_S = 120.0, 20.0
SEED, ROBOTS = 3, 2
AGAINST = "mcap-ros2-support and rosbags"
Row = tuple[str, str, int, Any]  # topic, type, nanoseconds, the message as plain values


def figures(quick: bool) -> Iterator[Figure]:
    """Messages that a reader misses, and that the two do not see alike. Raises CounterpartAbsent."""
    for package in ("rosbags", "mcap_ros2"):
        if find_spec(package) is None:
            raise CounterpartAbsent(f"{package} is not installed: pip install 'headland[dev]'")
    with TemporaryDirectory(prefix="headland-bag-") as name:
        folder = Path(name)
        run_s = RUN_QUICK_S if quick else RUN_S
        work("small", ROBOTS, SEED, folder / "run", False, None, [], None, None, None, run_s)
        counts = write_bag(read_recording(folder / "run" / "run.mcap"), folder / "bag", "mcap")
        one, other = by_rosbags(folder / "bag"), by_mcap_ros2(folder / "bag" / "bag.mcap")
    written = counts.total()
    missed = abs(written - len(one)) + abs(written - len(other))
    unlike = sum(a != b for a, b in zip(one, other, strict=False))
    scope = f"{written} messages of {len(counts)} topics, {run_s:.0f} s of two robots, seed {SEED}"
    yield Figure(
        "ROS 2: messages of a bag that a reader misses",
        missed,
        "",
        "= 0",
        not missed,
        AGAINST,
        scope,
    )
    yield Figure(
        "ROS 2: messages of a bag with another topic, type, time or value", unlike, "", "= 0",
        not unlike, AGAINST, f"all fields of {scope}",
    )  # fmt: skip


def by_rosbags(bag: Path) -> list[Row]:
    """All messages, in an order that does not depend on the reader."""
    from rosbags.highlevel import AnyReader

    with AnyReader([bag]) as opened:
        return _sorted(
            (connection.topic, connection.msgtype, t_ns,
             plain(opened.deserialize(data, connection.msgtype)))
            for connection, t_ns, data in opened.messages()
        )  # fmt: skip


def by_mcap_ros2(file: Path) -> list[Row]:
    """The same, by the package of MCAP."""
    from mcap_ros2.reader import read_ros2_messages

    with file.open("rb") as opened:
        return _sorted(
            (each.channel.topic, each.schema.name, each.log_time_ns, plain(each.ros_msg))
            for each in read_ros2_messages(opened)
        )


def _sorted(rows: Iterator[Row]) -> list[Row]:
    return sorted(rows, key=lambda row: (row[2], row[0], repr(row[3])))


def plain(value: Any) -> Any:
    """A message as dictionaries, lists and numbers, whatever the classes of its reader.

    >>> plain(np.array([1, 2], dtype=np.int8)), plain((0.5, "a"))
    ([1, 2], [0.5, 'a'])
    """
    if isinstance(value, np.ndarray | array):
        return value.tolist()
    if isinstance(value, bytes) and len(value) == 1:
        return value[0]  # a `byte` of ROS is a number to one of them
    if isinstance(value, bytes | list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, str | bool | int | float):
        return value
    names = [f.name for f in fields(value)] if is_dataclass(value) else _names(value)
    # Constants of a kind of message, which one of them lists among its fields, are in capitals.
    told = [name for name in names if not (name.startswith("_") or name.isupper())]
    return {name: plain(getattr(value, name)) for name in told}


def _names(value: Any) -> list[str]:
    return list(getattr(value, "__slots__", None) or vars(value))
