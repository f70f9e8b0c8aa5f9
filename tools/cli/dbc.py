"""`headland dbc`: every frame for tools of other makers (cantools, SavvyCAN, CANalyzer, can-utils).

The text is written here, because the format is only a page long and the interface of the writer of
cantools has changed over the years. So our tests can use cantools as an independent judge.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from agent.interface.config import beat_of
from protocol.frames.fleet_frames import HEARTBEAT, POSE
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS, Identifier
from protocol.frames.layout import GATEWAY, ROBOT, TOOL, FrameLayout, Signal
from protocol.frames.messages import GROUPS
from protocol.frames.safety_frames import ALL_IMPLEMENTS_STOP

EXTENDED = 1 << 31  # how DBC files mark a 29-bit identifier
NODES = (ROBOT, TOOL, GATEWAY)
# Of a fleet of up to 30 robots, in calm; the standard stop while it is latched.
CYCLE_MS: dict[FrameLayout[Any], int] = {
    POSE: beat_of(1).pose_period_us // 1000,
    HEARTBEAT: beat_of(1).heartbeat_period_us // 1000,
    ALL_IMPLEMENTS_STOP: 1000,
}
CYCLE_MAX_MS = 65_535
START_MAX = (1 << 48) - 1  # the longest run of reserved bits
FORMATS = ("StandardCAN", "ExtendedCAN", "reserved", "J1939PG")


def dbc(out: Path | None) -> int:
    """Print the DBC, or write it to `out`. The exit code is 2 if that cannot be written."""
    if out is None:
        print(to_dbc(), end="")
    else:
        try:
            out.write_text(to_dbc(), encoding="ascii")
        except OSError as problem:
            print(f"headland: {out}: cannot be written: {problem.strerror}", file=sys.stderr)
            return 2
        print(f"{len(GROUPS)} frames in {out}")
    return 0


def to_dbc() -> str:
    """The text of the file. Source address 254 and destination 255 stand for any, as J1939 files do."""
    return "\n".join(_lines()) + "\n"


def _identifier(group: FrameLayout[Any]) -> int:
    return Identifier(group.priority, group.pgn, GLOBAL_ADDRESS, NULL_ADDRESS).pack() | EXTENDED


def _lines() -> Iterator[str]:
    yield 'VERSION "headland"'
    yield ""
    yield "NS_ :"
    yield ""
    yield "BS_:"
    yield ""
    yield "BU_: " + " ".join(NODES)
    for group in GROUPS:
        yield ""
        yield f"BO_ {_identifier(group)} {group.name}: {group.length} {group.sender or 'Vector__XXX'}"
        yield from (_signal(signal) for signal in group.signals())
    yield ""
    for group in GROUPS:
        text = (group.kind.__doc__ or "").split("\n", 1)[0].replace('"', "'")
        yield f'CM_ BO_ {_identifier(group)} "{text}";'
    names = ",".join(f'"{name}"' for name in FORMATS)
    yield f'BA_DEF_ BO_ "VFrameFormat" ENUM {names};'
    yield 'BA_DEF_ "ProtocolType" STRING ;'
    yield 'BA_DEF_DEF_ "VFrameFormat" "J1939PG";'
    yield 'BA_DEF_DEF_ "ProtocolType" "J1939";'
    yield 'BA_ "ProtocolType" "J1939";'
    yield f'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 {CYCLE_MAX_MS};'
    yield 'BA_DEF_DEF_ "GenMsgCycleTime" 0;'
    yield f'BA_DEF_ SG_ "GenSigStartValue" INT 0 {START_MAX};'
    yield 'BA_DEF_DEF_ "GenSigStartValue" 0;'
    for group in GROUPS:
        if group in CYCLE_MS:
            yield f'BA_ "GenMsgCycleTime" BO_ {_identifier(group)} {CYCLE_MS[group]};'
        for signal in (s for s in group.signals() if s.reserved is not None):
            yield f'BA_ "GenSigStartValue" SG_ {_identifier(group)} {signal.name} {signal.reserved};'
    for group in GROUPS:
        yield f'BA_ "VFrameFormat" BO_ {_identifier(group)} {FORMATS.index("J1939PG")};'
    for group in GROUPS:
        for signal in group.signals():
            if signal.choices:
                values = " ".join(f'{value} "{name}"' for value, name in reversed(signal.choices))
                yield f"VAL_ {_identifier(group)} {signal.name} {values} ;"


def _signal(signal: Signal) -> str:
    top = ((1 << signal.length) - 1) * signal.scale + signal.offset
    return (
        f" SG_ {signal.name} : {signal.start}|{signal.length}@1+ "
        f"({signal.scale!r},{signal.offset!r}) [{signal.offset!r}|{top!r}] "
        f'"{signal.unit}" Vector__XXX'
    )
