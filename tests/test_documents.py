"""What the documents print from the code is what the code prints."""

import re
from pathlib import Path

from agent.interface.lifecycle import TABLE, State
from agent.interface.state_machine import to_mermaid
from agent.safety.stop_cause import cause_table
from protocol.frames.messages import GROUPS

ROOT = Path(__file__).parents[1]


def test_the_table_of_causes() -> None:
    assert cause_table() in (ROOT / "docs" / "stopping.md").read_text()


def test_the_rules_of_the_checkers() -> None:
    code = (ROOT / "sim" / "checkers.py").read_text()
    rules = set(re.findall(r'Violation\(\s*"([a-z ]+)"', code))
    assert len(rules) >= 4
    for document in ("ARCHITECTURE.md", "docs/stopping.md"):
        text = (ROOT / document).read_text()
        assert all(f"`{rule}`" in text for rule in rules), document


def test_the_state_diagram() -> None:
    text = (ROOT / "ARCHITECTURE.md").read_text()
    assert to_mermaid(TABLE, State.DISCONNECTED) in text


def test_every_frame_is_in_the_table() -> None:
    text = (ROOT / "ARCHITECTURE.md").read_text()
    for group in GROUPS:
        assert f"| {group.name} | {group.pgn:#06x} | {group.priority} |" in text, group.name
