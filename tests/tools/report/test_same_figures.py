"""What a report leaves out or computes in another way changes none of its figures."""

import os
import signal
import sys
from pathlib import Path
from random import Random

import numpy as np
import pytest

from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member, Pose
from protocol.frames.frame import Frame
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import EmergencyReset, EmergencyStop
from sim.record.recording import Recording
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.report import planned_aside as aside
from tools.report import timeline
from tools.report.command import report
from tools.report.timeline import History
from tools.report.tracking_error import _distances, _off_m
from tools.run.run_recorder import RunRecorder


def heard(seed: int) -> Recording:
    """Robots that pose, are silent, stop, come back under another address, and a foreign device."""
    rng, recording, t_us = Random(seed), Recording(), 0
    for _ in range(3000):
        t_us += rng.choice(
            [10_000, 20_000, 20_000, 20_000, 1_500_000 if rng.random() < 0.02 else 0]
        )
        slot = rng.randrange(4)
        source = 0x80 + slot + (rng.random() < 0.05)
        say = rng.random()
        if say < 0.8:
            data = encode(
                Pose(rng.uniform(-9, 9), 1.0, 0.0, rng.choice([0.0, 1.0, 12.75]), rng.randrange(5),
                     rng.random() < 0.1, 255), source,
            )  # fmt: skip
            if rng.random() < 0.02:
                data = Frame(data.identifier, rng.randbytes(rng.randrange(9)))
        elif say < 0.88:
            data = encode(Member(slot, rng.randrange(3), 7), source)
        elif say < 0.94:
            leaving = rng.random() < 0.1
            beat = Heartbeat(1, rng.randrange(5), False, False, True, leaving, 1.0, 3, 4)
            data = encode(beat, source)
        elif say < 0.97:
            data = encode(EmergencyStop(slot, 1, rng.randrange(9), 1), source)
        elif say < 0.99:
            data = encode(EmergencyReset(slot, 1, rng.randrange(9), 201), 0xF1)
        else:
            data = encode(AddressClaimed(rng.getrandbits(63)), source)
        recording.write(t_us, data)
    return recording


@pytest.mark.parametrize("seed", range(8))
def test_poses_by_the_short_way_say_what_they_say_as_all_frames_do(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = heard(seed)
    short = History().hear_all(recording)
    monkeypatch.setattr(timeline, "POSE_PGN", -1)
    long = History().hear_all(recording)
    assert short.places and short.pressed and short.malformed, f"seed {seed}"
    for name in ("places", "states", "held", "pressed", "seen", "loads", "malformed", "now_s"):
        assert getattr(short, name) == getattr(long, name), f"seed {seed}, {name}"


@pytest.mark.parametrize("seed", range(20))
def test_a_distance_is_that_of_numpy_to_the_last_bit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    line = [(x, y) for x, y in (rng.integers(-300, 300, (rng.integers(2, 9), 2)) / 7).tolist()]
    line.insert(1, line[0])  # a piece without a length
    for x, y in (rng.integers(-400, 400, (20, 2)) / 11).tolist():
        assert _off_m((x, y), line) == _distances([(x, y)], line).min(), f"seed {seed}"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten seconds of three robots."""
    pytest.importorskip("mcap", reason="the extra `operator` is not installed")
    out = tmp_path_factory.mktemp("run")
    scenario = load("small").changed(3, 31)
    limit = scenario.run.model_copy(update={"time_limit_s": 10.0})
    setting = FieldSetup(scenario.model_copy(update={"run": limit}))
    keeping = RunRecorder(setting, out)
    FieldRun(setting, out, attach=keeping).run()
    keeping.close()
    return out


def use_two_processes(monkeypatch: pytest.MonkeyPatch, two: bool) -> None:
    """The tests have threads of their own, which only wait."""
    monkeypatch.setattr("threading.active_count", lambda: 1 if two else 2)
    monkeypatch.setattr("os.cpu_count", lambda: 2)


LINUX = pytest.mark.skipif(sys.platform != "linux", reason="a report forks on Linux alone")


@pytest.mark.slow
@LINUX
def test_a_report_by_two_processes_is_the_same(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, both in (("one", False), ("two", True)):
        use_two_processes(monkeypatch, both)
        with aside.planned_aside(run) as planned:
            assert (planned is not None) is both
        (tmp_path / name).mkdir()
        assert report(run, tmp_path / name / "page.html", True) == 0
    one, two = tmp_path / "one", tmp_path / "two"
    for path in filter(Path.is_file, one.rglob("*")):
        assert path.read_bytes() == (two / path.relative_to(one)).read_bytes(), path.name
    assert (two / "page" / "planned.svg").is_file()


@LINUX
def test_what_the_second_process_cannot_read_is_one_line(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use_two_processes(monkeypatch, True)
    data = (run / "run.mcap").read_bytes()
    middle = data.index(b"zstd") + 400
    (tmp_path / "run.mcap").write_bytes(data[:middle] + b"\xff" * 400 + data[middle + 400 :])
    (tmp_path / "can.log").write_bytes((run / "can.log").read_bytes())
    assert report(tmp_path, None, False) == 2
    said = capsys.readouterr().err
    assert said.startswith("headland: ") and "damaged" in said and said.count("\n") == 1


@LINUX
def test_a_second_process_that_is_killed_is_one_line(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use_two_processes(monkeypatch, True)
    monkeypatch.setattr(aside, "_work", lambda source, pipe: os.kill(os.getpid(), signal.SIGKILL))
    assert report(run, tmp_path / "page.html", False) == 2
    said = capsys.readouterr().err
    assert "was ended" in said and said.count("\n") == 1
