"""A measurement in a process of its own: what is imported compiled stays so in the one that asks."""

import json
import os
import subprocess
import sys
from typing import Any

from tools.build.compiled_core import OFF
from tools.common.child_process import ROOT


def in_fresh_process(module: str, *words: str, interpreted: bool = False) -> Any:
    """What a module prints as JSON when it is run with these words. `interpreted`: without a compiled
    core, as robots run. Raises CalledProcessError."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **({OFF: "1"} if interpreted else {})}
    done = subprocess.run(
        [sys.executable, "-m", module, *words], env=environment, cwd=ROOT,
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return json.loads(done.stdout)
