"""Logs in every format we write, read back by the inspector and by python-can."""

import asyncio
import json
from pathlib import Path

import can
import pytest

from sim.fleet.virtual_clock import run_virtual
from tools.inspect.log_frames import frames_of
from tools.run.replay import _play, replay
from tools.run.run_field import run


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("recorded")
    logs = [out / f"more{suffix}" for suffix in (".blf", ".asc", ".csv")]
    assert run("small", 2, 1, out, False, None, logs) == 0
    return out


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", ["more.blf", "more.asc", "more.csv"])
def test_every_format_holds_the_same_frames(recorded: Path, name: str) -> None:
    ours = list(frames_of(recorded / "can.log"))
    theirs = list(frames_of(recorded / name))
    assert [frame for _, frame in theirs] == [frame for _, frame in ours]
    # ASC begins at its first frame; all are exact to what the format can say
    offset_us = ours[0][0] - theirs[0][0]
    assert all(abs(a[0] - b[0] - offset_us) <= 100 for a, b in zip(ours, theirs, strict=True))
    assert sum(1 for _ in can.LogReader(recorded / name)) == len(ours)


def test_replay_shows_what_the_run_ended_with(
    recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert replay(recorded, 0.0, "", "can0", 250_000, "", 0, True) == 0
    seen = json.loads(capsys.readouterr().out)
    assert {robot["slot"] for robot in seen["robots"]} == {0, 1}
    assert all(section["phase"] == "DONE" for section in seen["sections"].values())


def test_replay_onto_a_bus(recorded: Path) -> None:
    with can.Bus(interface="virtual", channel="replay") as listener:
        assert replay(recorded, 0.0, "virtual", "replay", 250_000, "", 0, True) == 0
        heard = 0
        while listener.recv(0.0) is not None:
            heard += 1
    assert heard == sum(1 for _ in frames_of(recorded))


@pytest.mark.parametrize(
    ("clock_s", "took_s"),
    [
        ([0, 1, 5], 0.5),
        ([0, 1, 3601, 3602], 1.2),
        ([0, 1, 1e8, 2, 3, 4], 1.3),
        ([90, 0, 1, 2], 0.2),
    ],
)
def test_a_log_with_a_gap_is_replayed_to_its_end(
    tmp_path: Path, clock_s: list[float], took_s: float
) -> None:
    """Where the clock of a logger had been set by years, `headland replay --speed 10` stood for good.
    Where it had been set back, all frames came at once until the clock was where it had been."""
    log, heard_s = tmp_path / "gap.log", list[float]()
    log.write_text("".join(f"({t_s:.6f}) can0 0CFF1080#00\n" for t_s in clock_s))

    async def story() -> float:
        await _play(
            lambda t_us, _: heard_s.append(t_us / 1e6), log, 10.0, lambda: None, lambda: None
        )
        return asyncio.get_running_loop().time()

    assert run_virtual(story()) == pytest.approx(took_s, abs=0.01)
    assert heard_s == clock_s


def test_what_cannot_be_read_or_written_is_said_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert replay(tmp_path / "none.log", 0.0, "", "can0", 250_000, "", 0, False) == 2
    assert run("small", 1, 1, tmp_path, False, None, [tmp_path / "log.db"]) == 2
    assert all(line.startswith("headland: ") for line in capsys.readouterr().err.splitlines())
