"""Commands that compile kernels where they were never used say what they wait for."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from sim.runs.mapf_run import MapfRun
from sim.runs.planned_coverage import work
from tools.build import kernel_cache
from tools.build.kernel_cache import COMPILE, MORE
from tools.cli.headland import app
from tools.run import coverage_report


class AtOnce:
    """A timer whose time is over when it begins."""

    daemon = False

    def __init__(self, after_s: float, say: Callable[[], None]) -> None:
        self.say = say

    def start(self) -> None:
        self.say()

    def cancel(self) -> None:
        pass


@pytest.mark.parametrize("command", ["coverage solve", "mapf"])
def test_who_waits_for_kernels_is_told_so(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both were silent for up to a minute where they were called the first time."""
    event = pytest.importorskip("numba.core.event", reason="the extra `robot` is not installed")
    monkeypatch.setattr(kernel_cache, "Timer", AtOnce)

    def compiles(used: Callable[..., Any]) -> Callable[..., Any]:
        def call(*given: Any) -> Any:
            event.start_event(COMPILE)
            event.end_event(COMPILE)
            return used(*given)

        return call

    monkeypatch.setattr(coverage_report, "work", compiles(work))
    monkeypatch.setattr(MapfRun, "run", compiles(MapfRun.run))
    (tmp_path / "four.map").write_text(
        "type octile\nheight 4\nwidth 4\nmap\n....\n.@..\n....\n....\n"
    )
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, [*command.split(), "four.map", "--robots", "2"])
    said = " ".join(done.output.split())
    assert done.exit_code == 0 and said.count(MORE) == 1, done.output
