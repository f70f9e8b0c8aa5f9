"""`headland warmup` leaves no kernel for the first minute in the field."""

import signal
import subprocess
import sys
from functools import partial
from multiprocessing import Pool

import pytest

from tools.build import warmup
from tools.build.warmup import FIELD_BESIDE, FIELD_HERE, FIELD_LATER, PARTS
from tools.cli.one_line_errors import terminated_as_interrupted

CHECK = """
import importlib, pkgutil
import agent, crdt, protocol, sim
from numba.core.dispatcher import Dispatcher
from tools.build.warmup import PARTS

kernels = {}
for package in (agent, crdt, protocol, sim):
    for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        try:
            module = importlib.import_module(found.name)
        except ImportError:
            continue  # of an extra that is not installed
        for name, value in vars(module).items():
            if isinstance(value, Dispatcher) and value.py_func.__module__ == module.__name__:
                kernels[f"{module.__name__}.{name}"] = value
# A kernel that other kernels call is compiled with them.
called = {name for kernel in kernels.values() for name in kernel.py_func.__code__.co_names}
for _, part in PARTS:
    part()
for name, kernel in sorted(kernels.items()):
    if name.rsplit(".", 1)[1] not in called and not kernel.signatures:
        print(name)
print(len(kernels), "kernels")
"""


@pytest.mark.slow
def test_every_kernel_that_a_robot_calls_is_compiled() -> None:
    done = subprocess.run(
        [sys.executable, "-c", CHECK], capture_output=True, text=True, timeout=1200
    )
    assert done.returncode == 0, done.stderr
    *missing, count = done.stdout.splitlines()
    assert not missing and int(count.split()[0]) > 100, done.stdout


def test_what_a_field_needs_are_parts() -> None:
    assert {*FIELD_HERE, *FIELD_BESIDE, *FIELD_LATER} <= dict(PARTS).keys()
    assert not {*FIELD_HERE} & {*FIELD_BESIDE}, "or both processes compile the same"


@pytest.mark.parametrize("kept", [0, 90])
def test_a_launch_compiles_what_it_needs_and_says_how_far_it_is(
    kept: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It compiled the kernels of all missions, in one process, and said one line in minutes."""
    done: list[str] = []
    beside: list[str] = []
    told: list[tuple[int, int, str]] = []

    class Other:
        def wait(self) -> int:
            done.append("the other process has ended")
            return 0

        def poll(self) -> int:
            return 0

    def start(names: list[str]) -> Other:
        beside.extend(names)
        return Other()

    parts = tuple((name, partial(done.append, name)) for name, _ in PARTS)
    monkeypatch.setattr(warmup, "PARTS", parts)
    monkeypatch.setattr(warmup, "_beside", start)
    monkeypatch.setattr(warmup, "kernels_kept", lambda: kept)
    warmup.warm(steering=False, delivering=False, on_step=lambda *step: told.append(step))
    assert not {"coverage", "exploration", "delivery", "turns", "fields", "fleets"} & {*done}
    assert {*FIELD_HERE, *FIELD_BESIDE, *FIELD_LATER, "map", "wheels", "wire"} <= {*done}
    names = [name for name in done if name in dict(PARTS)]
    assert told == [(k, len(names), name) for k, name in enumerate(names)]
    assert bool(beside) == (kept == 0)
    if beside:
        at = done.index("the other process has ended")
        assert set(done[at + 1 :]) == set(beside) and not {*done[:at]} & {*beside}
    warmup.warm(steering=True, delivering=True)
    assert {"turns", "delivery"} <= {*done}


def test_workers_that_compile_end_by_the_signal_of_their_pool() -> None:
    """`headland compile --kernels` hung once: a worker kept the command's own
    handler, got the signal just as it began to wait for a lock, and waited on."""
    with terminated_as_interrupted(), Pool(1, warmup._leave_signals) as pool:
        assert pool.apply(signal.getsignal, (signal.SIGTERM,)) == signal.SIG_DFL
        assert pool.apply(signal.getsignal, (signal.SIGINT,)) == signal.SIG_IGN
