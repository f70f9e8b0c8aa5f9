"""F6: a full disk ends a recording with one line; it never reaches the wire that is recorded."""

import asyncio
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from protocol.frames.frame import Frame
from sim.can.simulated_bus import FieldBus, forget, segment
from sim.files.candump import CandumpWriter
from sim.files.recording_end import Ending

FULL = Path("/dev/full")  # every write to it fails: no space left on device
FRAMES = 5_000
SMALL_BYTES = "1m"  # of a disk; most of it is taken, so that it is full after seconds of a launch
TAKEN_BYTES = 880_000
needs_full = pytest.mark.skipif(not FULL.exists(), reason="no /dev/full on this system")


@needs_full
def test_f6_a_log_that_fails_ends_with_one_line_and_counts_the_rest() -> None:
    said: list[str] = []
    log, ending = CandumpWriter(FULL), Ending("can.log", said.append)
    for number in range(FRAMES):
        ending(log.write, number, Frame(0xCFF1080, bytes(8)))
    ending.close(log.close)
    assert said == ["can.log: No space left on device: recording ends, the fleet goes on"]
    assert ending.lost > FRAMES // 2


@needs_full
def test_f6_a_tap_that_raises_costs_no_frame() -> None:
    async def story() -> None:
        wire = segment("full disk")
        log, heard, tapped = CandumpWriter(FULL), list[Frame](), list[Frame]()
        wire.taps += [log.write, lambda t_us, frame: tapped.append(frame)]
        speaker, listener = FieldBus("full disk"), FieldBus("full disk")
        listener.subscribe(heard.append)
        loop = asyncio.get_running_loop()
        for number in range(400):
            speaker.submit(Frame(0xCFF1080, number.to_bytes(8, "little")))
            due = loop.create_future()
            loop.call_later(0.001, due.set_result, None)
            await due
        assert len(heard) == len(tapped) and [f.data for f in heard] == [f.data for f in tapped]
        assert len(heard) >= 390 and wire.taps_lost == 1
        speaker.shutdown()
        listener.shutdown()
        forget("full disk")

    asyncio.run(story())


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "small"
    folder.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", f"size={SMALL_BYTES}", "tmpfs", str(folder)]
    if os.getuid() != 0 or subprocess.run(words, capture_output=True, check=False).returncode:
        pytest.skip("only root can mount a small disk, where it is permitted")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.mark.slow
def test_f6_a_launch_on_a_full_disk_ends_with_its_verdict(small_disk: Path) -> None:
    (small_disk / "taken").write_bytes(bytes(TAKEN_BYTES))
    words = ["launch", "small", "--robots", "2", "--seconds", "25", "--port", "0", "--out",
             str(small_disk / "run"), "--json"]  # fmt: skip
    ended = subprocess.run(
        [sys.executable, "-m", "tools.cli.headland", *words], capture_output=True, text=True,
        timeout=180, check=False, cwd=Path(__file__).parents[3],
    )  # fmt: skip
    said = ended.stderr
    assert "Traceback" not in said and "--port" not in said, said
    assert said.count("recording ends") in (1, 2), said  # of can.log and of run.mcap, each once
    assert ended.returncode == 1 and "not finished after" in said, said
    assert json.loads(ended.stdout)["contacts"] == 0
