"""`headland dbc`: every frame for tools nobody here wrote (cantools, SavvyCAN, CANalyzer, can-utils).

The text is written here: the format is a page long, and cantools, whose writer has changed its interface
with the years, stays free to be the judge of it in our tests.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

from protocol.identifier import GLOBAL_ADDRESS, NULL_ADDRESS, Identifier
from protocol.messages import GROUPS, Group
from protocol.signals import SIGNALS, Signal

EXTENDED = 1 << 31  # how DBC files mark a 29-bit identifier
PGN_MASK, ADDRESSED_MASK = 0x03FFFF00, 0x03FF0000
FORMATS = ("StandardCAN", "ExtendedCAN", "reserved", "J1939PG")


def dbc(out: Path | None) -> int:
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


def pgn_key(identifier: int) -> int:
    """What the identifiers of one parameter group have in common, whoever speaks to whomever."""
    addressed = identifier >> 16 & 0xFF < 240
    return identifier & (ADDRESSED_MASK if addressed else PGN_MASK)


def _identifier(group: Group) -> int:
    return Identifier(group.priority, group.pgn, GLOBAL_ADDRESS, NULL_ADDRESS).pack() | EXTENDED


def _lines() -> Iterator[str]:
    yield 'VERSION "headland"'
    yield ""
    yield "NS_ :"
    yield ""
    yield "BS_:"
    yield ""
    yield "BU_:"
    for group in GROUPS:
        yield ""
        yield f"BO_ {_identifier(group)} {group.name}: {group.length} Vector__XXX"
        yield from (_signal(signal) for signal in SIGNALS[group.kind])
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
    for group in GROUPS:
        yield f'BA_ "VFrameFormat" BO_ {_identifier(group)} {FORMATS.index("J1939PG")};'
    for group in GROUPS:
        for signal in SIGNALS[group.kind]:
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
