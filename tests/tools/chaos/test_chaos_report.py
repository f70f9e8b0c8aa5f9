"""The report is what its results say, and a regenerated one is the committed one."""

import json
import logging
import re
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from typer.testing import CliRunner

from sim.chaos.fault_profiles import DRAWN_SHAPE, FORGER, PROFILES, with_faults
from sim.chaos.scenario_judge import RUNNER_LOG
from sim.chaos.verdict import Verdict, judge
from sim.scenarios.protocol_setup import drill
from sim.scenarios.scenario import DiskFull
from tools.chaos import chaos as campaign
from tools.chaos.chaos import chaos
from tools.chaos.chaos_report import KEYED, ReportError, figures, is_keyed, judged_hours, report
from tools.chaos.fuzz import fuzz
from tools.chaos.planted_bug_hunt import RESULTS, hunt_all
from tools.cli.headland import app
from tools.cli.test_commands import PROFILES as PROFILE_NAMES

DOCS = Path(__file__).parents[3] / "docs" / "measured"


def test_the_committed_report_is_the_one_of_the_committed_results() -> None:
    again = "headland chaos --report docs/measured/chaos_runs > docs/measured/chaos_report.md"
    assert report(DOCS / "chaos_runs") == (DOCS / "chaos_report.md").read_text(), again


@pytest.mark.slow
def test_a_campaign_and_fuzzing_make_a_report(tmp_path: Path) -> None:
    assert chaos("4", "stop", 1, None, tmp_path, False, True) == 0
    assert fuzz(["frame"], 50, None, 1, "plain", False, tmp_path, True) == 0
    text = report(tmp_path)
    told = json.loads((tmp_path / "chaos.json").read_text())
    assert told["seeds"] == [4, 5] and told["cpu_s"] > 0.0
    assert f"{told['robot_hours']:.1f} robot-hours judged in 1 runs" in text
    assert "| frame | 50 |" in text and "**missed**" in text


def test_parts_of_a_campaign_in_one_file_are_one_row(tmp_path: Path) -> None:
    part: dict[str, Any] = {
        "profile": "all", "seeds": [0, 10], "robot_hours": 1.5, "runs": 10, "cpu_s": 3600.0, "failed": [],
        "broken": [], "code": "c", "robots": "r", "hash": "h", "faults": {"crash": 2},
    }  # fmt: skip
    parts = [
        part,
        part | {"seeds": [10, 20]},
        part | {"seeds": [30, 40]},
        part | {"profile": "bus"},
    ]
    (tmp_path / "campaign.json").write_text(json.dumps(parts))
    text = report(tmp_path)
    assert "6.0 robot-hours judged in 40 runs" in text
    assert "| all | 0 to 19 | 20 | 3.0 | 2.00 | 0 | c | 2 parts, each with its own |" in text
    assert "| all | 30 to 39 | 10 | 1.5 | 1.00 | 0 | c | h |" in text
    assert "| bus | 0 to 9 |" in text and "| crash | 8 |" in text


def test_the_report_as_json_is_one_document_with_the_same_figures(
    tmp_path: Path,
) -> None:
    """It printed Markdown."""
    where = {"t_s": 1.0, "rule": "S1", "what": "moved"}
    campaign: dict[str, Any] = {
        "profile": "all", "seeds": [0, 10], "robot_hours": 1.5, "runs": 10, "cpu_s": 3600.0,
        "failed": [4], "broken": [{"seed": 4, **where}], "code": "c", "robots": "r",
        "hash": "h", "faults": {"crash": 2},
    }  # fmt: skip
    fuzzed = [{"target": "frame", "executions": n, "cpu_s": 0.25, "crash": ""} for n in (50, 70)]
    (tmp_path / "a.json").write_text(json.dumps([campaign, {"fuzzed": fuzzed}]))
    assert CliRunner().invoke(app, ["chaos", "--report", str(tmp_path)]).exit_code == 0
    done = CliRunner().invoke(app, ["chaos", "--report", str(tmp_path), "--json"])
    told = json.loads(done.stdout)
    assert done.exit_code == 0 and done.stdout.count("\n") == 1
    assert told["broken"] == [{"profile": "all", "seed": 4, **where}] and not told["false_alarms"]
    assert (told["robot_hours"], told["runs"], told["faults"]) == (1.5, 10, {"crash": 2})
    assert told["fuzzed"] == [{"target": "frame", "executions": 120, "cpu_s": 0.5, "broken": 0}]


def test_the_committed_results_are_json_too() -> None:
    told = figures(DOCS / "chaos_runs")
    assert f"{told['robot_hours']:.1f} robot-hours judged" in report(DOCS / "chaos_runs")


def test_hours_are_not_counted_twice(tmp_path: Path) -> None:
    row: dict[str, Any] = {"profile": "all", "seeds": [0, 10], "robot_hours": 1.0}
    (tmp_path / "a.json").write_text(json.dumps(row))
    (tmp_path / "b.json").write_text(json.dumps(row | {"seeds": [9, 12]}))
    with pytest.raises(ReportError, match="seed 9 of all"):
        report(tmp_path)


@pytest.mark.parametrize(("row", "said"), [
    ({"profile": "story.toml", "robot_hours": 0.2}, "a.json is of one scenario, not of a campaign"),
    ({"profile": "all", "seeds": [0, 5], "robot_hours": 0.2}, "a.json is not a whole result"),
])  # fmt: skip
def test_what_is_no_campaign_is_one_line(tmp_path: Path, row: dict[str, Any], said: str) -> None:
    """`headland chaos --scenario FILE --json` in the folder of results made a traceback."""
    (tmp_path / "a.json").write_text(json.dumps(row))
    done = CliRunner().invoke(app, ["chaos", "--report", str(tmp_path)])
    assert done.exit_code == 2 and said in done.stderr and done.stderr.count("\n") == 1


@pytest.mark.parametrize(("robots", "again", "broken"), [
    ("same", [], 0), ("same", [7], 1), ("other", [], 1),
])  # fmt: skip
def test_a_false_alarm_is_one_that_the_same_robots_are_cleared_of(
    tmp_path: Path, robots: str, again: list[int], broken: int
) -> None:
    what = {"seed": 7, "rule": "S1", "t_s": 1.0, "what": "moved"}
    row: dict[str, Any] = {
        "profile": "protocol", "seeds": [0, 10], "robot_hours": 30_000.0, "runs": 10, "cpu_s": 1.0,
        "failed": [7], "broken": [what], "code": "before", "robots": "same", "hash": "", "faults": {},
    }  # fmt: skip
    once = {"seeds": [7, 8], "failed": again, "broken": [what] * len(again), "robots": robots}
    (tmp_path / "a.json").write_text(json.dumps(row))
    (tmp_path / "b.json").write_text(json.dumps(row | once | {"code": "after"}))
    text = report(tmp_path)
    assert "30000.0 robot-hours judged in 10 runs" in text and f"{broken} rules broken" in text
    assert ("| 7 | S1 | moved | after |" in text) is (broken == 0)
    assert ("reached" in text.split("Planted")[0]) is (broken == 0)
    assert judged_hours(tmp_path, "same") == (30_000.0, broken)
    assert judged_hours(tmp_path, "of tomorrow") == (0.0, 0), "they show nothing of other robots"


def test_hours_of_fleets_with_keys_are_counted_apart(tmp_path: Path) -> None:
    row: dict[str, Any] = {
        "profile": "stolen", "seeds": [0, 10], "robot_hours": 5_001.0, "runs": 10, "cpu_s": 1.0,
        "failed": [], "broken": [], "code": "code", "robots": "same", "hash": "", "faults": {},
    }  # fmt: skip
    (tmp_path / "a.json").write_text(json.dumps(row))
    assert "5001.0 robot-hours are of fleets with keys" in report(tmp_path)
    assert "(wanted: 5000, reached); 0 rules broken in them." in report(tmp_path)
    assert judged_hours(tmp_path, "same") == (0.0, 0)
    assert judged_hours(tmp_path, "same", is_keyed) == (5_001.0, 0)
    what = {"seed": 7, "rule": "S1", "t_s": 1.0, "what": "moved"}
    (tmp_path / "a.json").write_text(json.dumps(row | {"failed": [7], "broken": [what]}))
    assert "(wanted: 5000, **missed**); 1 rules broken in them." in report(tmp_path)
    assert judged_hours(tmp_path, "same", is_keyed) == (5_001.0, 1)
    assert {name for name, profile in PROFILES.items() if profile.keyed} == set(KEYED)
    assert is_keyed("forged_field" + DRAWN_SHAPE) and is_keyed("body" + DRAWN_SHAPE + FORGER)
    assert not is_keyed("body" + DRAWN_SHAPE)
    (tmp_path / "a.json").write_text(json.dumps(row | {"profile": "bus" + FORGER}))
    assert judged_hours(tmp_path, "same", is_keyed) == (5_001.0, 0), "any profile with an attacker"


@pytest.mark.slow
def test_a_hunt_goes_on_where_it_stopped(tmp_path: Path) -> None:
    console, names = Console(quiet=True), ["latch-forgotten"]
    assert hunt_all(console, names, 1, 0.0, tmp_path, False)[0]["runs"] == 0
    (row,) = hunt_all(console, names, 1, 30.0, tmp_path, False)
    assert row["found"] and row["rule"]
    written = (tmp_path / RESULTS).read_text()
    assert hunt_all(console, names, 1, 30.0, tmp_path, False) == [row]
    assert (tmp_path / RESULTS).read_text() == written, "what was found is not looked for again"


@pytest.mark.slow
def test_what_was_shown_so_far_is_kept_in_a_row(tmp_path: Path, monkeypatch: Any) -> None:
    """A campaign whose process dies loses what was not yet written, and seeds behind a gap are not
    counted: the row says which were played."""
    monkeypatch.setattr(campaign, "KEEP_S", -1.0)
    kept = list[tuple[list[int], float]]()

    def keep(verdicts: list[Verdict], cpu_s: float) -> None:
        kept.append(([verdict.seed for verdict in verdicts], cpu_s))

    seeds = range(3, 6)
    verdicts, cpu_s = campaign._campaign(Console(quiet=True), seeds, "press", 2, None, "", keep)
    assert [verdict.seed for verdict in verdicts] == [*seeds]
    assert all(row == [*seeds][: len(row)] for row, _ in kept)
    assert kept[-1] == ([*seeds], cpu_s) and cpu_s > 0.0
    assert campaign._played(verdicts, 3) == (3, 6)
    assert campaign._played([], 3) == (3, 3), "no run is over yet: it said 0 to 0"


def test_i24_help_and_documents_name_every_profile() -> None:
    told = re.split(r", | or ", PROFILE_NAMES.removesuffix("."))
    assert told == [*dict.fromkeys(told)] and set(told) == set(PROFILES)
    table = (DOCS.parent / "how" / "chaos.md").read_text()
    assert [name for name in PROFILES if f"\n| `{name}` | " not in table] == []


def test_i24_an_injected_fault_of_a_disk_is_not_printed(capfd: pytest.CaptureFixture[str]) -> None:
    full = DiskFull(at_s=5.0, kind="disk_full", robot=0, for_s=2.0)
    seen: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: seen.append(record.getMessage())  # type: ignore[method-assign]
    RUNNER_LOG.addHandler(handler)
    try:
        assert judge(with_faults(drill(2, 1, "sprint"), [full])).faults == {"disk_full": 1}
        assert not seen and not capfd.readouterr().err
        assert not RUNNER_LOG.disabled, "a robot outside a campaign logs it"
    finally:
        RUNNER_LOG.removeHandler(handler)


def test_results_name_reproductions_without_the_folders_of_a_machine() -> None:
    """A campaign notes where it left a reproduction, and that folder is on no other machine."""
    named = re.compile(r'"reproduction": "([^"]*)"')
    for file in (DOCS / "chaos_runs").glob("*.json"):
        assert not [name for name in named.findall(file.read_text()) if "/" in name], file.name
