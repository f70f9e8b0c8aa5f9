"""The documents as a site: printed parts are current, it builds without a warning, its examples run."""

import re
import runpy
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import pytest

from agent.interface.config import S
from crdt import Phase
from protocol.frames.messages import GROUPS
from sim.fleet.scheduler import Script
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.navigation_scenario import load_mission
from tests.tools.livemap.test_map import needs_browser
from tools.bench.browser import browser, until
from tools.cli import doc_pages as handbook
from tools.cli.frame_pages import frames

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"


@pytest.mark.sampled(15)
@pytest.mark.parametrize("name", handbook.pages())
def test_what_is_printed_is_current(name: str) -> None:
    assert (DOCS / name).read_text() == handbook.pages()[name], (
        "run: python -m tools.cli.doc_pages docs"
    )


def test_the_pages_say_it_all() -> None:
    page = frames()
    for group in GROUPS:
        assert f"## {group.name}\n" in page and f"{group.pgn:#06x}" in page


def test_every_document_is_in_the_site() -> None:
    told = re.findall(r"([\w/]+\.md)", (ROOT / "mkdocs.yml").read_text())
    assert sorted(told) == sorted(_documents())


def test_every_document_has_one_purpose() -> None:
    """It says how to use the fleet, how it works, what was measured, or what was so earlier."""
    parts = {path.split("/")[0] for path in _documents()}
    assert parts == {"use", "how", "measured", "history", "index.md", "glossary.md"}


def _documents() -> set[str]:
    return {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}


CODE_COLUMNS = 80  # what a box of the site shows, and a terminal has
# Their long lines are printed by us, and the site wraps them (docs/wrapped_code.css).
PRINTED = {"use/api.md", "use/inspect.md", "use/own_machine.md"}


def test_code_that_is_copied_fits_its_box() -> None:
    long = []
    for name in sorted(_documents() - PRINTED):
        inside = False
        for number, line in enumerate((DOCS / name).read_text().splitlines(), 1):
            if line.lstrip().startswith("```"):
                inside = not inside
            elif inside and len(line) > CODE_COLUMNS:
                long.append(f"{name}:{number}: {len(line)} columns")
    assert not long, "\n".join(long)


@pytest.mark.slow
@pytest.mark.skipif(find_spec("material") is None, reason="mkdocs-material is not installed")
def test_it_builds_and_loads_nothing_from_elsewhere(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    pages = sorted(tmp_path.rglob("*.html"))
    built = {path.relative_to(tmp_path).with_suffix(".md").as_posix() for path in pages}
    assert built >= _documents()
    for path in pages:
        loaded = re.findall(
            r'<(?:script|img|iframe)[^>]*\ssrc="(?:https?:)?//[^"]*"|<link[^>]*rel="(?:stylesheet|preconnect)"'
            r'[^>]*href="(?:https?:)?//[^"]*"', path.read_text(),
        )  # fmt: skip
        assert not loaded, f"{path.name}: {loaded}"
    front = (tmp_path / "index.html").read_text()
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"Headland {version}" in front and front.count("prefers-color-scheme") >= 3
    # The search of a page from a disk needs its index as a script: nothing can be fetched there.
    assert (tmp_path / "search" / "search_index.js").is_file()


@pytest.mark.slow
@needs_browser
@pytest.mark.skipif(find_spec("material") is None, reason="mkdocs-material is not installed")
def test_it_is_searched_from_a_disk_and_no_code_scrolls(tmp_path: Path) -> None:
    subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", str(tmp_path)],
        cwd=ROOT, check=True, timeout=180,
    )  # fmt: skip
    with browser() as page:
        page.set_window_size(800, 900)
        page.get((tmp_path / "use" / "bus.html").as_uri())
        until(page, SCROLLING + " === 0")
        page.execute_script("document.querySelector('[for=__search]').click()")
        page.execute_script(TYPE)
        until(page, "document.querySelectorAll('.md-search-result__link').length > 0")


# Boxes of code that are wider than they show.
SCROLLING = """[...document.querySelectorAll('pre > code')]
  .filter(e => e.scrollWidth > e.clientWidth + 1).length"""
TYPE = """const field = document.querySelector('.md-search__input');
field.focus(); field.value = 'silence';
for (const kind of ['focus', 'keyup', 'input', 'keydown'])
  field.dispatchEvent(new Event(kind, {bubbles: true}));"""


def test_the_tutorial_s_trouble_is_a_scenario(tmp_path: Path) -> None:
    (text,) = re.findall(r"```toml\n(.*?)```", (DOCS / "use" / "tutorial.md").read_text(), re.S)
    tomllib.loads(text)
    (tmp_path / "trouble.toml").write_text(text)
    scenario = load_mission(str(tmp_path / "trouble.toml"))
    assert len(scenario.fault) == 4 and FieldSetup(scenario).field.sections


@pytest.mark.parametrize("seed", [1, 2])
def test_the_mission_of_the_page_is_done(seed: int) -> None:
    example = runpy.run_path(str(ROOT / "examples" / "soil_samples.py"))
    seconds, cluster = example["sample"](3, seed)
    posts = example["SoilSetting"].posts
    assert all(r.peer.allocation.done_count() == len(posts) for r in cluster.robots.values())
    assert not cluster.world.contacts and seconds < 200, f"seed {seed}"
    for section, (x_m, y_m) in enumerate(posts):
        owner = cluster.robots[0].peer.allocation.owner_of(section)
        track = list(cluster.world.robots[owner].track)
        # The world's own truth: somebody stood there for as long as it takes.
        near_us = sum(
            b[0] - a[0] for a, b in pairwise(track)
            if abs(a[1] - x_m) < 0.3 and abs(a[2] - y_m) < 0.3
        )  # fmt: skip
        assert near_us >= 2.5 * S, (seed, section)


def test_a_dead_robot_s_post_is_taken_over() -> None:
    example = runpy.run_path(str(ROOT / "examples" / "soil_samples.py"))
    cluster_type, event_loop_type = example["Cluster"], example["EventLoop"]
    event_loop = event_loop_type()
    setting = example["SoilSetting"](example["load"]("small").changed(3, 1))
    cluster = cluster_type(setting, "soil, a death", None, event_loop)

    def play() -> Script[None]:
        cluster.boot_all()
        yield 4 * S
        cluster.kill(1)
        while not cluster.finished and event_loop.now_us() < 300 * S:
            yield event_loop.now_us() + S
            cluster.check()

    event_loop.run(play())
    cluster.end()
    allocation = cluster.robots[0].peer.allocation
    phases = [allocation.phase_of(k) for k in range(len(setting.posts))]
    assert set(phases) == {Phase.DONE}
