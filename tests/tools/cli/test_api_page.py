"""The page of the programming interface shows every public name, and the docstring and fields of each."""

import ast
from pathlib import Path

import pytest

import crdt
from agent.runtime.engine import FleetCoordinationEngine
from tools.cli.api_page import SURFACES, Surface, api

ROOT = Path(__file__).parents[3]
LAYERS = ("crdt", "protocol", "agent")


def test_every_method_of_the_engine_is_shown() -> None:
    page = api()
    public = [name for name in vars(FleetCoordinationEngine) if not name.startswith("_")]
    methods = [name for name in public if callable(getattr(FleetCoordinationEngine, name))]
    assert len(methods) > 10
    assert all(f"def {name}(" in page for name in methods)


def test_what_packages_export_is_shown() -> None:
    page = api()
    assert all(f"### {name}\n" in page for name in crdt.__all__)
    shown = {surface.source for surface in SURFACES}
    for layer in LAYERS:
        for init in (ROOT / layer).rglob("__init__.py"):
            exports = [n for n in ast.parse(init.read_text()).body if isinstance(n, ast.ImportFrom)]
            assert not exports or init.relative_to(ROOT).as_posix() in shown, (
                f"{init}: its exports are on no page; add it to SURFACES"
            )


SOURCE = '''"""A module."""

class Pair(NamedTuple):
    """Two numbers.

    More of it.
    """

    left_m: int  # metres
    _hidden: int = 0

    @property
    def sum(self) -> int:
        """Both."""

    def _private(self) -> None: ...

    def long(
        self, first: dict[str, int], second: tuple[int, ...] = (), third_s: float = 1.0, more: int = 0
    ) -> list[int]:
        """Many arguments."""

def _nobody() -> None: ...
'''


def test_fields_comments_and_signatures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "pair.py").write_text(SOURCE)
    monkeypatch.setattr("tools.cli.api_page.SURFACES", (Surface("Pairs", "pair.py"),))
    page = api(tmp_path)
    assert "## Pairs: `headland.pair`\n\nA module.\n" in page
    assert (
        "class Pair(NamedTuple):\n    left_m: int  # metres\n```\n\nTwo numbers.\n\nMore of it.\n"
        in page
    )
    assert "@property\ndef sum() -> int\n```\n\nBoth.\n" in page
    assert "def long(\n    first: dict[str, int],\n    second: tuple[int, ...]=(),\n" in page
    assert "_hidden" not in page and "_private" not in page and "_nobody" not in page


def test_a_moved_module_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        api(tmp_path)
