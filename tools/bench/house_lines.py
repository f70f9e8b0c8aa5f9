"""Lines of code before and after the rebuilding of the house, for what its plan found too much.

Lines of code hold part of a statement that is not a docstring. The first commit is the one that the
plan counted, the second the one of release 0.4.0, when the house stood; `now` is the working tree.
The page docs/history/house.md shows the table.

Example: python -m tools.bench.house_lines
"""

import ast
import re
import subprocess
from collections.abc import Iterable, Iterator
from fnmatch import fnmatch
from typing import NamedTuple

from tools.bench.house import ROOT, lines_of_code

THEN = "24747e2"
REBUILT = "47897616"  # release 0.4.0; other issues have added to what there was since
PRODUCT = ("crdt/*", "protocol/*", "agent/*", "sim/*", "tools/*", "headland/*")
ALIAS = re.compile(r"^\w+(?:: TypeAlias)? = tuple\[float, float\]", re.M)

Texts = dict[str, str]  # of Python files, by path


class Item(NamedTuple):
    """What the plan found too much, and the files that hold it, as patterns of paths."""

    what: str
    then: tuple[str, ...]
    now: tuple[str, ...]


ITEMS = (
    Item(
        "runs of five missions",
        ("sim/expedition.py", "sim/outing.py", "sim/haul.py", "sim/survey.py", "sim/grid_fleet.py",
         "sim/drill_run.py", "sim/outcome.py"),
        ("sim/runs/run.py", "sim/runs/field_run.py", "sim/runs/navigation_run.py",
         "sim/runs/delivery_run.py", "sim/runs/exploration_run.py", "sim/runs/coverage_run.py",
         "sim/runs/protocol_run.py", "sim/fleet/outcome.py"),
    ),
    Item(
        "commands that run four missions",
        ("tools/run.py", "tools/run_errands.py", "tools/haul.py", "tools/explore.py"),
        ("tools/run/run_field.py", "tools/run/run_navigation.py", "tools/run/run_delivery.py",
         "tools/run/run_exploration.py", "tools/run/run_mission.py"),
    ),
    Item(
        "setups of five missions",
        ("sim/setting.py", "sim/errand_setting.py", "sim/delivery_setting.py",
         "sim/grid_setting.py", "sim/drill_setting.py"),
        ("sim/scenarios/fleet_setup.py", "sim/scenarios/field_setup.py",
         "sim/scenarios/navigation_setup.py", "sim/scenarios/delivery_setup.py",
         "sim/scenarios/coverage_setup.py", "sim/scenarios/protocol_setup.py"),
    ),
    Item(
        "loaders of scenarios",
        ("sim/scenario.py", "sim/errand_scenario.py", "sim/warehouse_scenario.py", "sim/arena.py"),
        ("sim/scenarios/*scenario*.py",),
    ),
    Item(
        "worlds of the protocol mission",
        ("sim/parade.py", "sim/drill.py", "tools/bench/drill.py"),
        ("sim/world/protocol_world.py", "tools/bench/drill.py"),
    ),
    Item(
        "layouts of frames, codec, signals",
        ("protocol/*_frames.py", "protocol/signals.py", "protocol/messages.py",
         "protocol/codec.py"),
        ("protocol/frames/*",),
    ),
    Item(
        "routers of messages, runner, batching",
        ("agent/core.py", "agent/hearing.py", "agent/shell.py", "agent/segment_peer.py",
         "agent/ports.py", "protocol/bus.py"),
        ("agent/peer/peer.py", "agent/peer/part.py", "agent/peer/routing.py",
         "agent/runtime/peer_runner.py", "agent/segments/segment_parts.py",
         "agent/interface/ports.py", "protocol/links/bus.py", "sim/fleet/batched_runner.py"),
    ),
    Item(
        "linear assignment, searches over grids",
        ("agent/assignment.py", "agent/coverage_cut.py", "agent/coverage_walk.py",
         "agent/coverage_step.py", "agent/pibt.py", "agent/turn_search.py", "agent/frontier.py",
         "agent/nav_mesh.py", "agent/grid_search.py", "sim/grid_judge.py"),
        ("agent/mapf/linear_assignment.py", "agent/coverage/walk_cut.py",
         "agent/coverage/walk.py", "agent/coverage/team_step.py", "agent/mapf/pibt.py",
         "agent/paths/hybrid_a_star.py", "agent/exploration/frontier.py",
         "agent/paths/nav_mesh.py", "agent/paths/theta_star.py", "sim/world/plan_judge.py"),
    ),
)  # fmt: skip
# Names without a caller in the product, by their file then.
DEAD = {
    "sim/checkers.py": "ContactChecker CoverageChecker",
    "agent/membership.py": "pose",
    "protocol/map_sync.py": "awaits",
    "agent/task_book.py": "free_number",
    "crdt/sighting.py": "faded",
    "agent/route.py": "straight",
    "agent/theta_star.py": "plan_lazy",
    "agent/grid_search.py": "_settle",
    "protocol/address.py": "holders",
    "crdt/clock.py": "retire is_retired merge covers happens_before concurrent_with",
}
CALLED = ("straight",)  # of them, by now
MOVED = {
    "agent/task_book.py": ("task_registry.py",),
    "agent/theta_star.py": ("any_angle_planner.py",),
    "agent/grid_search.py": ("theta_star.py",),
}  # new names of the files; the others kept theirs


def at(commit: str) -> Texts:
    """The Python files of the product at a commit."""
    listed = _git("ls-tree", "-r", "--name-only", commit).splitlines()
    return {path: _git("show", f"{commit}:{path}") for path in listed if _of_product(path)}


def now() -> Texts:
    """The Python files of the product in the working tree."""
    found = {p.relative_to(ROOT).as_posix(): p for p in sorted(ROOT.glob("*/**/*.py"))}
    return {path: p.read_text(encoding="utf-8") for path, p in found.items() if _of_product(path)}


def _git(*words: str) -> str:
    return subprocess.run(
        ["git", *words], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout


def _of_product(path: str) -> bool:
    return path.endswith(".py") and any(fnmatch(path, pattern) for pattern in PRODUCT)


def lines(texts: Texts, patterns: Iterable[str]) -> int:
    """Lines of code in the files that a pattern fits. Raises LookupError if one fits no file."""
    fitting: set[str] = set()
    for pattern in patterns:
        found = {path for path in texts if fnmatch(path, pattern)}
        if not found:
            raise LookupError(f"no file {pattern}")
        fitting |= found
    return sum(lines_of_code(texts[path]) for path in fitting)


def frames(texts: Texts) -> int:
    """Number of classes of values that frames carry."""
    return sum(
        isinstance(node, ast.ClassDef) and "NamedTuple" in map(ast.unparse, node.bases)
        for path, text in texts.items()
        if path.endswith("_frames.py") and path.startswith("protocol/")
        for node in ast.parse(text).body
    )


def definitions(text: str) -> Iterator[tuple[str, int]]:
    """Name and number of lines of each class, function and method."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            yield node.name, (node.end_lineno or node.lineno) - node.lineno + 1


class Row(NamedTuple):
    """Lines of code of one item: at `THEN`, at `REBUILT` and now."""

    what: str
    counts: list[int]
    note: str = ""


def rows() -> Iterator[Row]:
    """Every item, the aliases, the names without a caller, and the whole product."""
    old, rebuilt, new = at(THEN), at(REBUILT), now()
    every = (old, rebuilt, new)
    for item in ITEMS:
        kinds = [frames(texts) for texts in every]
        note = "{} kinds of frames, {}, and {}".format(*kinds) if "frames" in item.now[0] else ""
        today = [lines(texts, item.now) for texts in (rebuilt, new)]
        yield Row(item.what, [lines(old, item.then), *today], note)
    yield Row("aliases of a pair of floats", [_aliases(texts) for texts in every])
    dead = [sum(size for _, _, size in _dead(texts)) for texts in every]
    yield Row("names without a caller", dead, _still_there(new))
    shipped = [
        {path: text for path, text in texts.items() if not path.startswith("tools/bench/")}
        for texts in every
    ]
    yield Row("all of the product, without benches", [lines(texts, ["*"]) for texts in shipped])


def _aliases(texts: Texts) -> int:
    return sum(len(ALIAS.findall(text)) for text in texts.values())


def _dead(texts: Texts) -> Iterator[tuple[str, str, int]]:
    """File, name and lines of each definition listed in `DEAD` that is there, also where its file
    has moved to."""
    for then_path, names in DEAD.items():
        stems = (then_path.rpartition("/")[2], *MOVED.get(then_path, ()))
        for path, text in texts.items():
            if path.rpartition("/")[2] in stems:
                for name, size in definitions(text):
                    if name in names.split():
                        yield path, name, size


def _still_there(texts: Texts) -> str:
    """Which of the listed names are there, and which of them have callers by now."""
    names = [name for _, name, _ in _dead(texts)]
    called = [name for name in names if name in CALLED]
    told = "left: " + " ".join(name for name in names if name not in CALLED)
    return f"{told}; with callers by now: {' '.join(called)}" if called else told


def main() -> None:
    """Print the table."""
    print(f"| what | {THEN} | {REBUILT} | now | |\n|---|---:|---:|---:|---|")
    for row in rows():
        print(f"| {row.what} | {' | '.join(f'{count:,}' for count in row.counts)} | {row.note} |")


if __name__ == "__main__":
    main()
