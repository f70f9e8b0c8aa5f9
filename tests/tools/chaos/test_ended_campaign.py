"""A campaign that is ended leaves no process behind; seeds that no run can have are refused at once."""

import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tools.chaos import chaos as campaign
from tools.chaos import planted_bug_hunt
from tools.chaos.campaign import ClusterError
from tools.chaos.chaos import _range, chaos

ROOT = Path(__file__).parents[3]
WAIT_S = 60.0  # for what takes three seconds on an idle machine


def children(process: int) -> list[int]:
    found = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    return [int(each) for each in found]


def goes_on(command: "subprocess.Popen[str]", for_s: float) -> bool:
    """Whether it still runs after this time."""
    try:
        command.wait(for_s)
    except subprocess.TimeoutExpired:
        return True
    return False


def begun(folder: Path, jobs: int, words: list[str]) -> tuple["subprocess.Popen[str]", list[int]]:
    """A campaign and its workers, which compute."""
    command = subprocess.Popen(
        [sys.executable, "-m", "tools.cli.headland", "chaos", "--seeds", "0:1000", "--jobs", str(jobs),
         "-o", str(folder), *words],
        cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    end_s = time.monotonic() + WAIT_S
    while len(workers := children(command.pid)) < jobs:
        assert time.monotonic() < end_s and goes_on(command, 0.05)
    assert goes_on(command, 0.5)  # by then they compute
    return command, workers


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")
@pytest.mark.parametrize(
    "number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL], ids=["SIGTERM", "SIGINT", "SIGKILL"]
)
@pytest.mark.parametrize("words", [[], ["--mutants"]])
def test_workers_end_with_their_campaign(
    tmp_path: Path, number: signal.Signals, words: list[str]
) -> None:
    command, workers = begun(tmp_path, 2, words)
    alive = {os.pidfd_open(each) for each in workers}  # can be read when the process has ended
    command.send_signal(number)
    _, said = command.communicate(timeout=WAIT_S)
    while alive:
        ended, _, _ = select.select(alive, [], [], WAIT_S)
        assert ended, "workers go on"
        for each in ended:
            alive.remove(each)
            os.close(each)
    assert command.returncode == (-number if number == signal.SIGKILL else 130)
    assert "Traceback" not in said


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")
@pytest.mark.parametrize("words", [[], ["--mutants"]])
def test_a_worker_that_is_killed_ends_the_campaign_in_one_line(
    tmp_path: Path, words: list[str]
) -> None:
    """As a system does that has no memory left: the campaign ended with a traceback."""
    command, workers = begun(tmp_path, 1, words)
    os.kill(workers[0], signal.SIGKILL)
    _, said = command.communicate(timeout=WAIT_S)
    assert command.returncode == 2 and "Traceback" not in said
    assert said.splitlines()[-1].startswith("headland: a process of the campaign was killed")


@pytest.mark.parametrize(
    "seeds", ["0:99999999999999999999", "9223372036854775808", "0:" + "9" * 5000, "9" * 5000]
)
def test_the_greatest_seed_is_told(
    seeds: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert chaos(seeds, "all", 1, None, tmp_path / "out", False, False) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "the greatest seed is 9223372036854775807" in said
    assert not (tmp_path / "out").exists()


def test_the_greatest_seed_is_one() -> None:
    assert _range("0:9223372036854775808").stop == 2**63


@pytest.mark.parametrize(("seeds", "mutants", "most"), [("0:2", False, 2), ("0:2", True, 100)])
def test_no_more_processes_are_started_than_there_are_runs(
    seeds: str, mutants: bool, most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All were started at the first run: `--seeds 0:2 --jobs 5000` made 5,000 processes."""
    asked = []

    def workers(jobs: int, cluster: str = "") -> object:
        asked.append(jobs)
        raise ClusterError("started enough")

    for module in (campaign, planted_bug_hunt):
        monkeypatch.setattr(module, "workers", workers)
    monkeypatch.setattr(planted_bug_hunt, "warm_up", lambda: None)
    assert chaos(seeds, "all", 5000, None, tmp_path, mutants, False) == 2
    assert len(asked) == 1 and 1 <= asked[0] <= most


def test_a_campaign_of_no_runs_keeps_no_rule(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--seconds` was over before the first run, and it said "every rule kept" with exit code 0."""
    assert chaos("0:2", "all", 1, 0.0, tmp_path, False, False) == 2
    said = capsys.readouterr()
    assert not said.out.strip() and said.err.count("\n") == 1 and "--seconds 0: over" in said.err
    assert not list(tmp_path.iterdir())
