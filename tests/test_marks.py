"""Marks follow from what a test module imports (`tests/conftest.py`)."""

from pathlib import Path

import pytest

from tests.conftest import kinds

TESTS = Path(__file__).parent


@pytest.mark.parametrize(
    ("text", "marks"),
    [
        ("import subprocess\n", ("process",)),
        ("from tests.tools.launching import start\n", ("process",)),
        ("    child = await asyncio.create_subprocess_exec('x')\n", ("process",)),
        ("from sim.fleet.simulated_fleet import Cluster\n", ("fleet",)),
        ("import subprocess\nfrom sim.runs.field_run import FieldRun\n", ("process", "fleet")),
        ("from sim.world.world import World\nfrom agent.peer.peer import Peer\n", ()),
        ("# import subprocess\n", ()),
    ],
)
def test_a_module_is_marked_by_its_imports(
    tmp_path: Path, text: str, marks: tuple[str, ...]
) -> None:
    path = tmp_path / "test_it.py"
    path.write_text(text)
    assert kinds(path) == marks


def test_both_marks_and_none_are_in_use() -> None:
    found = [kinds(path) for path in TESTS.rglob("test_*.py")]
    assert {(), ("fleet",), ("process",)} <= set(found)
    assert found.count(()) > 80, "most modules are unit tests"
