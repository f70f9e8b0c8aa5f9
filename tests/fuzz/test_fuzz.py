"""A hundred thousand inputs, and all of the corpus, into every decoder. Ten million: `headland fuzz`."""

from pathlib import Path

import pytest

from sim.chaos.fuzz_targets import TARGETS
from tools.chaos.fuzz import corpus, fuzz, plainly, replay

RUNS = {"frame": 40_000, "stop_set": 20_000, "progress": 10_000, "journal": 10_000,
        "allocation": 10_000, "occupancy": 10_000}  # fmt: skip
SLOW_RUNS = 1_500  # of those that build a peer or read a file


@pytest.mark.parametrize("name", TARGETS)
def test_no_input_breaks_a_promise(name: str, tmp_path: Path) -> None:
    for data in corpus(name):
        TARGETS[name](data)
    done = plainly(name, RUNS.get(name, SLOW_RUNS), None, 1, tmp_path)
    assert done.ok, f"{done.why}: {done.crash}"


def test_what_breaks_is_kept_and_can_be_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(data: bytes) -> None:
        assert data[-1:] != b"\xff"

    monkeypatch.setitem(TARGETS, "frame", broken)
    assert fuzz(["frame"], 5_000, None, 1, "plain", False, tmp_path, True) == 1
    (found,) = tmp_path.glob("frame-*")
    with pytest.raises(AssertionError):
        replay("frame", found)
    assert fuzz(["nothing"], 1, None, 1, "plain", False, tmp_path, True) == 2
    assert "no fuzz target nothing" in capsys.readouterr().err
