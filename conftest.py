"""Looks for examples only in modules that have some, so that collecting reads the rest as text."""

from collections.abc import Generator
from pathlib import Path

import pytest

PROMPT = ">>> "


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(
    file_path: Path,
) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Takes away the collector of `--doctest-modules` where it would find nothing.

    It would import the module and look through every function and class in it, in each worker.
    One module in 20 has examples.
    """
    collectors = yield
    if file_path.suffix != ".py" or PROMPT in file_path.read_text(encoding="utf-8"):
        return collectors
    return [each for each in collectors if type(each).__name__ != "DoctestModule"]
