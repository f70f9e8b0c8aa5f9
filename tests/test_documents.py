"""What the documents print from the code is what the code prints."""

import re
import subprocess
import tomllib
from pathlib import Path
from typing import get_args

from agent.interface.lifecycle import TABLE, State
from agent.peer.diagnostics import fault_table
from agent.runtime.declared_values import GridTable
from agent.runtime.robot_file import (
    CarrierTable,
    ExplorationTable,
    FactoryTable,
    NavigationTable,
)
from agent.safety.stop_cause import cause_table
from agent.segments.segment_reachability import SEGMENTS_MAX
from protocol.frames.messages import GROUPS
from protocol.frames.segment_frames import SEGMENT_MAX
from protocol.state_machine import to_mermaid
from sim.chaos.fault_profiles import APART, PROFILES, SPANS
from sim.chaos.planted_bugs import MUTANTS
from sim.scenarios.scenario import Fault

ROOT = Path(__file__).parents[1]


def test_the_table_of_causes() -> None:
    assert cause_table() in (ROOT / "docs" / "use" / "stopping.md").read_text()


def test_the_table_of_faults() -> None:
    assert fault_table() in (ROOT / "docs" / "use" / "bus.md").read_text()


def test_the_rules_of_the_checkers() -> None:
    code = (ROOT / "sim" / "world" / "checkers.py").read_text()
    rules = set(re.findall(r'Violation\(\s*"([a-z ]+)"', code))
    assert rules == {"motion after stop", "exclusive work"}
    rules |= {"contact", "coverage"}  # the world and the outcome of every run have these
    for document in ("ARCHITECTURE.md", "docs/how/safety_case.md"):
        text = (ROOT / document).read_text()
        assert all(f"`{rule}`" in text for rule in rules), document


def test_the_state_diagram() -> None:
    text = (ROOT / "ARCHITECTURE.md").read_text()
    assert to_mermaid(TABLE, State.DISCONNECTED) in text


def test_every_frame_is_in_the_table() -> None:
    text = (ROOT / "ARCHITECTURE.md").read_text()
    for group in GROUPS:
        assert f"| {group.name} | {group.pgn:#06x} | {group.priority} |" in text, group.name


NAMED = re.compile(r"(?<![\w./-])(?:agent|protocol|crdt|sim|tools|tests|docs|examples)/[\w/]+\.\w+")
TERM = re.compile(r"`(\w+)`")
OVER = (
    "CHANGELOG.md",
    "changes/",
    "docs/history/",
    "tools/bench/house_lines.py",
)  # files as they were


def test_every_file_that_documents_and_sources_name_is_there() -> None:
    """On a move it is easy to forget those who point at the old place."""
    listed = subprocess.run(
        ["git", "ls-files", "*.md", "*.py", "*.toml", "*.yml", "Makefile"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    missing = []
    for name in listed.stdout.split():
        if not name.startswith(OVER) and (ROOT / name).exists():
            found = NAMED.findall((ROOT / name).read_text(encoding="utf-8"))
            missing += [f"{name}: {path}" for path in found if not (ROOT / path).exists()]
    assert not missing


TEST = re.compile(r"`(tests/[\w/]+\.py)::(test_\w+)`")


def test_every_row_of_the_threat_model_names_a_test() -> None:
    """A row that no test shows belongs under "What remains"."""
    text = (ROOT / "docs" / "how" / "trust.md").read_text(encoding="utf-8")
    rows = [line for line in text.split("## What remains")[0].splitlines() if line.startswith("| ")]
    named = {line: TEST.search(line) for line in rows}
    tables = [line for line in rows if "shown by" in line]
    assert sum(found is not None for found in named.values()) > 20 and len(tables) == 9
    for found in filter(None, named.values()):
        assert f"def {found[2]}(" in (ROOT / found[1]).read_text(encoding="utf-8"), found[0]
    unshown = [line for line, found in named.items() if found is None and line not in tables]
    assert len(unshown) == 6, "the kinds of attackers and nothing else"


LINK = re.compile(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)")


def test_every_link_of_a_document_leads_to_a_file() -> None:
    """Also outside of docs/, where `mkdocs build --strict` does not look."""
    listed = subprocess.run(
        ["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    missing = []
    for name in listed.stdout.split():
        if (ROOT / name).exists() and not name.startswith("changes/"):
            targets = LINK.findall((ROOT / name).read_text(encoding="utf-8"))
            missing += [
                f"{name}: {to}" for to in targets if not (ROOT / name).parent.joinpath(to).exists()
            ]
    assert not missing


def test_the_version_is_that_of_the_newest_release_in_the_changelog() -> None:
    with (ROOT / "pyproject.toml").open("rb") as file:
        version = tomllib.load(file)["project"]["version"]
    releases = re.findall(
        r"^## (\S+) \(\d{4}-\d\d-\d\d\)$", (ROOT / "CHANGELOG.md").read_text(), re.M
    )
    assert releases[0] == version
    assert releases == sorted(releases, key=lambda r: [int(n) for n in r.split(".")], reverse=True)


def test_a_fragment_is_a_list_of_short_items() -> None:
    for path in (ROOT / "changes").glob("*.md"):
        if path.name != "README.md":
            assert re.fullmatch(r"\d+-[a-z0-9-]+\.md", path.name), path.name
            assert path.read_text().startswith(("* ", "- ")), path.name


def test_the_page_of_chaos_has_each_profile_with_its_fleet_and_its_end() -> None:
    text = (ROOT / "docs" / "how" / "chaos.md").read_text(encoding="utf-8")
    for name, profile in PROFILES.items():
        assert f"| `{name}` | {profile.robots[0]} to {profile.robots[1]} " in text, name
    ends_s = {name: f"{span.calm_at_s:.0f} s" for name, span in SPANS.items()}
    assert (
        f"Until {ends_s['field']} ({APART.calm_at_s:.0f} s in `apart`, {ends_s['drill']} in drills, "
        f"{ends_s['sprint']} in sprints)" in text
    )
    for mission in ("drill", "sprint"):
        *most, last = [f"`{n}`" for n, profile in PROFILES.items() if profile.mission == mission]
        assert f"{', '.join(most)} and {last} play **{mission}s**" in " ".join(text.split()), (
            mission
        )
    assert f"has {len(MUTANTS)} bugs." in text


def test_the_page_of_chaos_has_each_kind_of_fault_and_a_story_with_it() -> None:
    text = (ROOT / "docs" / "how" / "chaos.md").read_text(encoding="utf-8")
    rows = text.split("## Faults")[1].split("## Rules")[0]
    told = {
        kind for row in re.findall(r"^\| (`[^|]*) \|", rows, re.M) for kind in TERM.findall(row)
    }
    faults = get_args(get_args(Fault)[0])
    kinds = {get_args(fault.model_fields["kind"].annotation)[0] for fault in faults}
    assert told == kinds
    stories = ROOT / "tests" / "chaos" / "stories"
    named = {stories / name for name in re.findall(r"(\w+\.toml)`", rows)}
    assert kinds == {
        fault["kind"]
        for story in named
        for fault in tomllib.loads(story.read_text(encoding="utf-8"))["fault"]
    }


def test_the_page_of_several_segments_has_the_limit_of_a_gateway() -> None:
    """Numbers reach further than the segments that a gateway keeps."""
    text = " ".join((ROOT / "docs" / "use" / "scale.md").read_text(encoding="utf-8").split())
    assert f"up to {SEGMENTS_MAX + 1:,} segments, with numbers from 1 to {SEGMENT_MAX:,}" in text
    assert f"A gateway keeps {SEGMENTS_MAX:,} others" in text


def test_the_threat_model_says_no_more_hours_with_keys_than_the_report() -> None:
    report = (ROOT / "docs" / "measured" / "chaos_report.md").read_text(encoding="utf-8")
    text = (ROOT / "docs" / "how" / "trust.md").read_text(encoding="utf-8")
    found = re.search(r"^([\d.]+) robot-hours are of fleets with keys", report, re.M)
    said = re.search(r"^\* More than ([\d,]+) robot-hours with keys", text, re.M)
    assert found is not None and said is not None
    assert float(found[1]) > float(said[1].replace(",", ""))


def test_the_page_of_the_robot_file_has_the_keys_of_each_table_of_work() -> None:
    """A key of a scenario that a robot does not know is an error, and the page said that it is none."""
    text = (ROOT / "docs" / "use" / "robot.md").read_text(encoding="utf-8")
    for table, model in (
        ("warehouse", CarrierTable),
        ("navigation", NavigationTable),
        ("exploration", ExplorationTable),
        ("coverage", GridTable),
        ("mission", FactoryTable),
    ):
        row = re.search(rf"^\| `\[{table}\]` \|[^|]*\|([^|]*)\|$", text, re.M)
        assert row is not None, table
        assert set(re.findall(rf"`(?:\[+{table}\.)?(\w+)\]*`", row[1])) == set(model.model_fields)
