"""A recording and a live fleet show the same: one layout, one table of topics, the same messages.

The recording is read by the package `mcap`, and the schemas of the live door by `protobuf`.
"""

import asyncio
import json
import re
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap", reason="the extra `operator` is not installed")
pytest.importorskip("foxglove", reason="the extra `foxglove` is not installed")
pytest.importorskip("google.protobuf", reason="protobuf is not installed")

from google.protobuf import descriptor, descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader

from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Member, Pose
from sim.files.log_parts import Limit, parts_of
from sim.record.mcap_log import read_frames
from sim.record.topics import KINDS, TOPICS, fix_topic, schema_of
from sim.runs.field_run import FieldRun
from sim.scenarios.exploration_scenario import ExplorationSetup, load_arena
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.inspect.inspector import Inspector
from tools.livemap.foxglove_live import FoxgloveFeed
from tools.livemap.foxglove_messages import channel_of, is_typed, maker_of
from tools.livemap.recorded_topics import RecordedTopics
from tools.run.run_recorder import RunRecorder

LAYOUT = Path(__file__).parents[3] / "examples" / "foxglove" / "headland.json"
ROBOTS, SECONDS = 3, 20.0
TYPED = [*(topic for topic, schema in TOPICS.items() if is_typed(schema)), fix_topic(0)]
PLAIN = {
    "number": (descriptor.FieldDescriptor.TYPE_DOUBLE, descriptor.FieldDescriptor.TYPE_FLOAT),
    "integer": (
        descriptor.FieldDescriptor.TYPE_FIXED32, descriptor.FieldDescriptor.TYPE_UINT32,
        descriptor.FieldDescriptor.TYPE_INT32,
    ),
    "boolean": (descriptor.FieldDescriptor.TYPE_BOOL,),
}  # fmt: skip


def setting(robots: int = ROBOTS, seconds: float = SECONDS) -> FieldSetup:
    scenario = load("small").changed(robots, 7)
    run = scenario.run.model_copy(update={"time_limit_s": seconds})
    return FieldSetup(scenario.model_copy(update={"run": run}))


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of a short run."""
    out = tmp_path_factory.mktemp("kept")
    keeping = RunRecorder(setting(), out)
    FieldRun(setting(), out, attach=keeping).run()
    keeping.close()
    return out / "run.mcap"


def messages_in(path: Path) -> dict[str, list[tuple[int, dict[str, Any]]]]:
    """Nanoseconds and values, by topic."""
    found = defaultdict(list)
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            if channel.message_encoding == "json":
                found[channel.topic].append((message.log_time, json.loads(message.data)))
    return found


def schemas_in(path: Path) -> dict[str, str]:
    """The name of the schema of each topic; empty: it has none."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    schemas = summary.schemas
    return {c.topic: schemas[c.schema_id].name for c in summary.channels.values()}


def topics_of_layout() -> set[str]:
    """All that its panels name."""
    panels = json.loads(LAYOUT.read_text())["configById"].values()
    named = {topic for panel in panels for topic in panel.get("topics", ())}
    named |= {panel["topicPath"] for panel in panels if "topicPath" in panel}
    paths = [each["value"] for panel in panels for each in panel.get("paths", ())]
    return named | {re.split(r"[.{]", path)[0] for path in paths}


def live_schemas(scene: dict[str, Any] | None = None) -> dict[str, str]:
    """What the live door offers before anything is heard, and a fix."""

    async def story() -> dict[str, str]:
        feed = FoxgloveFeed(scene, 0, 0.0)
        try:
            told = {t: channel.schema_name() or "" for t, channel in feed._channels.items()}
            return told | {fix_topic(0): feed._fixes.of(0, 0.0).schema_name() or ""}
        finally:
            feed.close()

    return asyncio.run(story())


def proto_of(topic: str) -> Any:
    """The description that the live door sends to its viewers."""
    schema = schema_of(topic)
    told = channel_of(schema)(f"{topic}/described").schema()
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(told.data).file:
        pool.Add(file)
    return pool.FindMessageTypeByName(told.name)


def test_all_that_the_layout_names_is_in_a_recording_as_it_is_live(kept: Path) -> None:
    recorded, live = schemas_in(kept), live_schemas()
    wanted = topics_of_layout()
    assert wanted >= {"/scene", "/paths", "/grid", "/fleet", "/can/POSE", "/can/EMERGENCY_STOP"}
    assert {topic: recorded.get(topic) for topic in wanted} == {t: live[t] for t in wanted}
    # All else that is live, too: the log, transforms, fixes, each kind of frame.
    assert {topic: recorded.get(topic) for topic in live} == live
    assert len(KINDS) > 40 and set(KINDS.values()) <= live.keys()


def test_its_panels_are_not_empty(kept: Path) -> None:
    found = messages_in(kept)
    for topic in ("/scene", "/paths", "/fleet", "/log", "/tf", "/can/POSE", "/can/HEARTBEAT"):
        assert found[topic], topic
    assert all(len(found[fix_topic(slot)]) > SECONDS / 2 for slot in range(ROBOTS))
    moved = [each for _, told in found["/tf"] for each in told["transforms"]]
    frames = {each["child_frame_id"] for each in moved}
    assert frames == {f"robot_{slot}" for slot in range(ROBOTS)}
    at_s = [at_ns / 1e9 for at_ns, told in found["/tf"] if len(told["transforms"]) == ROBOTS]
    assert len(at_s) > 4.5 * (SECONDS - 3), "five a second, from the start on"
    assert len(found["/can/POSE"]) > 4.5 * ROBOTS * (SECONDS - 3)
    assert {each["robot"] for _, each in found["/can/POSE"]} >= set(range(ROBOTS))
    _, latest = found["/fleet"][-1]
    assert [robot["state"] for robot in latest["robots"]] == ["WORKING"] * ROBOTS


def test_a_body_is_where_its_transform_says(kept: Path) -> None:
    """Against what the robot tells of itself at that time, beside the bus."""
    found = messages_in(kept)
    for slot in range(ROBOTS):
        told = {at_ns: (i["x"], i["y"]) for at_ns, i in found[f"/robots/{slot}"]}
        away = [
            abs(each["translation"]["x"] - told[at_ns][0])
            + abs(each["translation"]["y"] - told[at_ns][1])
            for at_ns, message in found["/tf"]
            for each in message["transforms"]
            if each["child_frame_id"] == f"robot_{slot}" and at_ns in told
        ]
        assert max(away, default=0.0) < 0.3


def test_who_jumps_to_any_time_sees_all_of_the_scene(kept: Path) -> None:
    """A viewer gets the last message before that time: it has to have everything."""
    found = messages_in(kept)
    sections = {f"S{section.id}" for section in setting().field.sections}
    bodies = {f"robot {slot}" for slot in range(ROBOTS)}
    for at_ns, told in found["/scene"]:
        names = {entity["id"] for entity in told["entities"]}
        assert names >= sections | {"outline 0"}, at_ns
        assert names >= bodies or at_ns < 3e9
    _, last = found["/paths"][-1]
    assert {entity["id"] for entity in last["entities"]} == {f"path {k}" for k in range(ROBOTS)}


@pytest.mark.parametrize("topic", TYPED)
def test_json_schemas_are_those_of_the_sdk(topic: str) -> None:
    """Each field that ours has is in that of the SDK, under that name and of that kind."""
    assert not differences(schema_of(topic), proto_of(topic), topic)


def differences(ours: Any, theirs: Any, path: str) -> list[str]:
    if ours["title"] != theirs.full_name:
        return [f"{path}: {ours['title']} is {theirs.full_name}"]
    found = []
    for name, schema in ours["properties"].items():
        field, at = theirs.fields_by_name.get(name), f"{path}.{name}"
        if field is None:
            found.append(f"{at} is unknown")
            continue
        if (schema.get("type") == "array") != field.is_repeated:
            found.append(f"{at}: one or many")
        each = schema["items"] if schema.get("type") == "array" else schema
        if "oneOf" in each:
            names = {choice["title"]: choice["const"] for choice in each["oneOf"]}
            members = {value.name: value.number for value in field.enum_type.values}
            if names != members:
                found.append(f"{at}: {names} are {members}")
        elif each.get("title") in ("time", "duration"):
            kind = {"time": "Timestamp", "duration": "Duration"}[each["title"]]
            if field.message_type.full_name != f"google.protobuf.{kind}":
                found.append(f"{at}: {field.message_type.full_name}")
        elif each["type"] == "object":
            found += differences(each, field.message_type, at)
        elif each["type"] == "string":
            kinds = (field.TYPE_BYTES,) if "contentEncoding" in each else (field.TYPE_STRING,)
            if field.type not in kinds:
                found.append(f"{at}: {field.type}")
        elif field.type not in PLAIN[each["type"]]:
            found.append(f"{at}: {field.type} is no {each['type']}")
    return found


def test_what_is_recorded_is_what_the_live_door_would_send(kept: Path) -> None:
    """Each message, through the SDK, and back by protobuf."""
    found = messages_in(kept)
    for topic in TYPED:
        schema = schema_of(topic)
        make, kind = maker_of(schema), message_factory.GetMessageClass(proto_of(topic))
        for _, value in found[topic]:
            same(value, kind.FromString(make(value).encode()), topic)
        assert found[topic] or topic == "/grid"


def same(value: Any, message: Any, path: str) -> None:
    if isinstance(value, dict) and value.keys() == {"sec", "nsec"}:
        assert (value["sec"], value["nsec"]) == (message.seconds, message.nanos), path
    elif isinstance(value, dict):
        for name, each in value.items():
            same(each, getattr(message, name), f"{path}.{name}")
    elif isinstance(value, list):
        assert len(value) == len(message), path
        for ours, theirs in zip(value, message, strict=True):
            same(ours, theirs, path)
    else:
        assert value == message, path


def test_the_map_of_an_arena_is_a_grid(tmp_path: Path) -> None:
    """A building and an arena have one, explored or not."""
    arena = ExplorationSetup(load_arena("arena").changed(2))
    keeping = RunRecorder(arena, tmp_path)
    keeping.write(0, encode(Member(0, 1, 7), 128))
    keeping.close()
    ((_, grid),) = messages_in(tmp_path / "run.mcap")["/grid"]
    schema = schema_of("/grid")
    message = message_factory.GetMessageClass(proto_of("/grid")).FromString(
        maker_of(schema)(grid).encode()
    )
    assert len(message.data) == 4 * arena.geometry.rows * arena.geometry.columns
    assert message.column_count == arena.geometry.columns


def test_each_part_of_a_recording_is_whole(tmp_path: Path) -> None:
    """A launch writes parts. Each one alone shows the fleet, though nothing has changed since."""
    keeping = RunRecorder(setting(), tmp_path, limit=Limit(part_bytes=50_000, parts=50))
    keeping.write(0, encode(Member(0, 1, 7), 128))
    for number in range(30_000):
        x_m = (number * 7919 % 4001) / 100
        pose = Pose(x_m, 4.0, 0.0, 1.0, 1, False, number & 0x1F)
        keeping.write(number * 50_000, encode(pose, 128))
    keeping.close()
    parts = parts_of(tmp_path / "run.mcap")
    assert len(parts) > 2
    for part in parts:
        found = messages_in(part)
        (_, told), *_ = found["/scene"]
        assert {"outline 0", "S0"} <= {entity["id"] for entity in told["entities"]}
        assert found["/tf"] and found["/log"]


def test_it_knows_of_a_fleet_what_an_inspector_knows(kept: Path) -> None:
    """Frames that only say places go a shorter way."""
    topics, inspector = RecordedTopics(None, lambda *_: None), Inspector()
    for t_us, frame in read_frames(kept):
        topics.hear(t_us / 1e6, frame)
        inspector.hear(t_us / 1e6, frame)
    assert inspector.kinds["Pose"] > 100
    assert topics.to_dict() == inspector.to_dict()
    for slot, robot in inspector.robots.items():
        assert topics.robots[slot].frames == robot.frames
