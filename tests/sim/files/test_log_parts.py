"""F11: the logs of a launch do not fill the disk: they are in parts, and the newest are kept."""

from collections.abc import Callable
from errno import ENOSPC
from pathlib import Path

import pytest

from protocol.frames.frame import Frame
from sim.files.candump import CandumpWriter, read_candump
from sim.files.log_parts import Limit, PartedLog, part_path, parts_of
from sim.files.recording_end import Ending
from sim.record.mcap_log import McapLog, read_frames, read_recording
from sim.record.robot_intent import Intent
from sim.record.scene_builder import scene_of
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.inspect.log_frames import frames_of
from tools.livemap.command import recorded

LIMIT = Limit(part_bytes=4096, parts=3)
LINE_BYTES = 48
FRAMES = 1_000
SCENE = scene_of(FieldSetup(load("small")))
SPREAD = 0x9E3779B97F4A7C15  # payloads that do not compress


def _frame(number: int) -> Frame:
    return Frame(0xCFF1080, number.to_bytes(8, "little"))


def _candump(path: Path, _: int) -> CandumpWriter:
    return CandumpWriter(path)


def _mcap(path: Path, t_us: int) -> McapLog:
    return McapLog(path, SCENE, t_us)


def test_f11_a_log_keeps_its_newest_parts_and_says_once_that_older_ones_go(tmp_path: Path) -> None:
    said: list[str] = []
    log = PartedLog(tmp_path / "can.log", _candump, 0, LIMIT, said.append)
    for number in range(FRAMES):
        log.write(number * 1000, _frame(number))
    log.close()
    parts = parts_of(tmp_path / "can.log")
    assert len(parts) == LIMIT.parts and sorted(parts) == sorted(tmp_path.iterdir())
    assert all(part.stat().st_size < LIMIT.part_bytes + LINE_BYTES for part in parts)
    assert said == [
        "can.log: its newest 12288 bytes are kept; what is older is deleted from now on"
    ]
    kept = [frame for part in parts for _, frame in read_candump(part)]
    assert kept == [_frame(number) for number in range(FRAMES - len(kept), FRAMES)]
    assert len(kept) > (LIMIT.parts - 1) * (LIMIT.part_bytes // LINE_BYTES)
    assert [frame for _, frame in frames_of(tmp_path)] == kept  # inspect, say, replay
    assert [frame for _, frame in frames_of(tmp_path / "can.log")] == kept
    assert [frame for _, frame in frames_of(parts[0])] == kept[
        : sum(1 for _ in read_candump(parts[0]))
    ]


def test_f11_an_mcap_is_closed_and_begun_again_by_size(tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="the extra `operator` is not installed")
    limit, said = Limit(part_bytes=200_000, parts=4), list[str]()
    intent = Intent(1, 0.0, 0.0, 0.0, 0.0, 0.0, (0.0, 0.0), (), (), (1,), (), (), False).to_dict()
    log = PartedLog(tmp_path / "run.mcap", _mcap, 0, limit, said.append)
    for number in range(40_000):
        payload = (number * SPREAD & (1 << 64) - 1).to_bytes(8, "little")
        log.write(number * 1000, Frame(0xCFF1080, payload))
        if number % 1000 == 0:
            log.tell(number * 1000, intent)
    log.close()
    parts = parts_of(tmp_path / "run.mcap")
    assert len(parts) == limit.parts and len(said) == 1 and log.deleted > 0
    assert all(part.read_bytes().endswith(b"\x89MCAP0\r\n") for part in parts), "each is whole"
    counts = [sum(1 for _ in read_frames(part)) for part in parts]
    for found in (read_recording(tmp_path / "run.mcap"), recorded(tmp_path, None)):
        assert found.count == sum(counts) and found.scene is not None
        assert found.t_us(0) == (40_000 - sum(counts)) * 1000
        assert len(found.intents) == sum(counts) // 1000


@pytest.mark.parametrize(("name", "begin"), [("can.log", _candump), ("run.mcap", _mcap)])
def test_f11_a_disk_that_is_full_where_a_part_begins_ends_the_recording_with_one_line(
    tmp_path: Path, name: str, begin: Callable[[Path, int], CandumpWriter | McapLog]
) -> None:
    """A launch ended with "write to closed file", and left no report.json."""
    if begin is _mcap:
        pytest.importorskip("mcap", reason="the extra `operator` is not installed")

    def first_part(path: Path, t_us: int) -> CandumpWriter | McapLog:
        if t_us:
            raise OSError(ENOSPC, "No space left on device")
        return begin(path, t_us)

    said: list[str] = []
    log = PartedLog(tmp_path / name, first_part, 0, LIMIT, said.append)
    ending = Ending(name, said.append)
    for number in range(20_000):
        ending(log.write, number * 1000, _frame(number))
    ending.close(log.close)
    assert said == [f"{name}: No space left on device: recording ends, the fleet goes on"]
    (kept,) = tmp_path.iterdir()
    assert kept.name == part_path(tmp_path / name, 1).name
    assert [frame for _, frame in frames_of(kept)][:2] == [_frame(0), _frame(1)]
