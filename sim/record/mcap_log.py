"""MCAP: one file with all of a run, for Foxglove, PlotJuggler and our own replay.

    /can          can_msgs/msg/Frame (ros2msg, CDR), every frame of the bus
    /robots/N     what robot N means to do (JSON, `sim.record.robot_intent`): its numbers can be plotted
    /things       what stands in the world from then on (JSON)
    /log          foxglove.Log (JSON): what the robots decided, and why
    scene.json    attachment: what does not move, as our map draws it

and, from the listener to the fleet (`tools/livemap/recorded_topics.py`), the topics that a live viewer
has, too (`sim.record.topics`): /tf, /scene, /paths, /grid, /fleet, /robots/N/fix, and /can/KIND for each
kind of frame.

The time is that of the run, which begins at 0, or the time of day of a launch (Unix epoch). All
topics use the same clock.
"""

import json
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from json import JSONEncoder
from pathlib import Path
from struct import Struct
from typing import Any

from agent.interface.effects import Effect, Trace
from agent.runtime.files.given_file import check_regular
from protocol.frames.frame import Frame
from sim.files.log_parts import parts_of
from sim.record.foxglove import log_line
from sim.record.mcap_schema import (
    intent_message,
    intent_of_message,
    things_message,
    things_of_message,
)
from sim.record.recording import Recording
from sim.record.scene import FILE, Scene, drawable
from sim.record.topics import (
    KINDS,
    LOG_TOPIC,
    ROBOT_TOPICS,
    THINGS_TOPIC,
    TOPICS,
    schema_of,
)

# Compressed together: takes about a millisecond; its index entry is a kilobyte.
CHUNK_BYTES = 256 * 1024
MAGIC = b"\x89MCAP0\r\n"  # a file begins with it; a file that was closed also ends with it
SAID_MAX = 120  # characters quoted from a reader's message on a damaged file
CAN_TOPIC = "/can"
MCAP = "run.mcap"  # in the folder of a run
CAN_FRAME = """std_msgs/Header header
uint32 id
bool is_rtr
bool is_extended
bool is_error
uint8 dlc
uint8[8] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
CDR = Struct("<4siII5s3xI???B8s")  # encapsulation; stamp; frame_id with its length; the rest
LITTLE_ENDIAN, CHANNEL = b"\0\1\0\0", b"can0\0"
encode_json = JSONEncoder(separators=(",", ":")).encode


class McapMissing(Exception):
    """One line for the user."""


def _import() -> None:
    try:
        import mcap  # noqa: F401
    except ImportError:
        raise McapMissing(
            "MCAP needs the operator extra: pip install 'headland[operator]'"
        ) from None


class McapLog:
    """A `LogWriter` that also accepts intents, things and traces."""

    def __init__(self, path: Path, scene: Scene | None = None, begin_at_us: int = 0) -> None:
        """`begin_at_us`: time of the outline. Raises McapMissing; OSError if it cannot be written."""
        _import()
        from mcap.writer import Writer

        self._file = path.open("wb")
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES)
        self._writer.start(profile="", library="headland")
        can = self._writer.register_schema("can_msgs/msg/Frame", "ros2msg", CAN_FRAME.encode())
        self._can = self._writer.register_channel(CAN_TOPIC, "cdr", can)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        for topic in (*TOPICS, *KINDS.values()):  # a viewer finds them, whatever is said
            self._channel(topic)
        if scene is not None:
            data = json.dumps(scene).encode()
            begin_at_ns = begin_at_us * 1000
            self._writer.add_attachment(begin_at_ns, begin_at_ns, FILE, "application/json", data)

    @property
    def size(self) -> int:
        """Bytes written, without the chunk that is being filled."""
        return self._file.tell()

    def write(self, t_us: int, frame: Frame) -> None:
        """Append a frame to the topic `/can`."""
        seconds, micros = divmod(t_us, 1_000_000)
        data = CDR.pack(
            LITTLE_ENDIAN, seconds, micros * 1000, len(CHANNEL), CHANNEL, frame.identifier, False,
            True, False, len(frame.data), frame.data,
        )  # fmt: skip
        self._writer.add_message(self._can, t_us * 1000, data, t_us * 1000)

    def tell(self, t_us: int, intent: dict[str, Any]) -> None:
        """Append an intent to the topic of its robot."""
        text = encode_json(intent_message(intent))
        self.add(f"{ROBOT_TOPICS}{int(intent['slot'])}", t_us, text)

    def place(self, t_us: int, rows: Iterable[Iterable[float]]) -> None:
        """Append the obstacles that stand from `t_us` on: rows of `sim.world.walls`, metres."""
        self.add(THINGS_TOPIC, t_us, encode_json(things_message([list(row) for row in rows])))

    def effect(self, slot: int, t_us: int, effect: Effect) -> None:
        """Write only the effects that are meant for people."""
        if isinstance(effect, Trace):
            self.add(LOG_TOPIC, t_us, encode_json(log_line(t_us, slot, effect)))

    def add(self, topic: str, t_us: int, text: str) -> None:
        """Append a message of one of the topics of `sim.record.topics`, as JSON."""
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channel(topic)
        self._writer.add_message(channel, t_us * 1000, text.encode(), t_us * 1000)

    def _channel(self, topic: str) -> int:
        """A new channel; ten robots share one schema."""
        name = schema_of(topic)["title"]
        if name not in self._schemas:
            data = _schema_text(topic).encode()
            self._schemas[name] = self._writer.register_schema(name, "jsonschema", data)
        number = self._schemas[name]
        self._channels[topic] = self._writer.register_channel(topic, "json", number)
        return self._channels[topic]

    def close(self) -> None:
        """Write the index and close the file. Without it a reader has to search the whole file.

        A log in parts closes its full part, and once more where no next part could be begun."""
        if self._file.closed:
            return
        self._writer.finish()
        self._file.close()


@cache
def _schema_text(topic: str) -> str:
    return encode_json(schema_of(topic))


def read_frames(path: Path) -> Iterator[tuple[int, Frame]]:
    """(microseconds, frame), in order. ValueError if the file is no MCAP."""
    for t_us, _, data in _messages(path, CAN_TOPIC.__eq__):
        if len(data) == CDR.size:
            *_, identifier, _, _, _, length, payload = CDR.unpack(data)
            yield t_us, Frame(identifier & 0x1FFFFFFF, payload[: min(length, 8)])


def read_recording(path: Path, notes: bool = True) -> Recording:
    """The whole recording, all parts; its intents and things only with `notes`. McapMissing; ValueError
    if the file is no MCAP."""
    recording = Recording(_scene(path))
    for part in parts_of(path):
        for t_us, frame in read_frames(part):
            recording.write(t_us, frame)
    if notes:
        add_notes(recording, path)
    recording.close()
    return recording


def add_notes(recording: Recording, path: Path) -> None:
    """Add what CAN logs do not contain: intents and things, of all parts."""
    for part in parts_of(path):
        _add_notes(recording, part)


def _add_notes(recording: Recording, path: Path) -> None:
    for t_us, topic, data in _messages(path, _is_note):
        try:
            if topic == THINGS_TOPIC:
                recording.place(t_us, things_of_message(json.loads(data)))
            else:
                recording.tell(t_us, intent_of_message(dict(json.loads(data))))
        except (KeyError, TypeError, ValueError, OverflowError, RecursionError):
            raise ValueError(f"{topic} is damaged") from None


def _is_note(topic: str) -> bool:
    """What a `Recording` keeps beside frames."""
    slot = topic.removeprefix(ROBOT_TOPICS)  # others may have more below it, as our places on earth
    return (slot != topic and slot.isdecimal()) or topic == THINGS_TOPIC


def _scene(path: Path) -> Scene | None:
    from mcap.reader import make_reader

    with path.open("rb") as file:
        try:
            for attachment in make_reader(file).iter_attachments():
                if attachment.name == FILE:
                    return drawable(json.loads(attachment.data))
        except Exception:  # a killed run has no index, and a damaged one may have any content
            return None  # its frames can be read without the scene
    return None


def _messages(path: Path, wanted: Callable[[str], bool]) -> Iterator[tuple[int, str, bytes]]:
    """Messages of the topics that are wanted, in the order of writing; a truncated end is skipped.
    ValueError if a part in the middle is damaged, OSError."""
    _import()
    from sim.record.mcap_chunks import messages_of

    check_regular(path)
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(0, size - len(MAGIC)))
        whole = file.read() == MAGIC
        file.seek(0)
        if MAGIC.startswith(file.read(len(MAGIC) + 1)):
            return  # of what was killed before its first bytes were on the disk
        file.seek(0)
        messages = messages_of(file, wanted)
        while True:
            try:
                written_at_ns, topic, data = next(messages)
            except StopIteration:
                return
            # The reader and its decompressors raise undocumented exceptions.
            except Exception as problem:
                if not whole and size > len(MAGIC) and file.tell() == size:
                    return
                said = " ".join(str(problem).split()) or type(problem).__name__
                raise ValueError(f"not an MCAP file, or damaged: {said[:SAID_MAX]}") from None
            yield written_at_ns // 1000, topic, data
