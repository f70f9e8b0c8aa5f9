"""Every example and every notebook runs from top to bottom, in an empty folder."""

import ast
import json
import runpy
import sys
from pathlib import Path

import pytest

from tests.tools.launching import ROOT

EXAMPLES = ROOT / "examples"
SCRIPTS = sorted(path.name for path in EXAMPLES.glob("*.py"))
NOTEBOOKS = sorted(path.name for path in EXAMPLES.glob("*.ipynb"))
FILES = {"errands.py": "errands.png", "parcels.py": "parcels.png", "speedup.py": "speedup.png"}
pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for package, extra in (("pandas", "frames"), ("matplotlib", "sim")):
        pytest.importorskip(package, reason=f"the extra `{extra}` is not installed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.setenv("MPLBACKEND", "Agg")
    return tmp_path


@pytest.mark.parametrize("name", SCRIPTS)
def test_an_example_runs(name: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    assert capsys.readouterr().out.strip(), "it says what came of it"
    if name in FILES:
        assert (folder / FILES[name]).read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs_from_top_to_bottom(name: str) -> None:
    notebook = json.loads((EXAMPLES / name).read_text())
    assert notebook["nbformat"] == 4
    assert all(not cell.get("outputs") for cell in notebook["cells"]), (
        "outputs do not belong into git"
    )
    names: dict[str, object] = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            *first, last = ast.parse("".join(cell["source"])).body
            exec(compile(ast.Module(first, []), name, "exec"), names)
            assert isinstance(last, ast.Expr), "each cell shows something"
            assert eval(compile(ast.Expression(last.value), name, "eval"), names) is not None
    sys.modules.pop("posts", None)


def test_there_are_ten_examples_and_a_notebook_for_each_mission() -> None:
    assert len(SCRIPTS) >= 10
    assert {"ten_lines", "errands", "warehouse", "exploration", "grid", "own_mission"} <= {
        Path(name).stem for name in NOTEBOOKS
    }
