"""Names of instants and durations, and class names of which the product has more than one.

A name that ended in `_us` only would not tell an instant from a duration, and the two must not be
added or compared by mistake.
"""

import ast
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LAYERS = ["crdt", "protocol", "agent", "sim", "tools", "headland"]
TIMED = ["crdt", "protocol", "agent", "sim"]
UNIT = re.compile(r"_(ns|us|ms|s)$")
FORM = re.compile(r"(^|_)(at|for|now)_(ns|us|ms|s)$")
OTHER_UNITS = re.compile(r"_(m|rad|1)_s$")  # metres, radians or one a second

# Words that are an instant or a duration by themselves, before the unit.
WORDS = {
    "t": "the time stamp of an event; also a key of traces and records",
    "period": "a duration by its meaning",
    "timeout": "a duration by its meaning",
    "age": "a duration by its meaning",
    "age_max": "a duration by its meaning",
    "duration": "a duration by its meaning",
    "horizon": "the duration for which collisions are avoided; the word of ORCA",
    "makespan": "the duration of a plan; the word of scheduling",
    "latency": "a duration by its meaning",
    "burst": "bus time that may be used at once; the word of a token bucket",
    "cost": "bus time of a transmission; the word of a token bucket",
    "tokens": "bus time that is left; the word of a token bucket",
    "bit": "the duration of a bit on the bus; the word of CAN",
    "dt": "a time step; the symbol of mechanics",
}
# Whole names. A key keeps its name, because people have written files and read outputs with it.
NAMES = {
    **dict.fromkeys(
        ["arrived_s", "bound_s", "cpu_s", "equal_s", "simulated_s", "time_s", "time_95_s", "waited_s",
         "wall_s"],
        "a key of the JSON result of a run",
    ),
    **dict.fromkeys(
        ["box_s", "boxes_until_s", "by_s", "every_s", "lasting_s", "random_over_s", "time_limit_s",
         "until_s"],
        "a key of scenario files",
    ),
    **dict.fromkeys(
        ["battery_s", "charge_s", "dock_s", "handle_s", "standby_s"],
        "a key of robot files, or the same number inside",
    ),
    **dict.fromkeys(["cost_ms", "rate_ms"], "a field of a frame, as documents and DBC files name it"),
    **dict.fromkeys(
        ["after_ms", "before_ms", "both_ms", "charge_ms", "dock_ms", "from_bay_ms", "from_ms",
         "handle_ms", "lead_bay_ms", "lead_ms", "link_ms", "ready_ms", "span_ms", "step_ms", "there_ms",
         "time_ms", "to_bay_ms", "total_ms", "waiting_ms"],
        "a term of a routing problem; all of its times are durations from now",
    ),
}  # fmt: skip

# Class names that more than one module of the product defines, with the reason why that is clear.
SHARED = {
    "FleetTable": "the table [fleet] of robot files; that of scenarios extends it",
    "WarehouseTable": "the table [warehouse] of robot files; that of scenarios extends it",
}


def _files(layers: Iterable[str] = TIMED) -> Iterator[Path]:
    for layer in layers:
        yield from sorted((ROOT / layer).rglob("*.py"))


def _names(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Parameters, functions, attributes and variables of a module, with their lines."""
    for node in ast.walk(tree):
        match node:
            case ast.arg(arg=name, lineno=line):
                yield name, line
            case ast.FunctionDef(name=name, lineno=line):
                yield name, line
            case ast.AsyncFunctionDef(name=name, lineno=line):
                yield name, line
            case ast.Attribute(attr=name, ctx=ast.Store(), lineno=line):
                yield name, line
            case ast.Name(id=name, ctx=ast.Store(), lineno=line):
                yield name, line


def _plain(name: str) -> str:
    return name.lstrip("_")


def _is_clear(name: str) -> bool:
    """Whether a name ends as an instant or a duration does, or is no time at all."""
    name = _plain(name)
    if name.isupper() or not UNIT.search(name) or OTHER_UNITS.search(name) or FORM.search(name):
        return True
    stem = UNIT.sub("", name)
    return name in NAMES or any(stem == word or stem.endswith(f"_{word}") for word in WORDS)


def test_instants_end_in_at_and_durations_in_for() -> None:
    wrong = [
        f"{path.relative_to(ROOT)}:{line} {name}: instants end in _at_us, durations in _for_us"
        for path in _files()
        for name, line in _names(ast.parse(path.read_text()))
        if not _is_clear(name)
    ]
    assert not wrong, "\n".join(wrong)


def test_every_accepted_name_of_a_time_is_in_use() -> None:
    used = {_plain(name) for path in _files() for name, _ in _names(ast.parse(path.read_text()))}
    stems = {UNIT.sub("", name) for name in used if UNIT.search(name)}
    unused = {name for name in NAMES if name not in used} | {
        word for word in WORDS if not any(s == word or s.endswith(f"_{word}") for s in stems)
    }
    assert not unused, f"remove from the lists: {sorted(unused)}"


@pytest.mark.parametrize(
    ("name", "clear"),
    [
        ("due_at_us", True),
        ("_silence_for_us", True),
        ("now_s", True),
        ("STOP_REPEAT_US", True),
        ("pose_period_us", True),
        ("speed_m_s", True),
        ("last_us", False),
        ("seen_us", False),
        ("deadline_us", False),
    ],
)
def test_what_the_rule_finds(name: str, clear: bool) -> None:
    assert _is_clear(name) == clear


def _class_names() -> dict[str, list[str]]:
    """The modules that define each class name; classes inside classes and functions do not count."""
    modules = defaultdict(list)
    for path in _files(LAYERS):
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ClassDef):
                modules[node.name].append(str(path.relative_to(ROOT)))
    return modules


def test_a_class_name_means_one_thing() -> None:
    shared = {name: paths for name, paths in _class_names().items() if len(paths) > 1}
    new = {name: paths for name, paths in shared.items() if name not in SHARED}
    assert not new, f"one of each needs a name of its own, or SHARED the reason: {new}"
    gone = SHARED.keys() - shared.keys()
    assert not gone, f"remove from SHARED: {sorted(gone)}"
