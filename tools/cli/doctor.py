"""`headland doctor`: what this machine has of what runs, launches and bus tools need."""

import importlib.util
import os
import shutil
import socket
import sys
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from sim.files.strict_json import dumps
from tools.build.compiled_core import place
from tools.build.kernel_cache import kernels_kept
from tools.cli.panels import CAN_FILES, can_defaults, version_text
from tools.common.bus_address import AttachError, address_of_launch
from tools.common.compiled_caches import kernels_not_kept
from tools.common.extras import EXTRA_OF
from tools.common.findings import Finding, print_findings

FREE_BYTES_MIN = 1 << 30  # a day's run with all its logs
PYTHON_MIN = (3, 11)
NETWORK = Path("/sys/class/net")  # of Linux: its CAN interfaces have type 280
CAN_TYPE = "280"


def doctor(as_json: bool) -> int:
    """The exit code of `headland doctor`: 1 if something that every run needs is missing."""
    findings = [look() for look in LOOKS] + [
        _extra(extra) for extra in sorted(set(EXTRA_OF.values()))
    ]
    bad = [finding for finding in findings if finding.ok is False]
    if as_json:
        print(dumps({"ready": not bad, "findings": [finding._asdict() for finding in findings]}))
        return 1 if bad else 0
    console = Console(highlight=False)
    print_findings(console, findings)
    console.print("ready" if not bad else f"not ready: {', '.join(f.what for f in bad)}")
    return 1 if bad else 0


def _python() -> Finding:
    now = ".".join(map(str, sys.version_info[:3]))
    return Finding("Python", sys.version_info >= PYTHON_MIN, f"{now}, {version_text()}")


def _cores() -> Finding:
    cores = os.cpu_count() or 1
    return Finding("cores", True if cores > 1 else None, str(cores))


def _disk() -> Finding:
    free = shutil.disk_usage(".").free
    writable = os.access(".", os.W_OK)
    said = f"{free / 2**30:.0f} GiB free" + ("" if writable else ", but not writable")
    return Finding("this folder", writable and free >= FREE_BYTES_MIN, said)


def _loopback() -> Finding:
    try:
        with socket.socket() as listener:
            listener.bind(("127.0.0.1", 0))
    except OSError as problem:
        return Finding("loopback", False, f"no port can be opened: {problem}")
    return Finding("loopback", True, "ports can be opened: bus hub, map")


def _kernels() -> Finding:
    if kernels_not_kept() and importlib.util.find_spec("numba") is not None:
        said = (
            "cannot be kept, no folder for them can be written: set NUMBA_CACHE_DIR to one that can"
        )
        return Finding("kernels", None, f"{said}; else every run takes 25 s longer")
    kept = kernels_kept()
    if kept is None:
        return Finding("kernels", None, "none: only the tools of the bus are installed")
    if kept:
        return Finding("kernels", True, f"{kept} are compiled")
    return Finding(
        "kernels",
        None,
        "not compiled: the first run takes 25 s longer (headland compile --kernels)",
    )


def _core() -> Finding:
    kept = place().exists()
    return Finding("compiled core", None, "present" if kept else "none: campaigns run interpreted")


def _can() -> Finding:
    found = []
    for kind in NETWORK.glob("*/type"):
        if kind.read_text(encoding="ascii").strip() == CAN_TYPE:
            found.append(kind.parent.name)
    return Finding("CAN interfaces", None, ", ".join(sorted(found)) or "none; launches need none")


def _can_settings() -> Finding:
    names = ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_BITRATE")
    told = [f"{name}={os.environ[name]}" for name in names if name in os.environ]
    told += [f"{key} = {value} (file)" for key, value in can_defaults().items()]
    return Finding("python-can", None, ", ".join(told) or f"no settings in {', '.join(CAN_FILES)}")


def _launch() -> Finding:
    try:
        host, port, channel = address_of_launch()
    except AttachError as problem:
        return Finding("launch", None, str(problem))
    return Finding("launch", True, f"{channel} at {host}:{port}")


def _extra(extra: str) -> Finding:
    wanted = [package for package, own in EXTRA_OF.items() if own == extra]
    missing = [package for package in wanted if importlib.util.find_spec(package) is None]
    said = f"missing {', '.join(missing)}: pip install 'headland[{extra}]'" if missing else "there"
    return Finding(f"headland[{extra}]", None if missing else True, said)


LOOKS: tuple[Callable[[], Finding], ...] = (
    _python, _cores, _disk, _loopback, _kernels, _core, _can, _can_settings, _launch,
)  # fmt: skip
