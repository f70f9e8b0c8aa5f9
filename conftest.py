"""Leaves out modules whose doctests cannot be collected here, because of a package that is absent."""

import re
from importlib.util import find_spec
from pathlib import Path

# What a module imports at its top, and only some systems have.
SOMETIMES = {"rclpy": re.compile(r"^(?:import|from) rclpy\b", re.M)}
ABSENT = [name for name in SOMETIMES if find_spec(name) is None]
TESTS = Path(__file__).parent / "tests"  # their modules skip by themselves, with a reason


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """True: not to be collected."""
    if not ABSENT or collection_path.suffix != ".py" or TESTS in collection_path.parents:
        return None
    text = collection_path.read_text(encoding="utf-8")
    return True if any(SOMETIMES[name].search(text) for name in ABSENT) else None


def pytest_report_header() -> list[str]:
    """What is left out, and why."""
    return [f"doctests of modules that import {name} are left out: it is absent" for name in ABSENT]
