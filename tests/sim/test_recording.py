"""Recordings: the same frames in every format, the same run with and without somebody watching."""

import json
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.frame import Frame
from sim import recording as recordings
from sim.candump import read_candump
from sim.expedition import Expedition
from sim.intent_link import MAGIC_INTENT, read_intent
from sim.mcap_log import CDR, McapLog, read_frames, read_recording
from sim.recording import FramesDigest, Recording
from sim.scenario import load
from sim.setting import Setting
from tools.keeping import Keeping
from tools.livemap.command import recorded

SECONDS = 30.0


def setting() -> Setting:
    scenario = load("small").changed(3, 7)
    run = scenario.run.model_copy(update={"time_limit_s": SECONDS})
    return Setting(scenario.model_copy(update={"run": run}))


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, str]:
    """Folder, trace hash and hash of the frames of a short run."""
    out = tmp_path_factory.mktemp("kept")
    keeping = Keeping(setting(), out)
    outcome = Expedition(setting(), out, logs=[out / "more.blf"], attach=keeping).run()
    keeping.close()
    return out, outcome.trace_hash, keeping.log_hash


def test_a_watched_run_is_the_same_run(kept: tuple[Path, str, str]) -> None:
    assert Expedition(setting()).run().trace_hash == kept[1]


@pytest.mark.parametrize("name", ["can.log", "run.mcap", "more.blf", "."])
def test_one_hash_in_every_format(kept: tuple[Path, str, str], name: str) -> None:
    out, _, log_hash = kept
    recording = recorded(out / name, None)
    assert recording.digest.hex == log_hash
    assert recording.count == sum(1 for _ in read_candump(out / "can.log"))
    assert recording.scene is not None and len(recording.scene["sections"]) == 14


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
        (outline,) = json.loads(drawn.data)["entities"]
        assert outline["id"] == "outline" and len(outline["lines"]) == 2
    ours = list(read_candump(out / "can.log"))
    assert list(read_frames(out / "run.mcap")) == ours


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
    assert recording.intents[0][0] >= recording.from_us == recording.first * 1000


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


@given(st.binary(max_size=200) | st.text(max_size=60).map(lambda t: MAGIC_INTENT + t.encode()))
def test_any_datagram_is_an_intent_or_none(data: bytes) -> None:
    assert read_intent(data) is None


def test_python_can_reads_our_log(kept: tuple[Path, str, str]) -> None:
    assert sum(1 for _ in can.LogReader(kept[0] / "can.log")) == recorded(kept[0], None).count
