"""What `cantools decode`, as a person runs it, reads in a log, against what our codec reads."""

import re
import subprocess
import sys
from collections.abc import Mapping
from math import isclose
from pathlib import Path
from typing import Any, NamedTuple

from protocol.frames.codec import Malformed, decode
from protocol.frames.frame import Frame
from protocol.frames.layout import FrameLayout
from protocol.frames.messages import GROUP_OF
from protocol.frames.network_frames import AddressClaimed
from protocol.name import Name
from sim.files.candump import read_candump

ENTRY = re.compile(r"^    (\w+): (\S+?)(?: \S.*)?,?$")  # a signal, its value, and its unit


class Judgement(NamedTuple):
    """Frames of a log, and those in which every signal has the value of our codec."""

    frames: int
    equal: int
    first_difference: str = ""


def judge(log: Path, dbc: Path) -> Judgement:
    """Run `cantools decode DBC < LOG` and compare every value of every frame.

    Raises subprocess.CalledProcessError if cantools fails.
    """
    with log.open() as text:
        said = subprocess.run(
            [sys.executable, "-m", "cantools", "decode", str(dbc)], stdin=text,
            capture_output=True, text=True, check=True,
        ).stdout  # fmt: skip
    frames = [frame for _, frame in read_candump(log)]
    blocks = said.split("\n(")
    equal, first = 0, "" if len(blocks) == len(frames) else f"{len(blocks)} frames were read"
    for frame, block in zip(frames, blocks, strict=False):
        wrong = _difference(frame, block)
        equal += not wrong
        first = first or wrong
    return Judgement(len(frames), equal, first)


def _difference(frame: Frame, block: str) -> str:
    """The first signal that differs; "" if none does."""
    _, message = decode(frame)
    if isinstance(message, Malformed):
        return f"{frame}: we read {message.reason}"
    layout: FrameLayout[Any] = GROUP_OF[type(message)]
    lines = block.splitlines()
    if len(lines) < 2 or not lines[1].startswith(layout.name):
        return f"{frame}: {lines[:2]} instead of {layout.name}"
    found = (ENTRY.match(line) for line in lines[2:])
    told = {match[1]: match[2] for match in found if match is not None}
    expected = expected_values(message)
    for signal in layout.signals():
        value = expected.get(signal.name, signal.reserved)
        if signal.name not in told:
            return f"{frame}: {layout.name} has no {signal.name}"
        if signal.reserved is None and not _same(told[signal.name], value, signal.choices, signal):
            return f"{frame}: {layout.name}.{signal.name} is {told[signal.name]}, not {value}"
    return ""


def _same(told: str, value: Any, choices: Any, signal: Any) -> bool:
    names = {name: raw * signal.scale + signal.offset for raw, name in choices}
    number = names[told] if told in names else float(told)
    return isclose(number, float(value), rel_tol=1e-9, abs_tol=1e-9)


def expected_values(message: Any) -> Mapping[str, Any]:
    """The values of our codec under the names of signals; lists element by element."""
    values: dict[str, Any] = {}
    fields = message._asdict()
    if isinstance(message, AddressClaimed):
        fields = Name.unpack(message.name)._asdict()
    renamed = {f.name: f.signal for f in GROUP_OF[type(message)].fields if f.signal}
    for field, value in fields.items():
        name = renamed.get(field, field)
        if isinstance(value, bytes | tuple):
            values |= {f"{name}_{k}": part for k, part in enumerate(value)}
        else:
            values[name] = value
    return values
