"""The commands that a run names at its end can be called with what is installed."""

from importlib.machinery import ModuleSpec

import pytest

from tools.run import run_field
from tools.run.run_field import work_export


def test_task_data_is_offered_only_where_its_package_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """From `headland[sim,operator]`, as the README installs it, the named export failed."""
    monkeypatch.setattr(run_field, "find_spec", lambda name: None)
    assert "--geojson" in work_export()[0]
    monkeypatch.setattr(run_field, "find_spec", lambda name: ModuleSpec(name, None))
    assert "--isoxml" in work_export()[0]
