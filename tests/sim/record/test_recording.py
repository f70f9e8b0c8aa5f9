"""Recordings: the same frames in every format, the same run with and without somebody watching."""

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Member
from protocol.frames.frame import Frame
from sim.files.candump import read_candump
from sim.record import recording as recordings
from sim.record.mcap_log import CDR, McapLog, read_frames, read_recording
from sim.record.recording import FramesDigest, Recording
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.livemap.command import recorded
from tools.livemap.page_updates import PageUpdates
from tools.livemap.playback import Index, Player
from tools.run.run_recorder import RunRecorder

SECONDS = 30.0
needs_mcap = pytest.mark.skipif(
    find_spec("mcap") is None, reason="the extra `operator` is not installed"
)


def setting() -> FieldSetup:
    scenario = load("small").changed(3, 7)
    run = scenario.run.model_copy(update={"time_limit_s": SECONDS})
    return FieldSetup(scenario.model_copy(update={"run": run}))


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, str]:
    """Folder, trace hash and hash of the frames of a short run."""
    out = tmp_path_factory.mktemp("kept")
    keeping = RunRecorder(setting(), out)
    outcome = FieldRun(setting(), out, logs=[out / "more.blf"], attach=keeping).run()
    keeping.close()
    return out, outcome.trace_hash, keeping.log_hash


@pytest.mark.slow
def test_a_watched_run_is_the_same_run(kept: tuple[Path, str, str]) -> None:
    assert FieldRun(setting()).run().trace_hash == kept[1]


@pytest.mark.parametrize(
    "name", ["can.log", pytest.param("run.mcap", marks=needs_mcap), "more.blf", "."]
)
def test_one_hash_in_every_format(kept: tuple[Path, str, str], name: str) -> None:
    out, _, log_hash = kept
    recording = recorded(out / name, None)
    assert recording.digest.hex == log_hash
    assert recording.count == sum(1 for _ in read_candump(out / "can.log"))
    assert recording.scene is not None and len(recording.scene["sections"]) == 14


@needs_mcap
def test_the_mcap_holds_what_foxglove_reads(kept: tuple[Path, str, str]) -> None:
    from mcap.reader import make_reader

    out = kept[0]
    with (out / "run.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        topics = {c.topic: summary.schemas[c.schema_id] for c in summary.channels.values()}
        counts = {
            summary.channels[k].topic: n
            for k, n in summary.statistics.channel_message_counts.items()
        }
        assert topics["/can"].name == "can_msgs/msg/Frame" and topics["/can"].encoding == "ros2msg"
        assert topics["/scene"].name == "foxglove.SceneUpdate"
        assert topics["/log"].name == "foxglove.Log"
        assert {"/robots/0", "/robots/1", "/robots/2"} <= topics.keys()
        assert counts["/robots/0"] == pytest.approx(SECONDS * 5, abs=10)
        _, _, drawn = next(reader.iter_messages(topics="/scene"))
        names = {entity["id"] for entity in json.loads(drawn.data)["entities"]}
        assert {"outline 0", "outline 1", *(f"S{k}" for k in range(14))} <= names
    ours = list(read_candump(out / "can.log"))
    assert list(read_frames(out / "run.mcap")) == ours


@needs_mcap
def test_the_frame_is_laid_out_as_ros_lays_it_out(tmp_path: Path) -> None:
    """By hand, byte by byte: CDR aligns each value to its size, counted from after the four bytes."""
    log = McapLog(tmp_path / "one.mcap")
    log.write(1_500_000, Frame(0x0CFF1080, b"\x01\x02\x03"))
    log.close()
    assert CDR.size == 40
    from mcap.reader import make_reader

    with (tmp_path / "one.mcap").open("rb") as file:
        ((_, _, message),) = list(make_reader(file).iter_messages())
    assert message.data.hex(" ", 4) == (
        "00010000 01000000 0065cd1d 05000000 63616e30 00000000 8010ff0c 00010003 01020300 00000000"
    )
    assert message.log_time == 1_500_000_000


@needs_mcap
def test_a_recording_that_was_cut_off_is_read_as_far_as_it_goes(
    kept: tuple[Path, str, str], tmp_path: Path
) -> None:
    whole = (kept[0] / "run.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    recording = read_recording(tmp_path / "cut.mcap")
    ours = list(read_candump(kept[0] / "can.log"))
    assert 0 < recording.count < len(ours)
    assert [recording[k] for k in range(recording.count)] == ours[: recording.count]


def test_a_full_recording_forgets_its_oldest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recordings, "FRAMES_MAX", 100)
    monkeypatch.setattr(recordings, "DROP", 25)
    recording = Recording()
    for k in range(1000):
        recording.write(k * 1000, Frame(0x18FF1080 + k % 7, bytes([k % 256] * (k % 9))))
        recording.tell(k * 1000, {"slot": 0})
    assert recording.count == 1000 and 75 <= recording.count - recording.first <= 100
    for k in range(recording.first, recording.count):
        t_us, frame = recording[k]
        assert (t_us, frame) == (k * 1000, Frame(0x18FF1080 + k % 7, bytes([k % 256] * (k % 9))))
    assert recording.intents[0][0] >= recording.begin_at_us == recording.first * 1000


@given(st.lists(st.tuples(st.integers(0, (1 << 29) - 1), st.binary(max_size=8)), max_size=20))
def test_the_hash_tells_frames_apart(rows: list[tuple[int, bytes]]) -> None:
    def hash_of(frames: list[tuple[int, bytes]]) -> str:
        digest = FramesDigest()
        for identifier, data in frames:
            digest.write(0, Frame(identifier, data))
        return digest.hex

    assert hash_of(rows) == hash_of(list(rows))
    if rows:
        assert hash_of(rows[:-1]) != hash_of(rows)
        identifier, data = rows[0]
        assert hash_of([(identifier ^ 1, data), *rows[1:]]) != hash_of(rows)


def test_python_can_reads_our_log(kept: tuple[Path, str, str]) -> None:
    assert sum(1 for _ in can.LogReader(kept[0] / "can.log")) == recorded(kept[0], None).count


def _foxglove_fields(schema: dict[str, Any], path: str) -> set[str]:
    """Paths of messages, by the rules of Foxglove's reader of JSON schemas.

    It takes objects with properties, plain values, numbered choices, and arrays of plain values or of
    objects. It refuses a topic with anything else.
    """
    plain = ("boolean", "string", "number", "integer")
    assert schema["type"] == "object", path
    properties = schema["properties"]
    assert isinstance(properties, dict) and properties, path
    found = set()
    for name, field in properties.items():
        at, kind = f"{path}.{name}", field.get("type")
        if "oneOf" in field:
            assert all(isinstance(each["const"], int) for each in field["oneOf"]), at
        elif kind == "array":
            at, field = at + "[]", field["items"]
            kind = field["type"]
        assert "oneOf" in field or kind in (*plain, "object"), at
        found |= _foxglove_fields(field, at) if kind == "object" else {at}
    return found


def test_a20_the_schemas_of_the_mcap_say_every_message_path(kept: tuple[Path, str, str]) -> None:
    reading = pytest.importorskip("mcap.reader", reason="the extra `operator` is not installed")
    paths, schemas = {}, {}
    with (kept[0] / "run.mcap").open("rb") as file:
        summary = reading.make_reader(file).get_summary()
        for channel in summary.channels.values():
            schema = summary.schemas[channel.schema_id]
            if schema.encoding == "jsonschema":
                schemas[channel.topic] = json.loads(schema.data)
                paths[channel.topic] = _foxglove_fields(schemas[channel.topic], channel.topic)
    assert {"/scene", "/log", "/robots/0", "/things"} - paths.keys() <= {"/things"}
    assert {
        "/robots/0.vx",
        "/robots/0.path[].x",
        "/robots/0.wanted.y",
        "/robots/0.holds[]",
    } <= paths["/robots/0"]
    assert {"/log.level", "/log.timestamp.nsec"} <= paths["/log"]
    assert "/scene.entities[].lines[].points[].z" in paths["/scene"]
    assert schemas["/scene"]["title"] == "foxglove.SceneUpdate"


def test_a20_every_message_obeys_its_schema(kept: tuple[Path, str, str], tmp_path: Path) -> None:
    reading = pytest.importorskip("mcap.reader", reason="the extra `operator` is not installed")
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
    log = McapLog(tmp_path / "things.mcap")
    log.place(1_000, [[1.0, 2.0, 3.0, 0.5, 0.5, 1.0, 0.0]])
    log.close()
    judged: dict[str, int] = {}
    for path in (kept[0] / "run.mcap", tmp_path / "things.mcap"):
        judges = {}
        with path.open("rb") as file:
            for schema, channel, message in reading.make_reader(file).iter_messages():
                if schema.encoding != "jsonschema":
                    continue
                if schema.id not in judges:
                    kind = jsonschema.Draft202012Validator
                    judges[schema.id] = kind(_judged(json.loads(schema.data)))
                judges[schema.id].validate(json.loads(message.data))
                judged[channel.topic] = judged.get(channel.topic, 0) + 1
    assert judged.keys() >= {"/scene", "/log", "/robots/0", "/things"}
    assert read_recording(tmp_path / "things.mcap").things == [
        (1_000, {"rows": [[1.0, 2.0, 3.0, 0.5, 0.5, 1.0, 0.0]]})
    ]


def _judged(schema: dict[str, Any]) -> dict[str, Any]:
    """Of the fleet the schema names what can be plotted; of all else, everything."""
    return schema if schema["title"] == "headland.Fleet" else _strict(schema)


def _strict(schema: dict[str, Any]) -> dict[str, Any]:
    """Nothing may be missing, and nothing more may be there."""
    inner = {
        key: _strict(value) if isinstance(value, dict) else value for key, value in schema.items()
    }
    if schema.get("type") == "object" and isinstance(schema.get("properties"), dict):
        inner |= {"additionalProperties": False, "required": sorted(schema["properties"])}
    return inner


@needs_mcap
def test_a20_a_recording_gives_back_what_the_robots_told(kept: tuple[Path, str, str]) -> None:
    recording = read_recording(kept[0] / "run.mcap")
    _, intent = recording.intents[-1]
    assert len(intent["wanted"]) == 2
    assert all(len(point) == 2 for point in intent["path"]) and intent["path"]


INTENT = {
    "slot": 3, "x": 1.0, "y": 2.0, "heading": 0.0, "vx": 0.0, "vy": 0.0, "wanted": [0.0, 1.0],
    "path": [[1.0, 2.0]], "avoids": [], "strange": [], "holds": [], "tool": False,
}  # fmt: skip


def told(path: Path, message: str, topic: str = "/robots/3") -> Path:
    """A recording of one message."""
    writing = pytest.importorskip("mcap.writer", reason="the extra `operator` is not installed")
    with path.open("wb") as file:
        writer = writing.Writer(file)
        writer.start()
        number = writer.register_schema("headland.Intent", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel(topic, "json", number)
        writer.add_message(channel, 0, message.encode(), 0)
        writer.finish()
    return path


def test_a20_files_of_before_are_read_as_well(tmp_path: Path) -> None:
    """They have pairs, and say nothing of the members that a robot hears."""
    recording = read_recording(told(tmp_path / "old.mcap", json.dumps(INTENT)))
    assert recording.intents == [(0, INTENT)]
    recording.write(0, encode(Member(3, 1, 0), 0x80))
    player = Player(Index(recording), True, 1.0)
    player.advance(0.0, 1.0)
    (robot,) = PageUpdates(player).tell()["robots"]
    assert robot["s"] == 3 and robot["path"] == [[1.0, 2.0]] and robot["hears"] is None


@pytest.mark.parametrize(
    "change",
    [
        {"vx": float("nan")}, {"x": float("inf")}, {"x": 10**400}, {"path": [[1.0, float("nan")]]},
        {"slot": "x"}, {"slot": 1.5}, {"slot": -1}, {"holds": 7}, {"hears": [None]}, {"wanted": 3},
    ],
    ids="-".join,
)  # fmt: skip
def test_an_intent_that_is_none_is_told_when_the_recording_is_read(
    tmp_path: Path, change: dict[str, Any]
) -> None:
    """The map served a page that never got a picture, and printed tracebacks."""
    with pytest.raises(ValueError, match="/robots/3 is damaged"):
        read_recording(told(tmp_path / "bad.mcap", json.dumps({**INTENT, **change})))


def test_what_others_tell_below_a_robots_topic_is_no_intent(tmp_path: Path) -> None:
    for topic in ("/robots/3/odometry", "/robots/tractor", "/robots/"):
        assert read_recording(told(tmp_path / "other.mcap", '{"a": 1}', topic)).intents == []


def test_things_that_are_no_numbers_are_told_when_the_recording_is_read(tmp_path: Path) -> None:
    row = '{"rows": [[1, 2.0, NaN, 0.5, 0.5, 1.0, 0.0]]}'
    with pytest.raises(ValueError, match="/things is damaged"):
        read_recording(told(tmp_path / "things.mcap", row, "/things"))
