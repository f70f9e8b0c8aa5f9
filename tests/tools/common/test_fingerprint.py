"""Results are of the same robots as long as no module that takes part in a run of chaos changes."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tools.common import fingerprint
from tools.common.fingerprint import JUDGED_FROM, PACKAGES, ROBOTS, ROOT

TAKES_PART = [
    "agent/peer/peer.py", "agent/peer/__init__.py", "agent/field/field_mission.py",
    "protocol/frames/frame.py", "crdt/stops.py",
]  # fmt: skip
STAYS_OUT = [
    "agent/implements/task_controller.py", "agent/runtime/bodies/nmea_body.py",
    "agent/segments/gateway.py", "protocol/links/zenoh_link.py", "sim/chaos/scenario_judge.py",
]  # fmt: skip


@pytest.fixture
def copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for package in PACKAGES:
        caches = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=caches)
    monkeypatch.setattr(fingerprint, "ROOT", tmp_path)
    return tmp_path


def of_robots() -> str:
    return fingerprint.robots_fingerprint.__wrapped__()


def test_robots_stay_the_same_where_nothing_of_a_run_changes(copied: Path) -> None:
    robots, code = of_robots(), fingerprint.fingerprint()
    for name in STAYS_OUT:
        with (copied / name).open("a") as file:
            file.write("\n# changed\n")
    assert of_robots() == robots and fingerprint.fingerprint() != code
    for name in TAKES_PART:
        with (copied / name).open("a") as file:
            file.write("\n# changed\n")
        assert of_robots() != robots, name
        robots = of_robots()


def test_all_that_a_run_imports_is_counted() -> None:
    """Python says what a run has imported; the fingerprint reads it from the sources."""
    script = (
        "import sys; from sim.chaos.fault_profiles import draw; from sim.chaos.verdict import judge\n"
        "judge(draw(3, 'forged')); judge(draw(3, 'press'))\n"
        f"print(*(getattr(m, '__file__', None) or '' for n, m in sys.modules.items() "
        f"if n.split('.')[0] in {ROBOTS}), sep='\\n')"
    )
    told = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True,
                          check=True, env={"PYTHONPATH": str(ROOT), "PATH": ""})  # fmt: skip
    counted = fingerprint._imported(ROOT / JUDGED_FROM)
    imported = {Path(line) for line in told.stdout.split()}
    assert len(imported) > 100 and imported <= counted, imported - counted
