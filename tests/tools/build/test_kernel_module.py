"""A fleet whose kernels were made before does what one does whose kernels numba compiles, bit for bit."""

import subprocess
import sys
from pathlib import Path

import pytest

PLAY = """
import sys
from pathlib import Path

def play():
    from sim.runs.field_run import FieldRun
    from sim.scenarios.field_setup import FieldSetup
    from sim.scenarios.scenario import load
    hashes = []
    for drive in ("mecanum", "differential", "ackermann"):
        yard = load("yard").with_engine("contact_free").changed(2, 7, drive=drive, time_limit_s=40.0)
        hashes.append(FieldRun(FieldSetup(yard)).run().trace_hash)
    return hashes

how, folder = sys.argv[1], Path(sys.argv[2])
if how == "made":
    from tools.build.kernel_module import make
    make(folder, lambda: play())
if how == "ready":
    from agent.kernels import kernel
    from agent.runtime.ready_kernels import ReadyKernels, use_ready_kernels
    kernel.numba_knowing_kernels()  # the kernels of the simulator are numba's
    missing = []
    ReadyKernels.on_missing = lambda self, kernel, kinds, values: missing.append((kernel.name, kinds))
    assert use_ready_kernels(folder)
    print(*play())
    assert not missing, missing
if how == "numba":
    print(*play())
"""


def said(how: str, folder: Path) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", PLAY, how, str(folder)], capture_output=True, text=True, timeout=1200
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.slow
def test_ready_kernels_and_numba_give_equal_traces(tmp_path: Path) -> None:
    said("made", tmp_path)
    ready = said("ready", tmp_path)
    assert len(ready) == 3 and ready == said("numba", tmp_path)
