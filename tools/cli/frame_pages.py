"""The page of frames, printed from the declarations in `protocol/frames/`."""

from inspect import getdoc
from typing import Any

from protocol.frames.layout import FrameField, FrameLayout
from protocol.frames.messages import GROUPS

LARGE = 1 << 16  # a number from here on is written as a power of two


def frames() -> str:
    """Every frame: number, priority, sender, what it is for, and its fields bit by bit."""
    rows = [
        f"| [{g.name}](#{g.name.lower()}) | {g.pgn:#06x} | {g.priority} | {_sender(g)} | "
        f"{_first(g.kind)} |"
        for g in GROUPS
    ]
    parts = [
        "# Frames", "",
        "Classic CAN with 29-bit identifiers (ISO 11783-3): priority, parameter group, source address. "
        "Words are little-endian; bit 0 is the lowest bit of byte 0. A frame with a value that is not "
        "listed here is counted and ignored. `headland dbc` writes the same for other tools.", "",
        "| frame | PGN | priority | sender | what it is |", "|---|---|---|---|---|", *rows, "",
    ]  # fmt: skip
    for group in GROUPS:
        head = (
            f"PGN {group.pgn:#06x}, priority {group.priority}, {group.length} bytes, "
            f"sent by {_sender(group)}."
        )
        table = ["| bits | field | value | meaning |", "|---|---|---|---|"]
        table += [_row(field, start) for field, start in group.placed()]
        parts += [f"## {group.name}", "", getdoc(group.kind) or "", "", head, "", *table, ""]
    return "\n".join(parts)


def _first(kind: type) -> str:
    """The first sentence of what stands in the code."""
    return (getdoc(kind) or "").splitlines()[0].split(". ")[0].rstrip(".").replace("|", "\\|")


def _sender(group: FrameLayout[Any]) -> str:
    return f"{group.sender}s" if group.sender else "any device"


def _row(field: FrameField, start: int) -> str:
    """A field's row in the table of its frame."""
    end = start + field.width - 1
    bits = f"{start}" if start == end else f"{start} to {end}"
    if field.reserved is not None:
        value = f"{field.reserved:#x}" if field.reserved else "0"
        return f"| {bits} | reserved | {value} | {'' if field.accepted else 'ignored'} |"
    meaning = field.meaning.replace("|", "\\|")
    return f"| {bits} | {field.name} | {_values(field)} | {meaning} |"


def _values(field: FrameField) -> str:
    """The values of a field, in words."""
    if field.choices:
        listed = ", ".join(f"{raw} {name}" for raw, name in field.choices)
        complete = field.accepted is not None or len(field.choices) == 1 << field.bits
        return listed if complete else f"{listed}; others are allowed"
    if field.octets:
        return f"{field.repeat} bytes"
    if field.repeat:
        return f"{field.repeat} numbers of {field.bits} bits"
    if field.boolean:
        return "0 or 1"
    if field.parts:
        return f"0 to {field.parts}, in 1/{field.parts}"
    if field.scale != 1:
        first = f" from {field.offset:g} {field.unit}" if field.offset else ""
        return f"steps of {field.scale:.4g} {field.unit}{first}"
    low, high = (field.accepted[0], field.accepted[-1]) if field.accepted else (0, None)
    if high is None:
        high = (1 << field.bits) - 1
        top = f"2^{field.bits} - 1" if high >= LARGE else f"{high}"
    else:
        top = f"{high}"
    return f"{low} to {top} {field.unit}".rstrip()
