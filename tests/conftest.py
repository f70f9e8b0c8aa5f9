"""Marks tests by what their module imports, so that nobody has to remember to mark one.

`process`: starts processes. `fleet`: several peers in a simulated world. The rest are unit tests: values
in, values out. `make fast` runs only those. CONTRIBUTING.md has the commands.

`sampled(n)`: of this test with many values, `make test` plays the first `n` and `make slow` the others.
"""

import re
import signal
from collections import Counter
from functools import cache
from pathlib import Path

import pytest
from hypothesis import settings

from tests.examples import QUICK, THOROUGH

# An example that takes long, on a busy machine or where a kernel is compiled, is not wrong.
# `make slow` and `make coverage` choose the profile `thorough`.
settings.register_profile("quick", deadline=None, max_examples=QUICK)
settings.register_profile("thorough", deadline=None, max_examples=THOROUGH)
settings.load_profile("quick")

# A shell starts background jobs with SIGINT ignored, which children inherit. Tests interrupt theirs.
signal.signal(signal.SIGINT, signal.default_int_handler)

PROCESS = re.compile(
    r"^\s*(?:import (?:subprocess|multiprocessing)|from (?:asyncio\.subprocess|tests\.tools\.launching)"
    r" import|.*\bcreate_subprocess_)", re.M,
)  # fmt: skip
FLEET = re.compile(
    r"^\s*(?:from|import) (?:sim\.(?:fleet|runs|rigs|chaos)|tests\.(?:chaos|protocol\.sync)"
    r"|tools\.(?:run|bench|chaos|livemap))\b", re.M,
)  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    seen: Counter[str] = Counter()
    for item in items:
        for name in kinds(item.path):
            item.add_marker(name)
        sampled = item.get_closest_marker("sampled")
        if sampled is not None:
            test = item.nodeid.partition("[")[0]
            seen[test] += 1
            if seen[test] > sampled.args[0]:
                item.add_marker("slow")


@cache
def kinds(path: Path) -> tuple[str, ...]:
    """The marks of a test module by its imports; none for those of the repository, in `tests/`."""
    if path.parent == Path(__file__).parent or not path.name.startswith("test_"):
        return ()
    text = path.read_text(encoding="utf-8")
    return tuple(
        name for name, rule in (("process", PROCESS), ("fleet", FLEET)) if rule.search(text)
    )
