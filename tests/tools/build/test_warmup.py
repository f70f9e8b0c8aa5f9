"""`headland warmup` leaves no kernel for the first minute in the field."""

import subprocess
import sys

import pytest

from tools.build.warmup import FIELD_BESIDE, FIELD_HERE, FIELD_LATER, PARTS

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
