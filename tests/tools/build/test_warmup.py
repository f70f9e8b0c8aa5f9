"""`headland warmup` leaves no kernel for the first minute in the field."""

import subprocess
import sys

CHECK = """
import importlib, pkgutil
import agent, crdt, protocol, sim
from numba.core.dispatcher import Dispatcher
from tools.build.warmup import PARTS

kernels = {}
for package in (agent, crdt, protocol, sim):
    for found in pkgutil.iter_modules(package.__path__):
        module = importlib.import_module(f"{package.__name__}.{found.name}")
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
"""


def test_every_kernel_that_a_robot_calls_is_compiled() -> None:
    done = subprocess.run(
        [sys.executable, "-c", CHECK], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert not done.stdout.split()
