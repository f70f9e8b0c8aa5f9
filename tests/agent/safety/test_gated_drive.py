"""Only the gate makes what a body's `drive` takes: a type error, not a comment."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
MAKERS = {
    "agent/interface/effects.py",  # HALT
    "agent/safety/stop_controller.py",  # the gate
    "sim/record/remote_body.py",  # the world's end of a socket: the gate is at the robot's end
    "tools/run/body_check.py",  # a person tries a driver without a robot
}
SNIPPET = """
from agent.interface.effects import HALT, Drive
from agent.interface.motion_controller import MotionController
from agent.interface.ports import Body
from agent.safety.stop_controller import StopController

def goes(body: Body, gate: StopController, wanted: Drive) -> None:
    body.drive(gate.gate(wanted, 0), 0)
    body.drive(HALT, 0)

def ungated(body: Body, wanted: Drive) -> None:
    body.drive(wanted, 0)
"""


def test_a_motion_that_has_not_passed_the_gate_is_a_type_error(tmp_path: Path) -> None:
    snippet = tmp_path / "ungated.py"
    snippet.write_text(SNIPPET)
    told = subprocess.run(
        [sys.executable, "-m", "mypy", "--no-error-summary", "--follow-imports=silent", str(snippet)],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    errors = [line for line in told.stdout.splitlines() if ": error:" in line]
    assert len(errors) == 1, told.stdout + told.stderr
    assert ":12: error" in errors[0] and '"GatedDrive"' in errors[0], errors


def test_nobody_else_makes_it() -> None:
    found = subprocess.run(
        ["git", "grep", "-lE", r"GatedDrive\(", "--", "crdt", "protocol", "agent", "sim", "tools"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert set(found.stdout.split()) == MAKERS
