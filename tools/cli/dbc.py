"""`headland dbc`: every frame for tools of other makers (cantools, SavvyCAN, CANalyzer, can-utils).

The text of a DBC is written here, because the format is only a page long and the interface of the
writer of cantools has changed over the years. So our tests can use cantools as an independent judge.
KCD and SYM are converted from the DBC by cantools.
"""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from agent.interface.config import beat_of
from agent.peer.announcements import MEMBER_EVERY, STANDSTILL_US
from agent.peer.diagnostic_broadcasts import FAULTS_PERIOD_US, HEARTBEAT_PERIOD_MS
from protocol.frames.diagnostic_frames import DM1, STANDARD_HEARTBEAT
from protocol.frames.fleet_frames import HEARTBEAT, MEMBER, POSE, STANDSTILL
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS, Identifier
from protocol.frames.layout import GATEWAY, ROBOT, TOOL, FrameLayout, Signal
from protocol.frames.messages import GROUPS
from protocol.frames.safety_frames import ALL_IMPLEMENTS_STOP
from tools.common.extras import needed

EXTENDED = 1 << 31  # how DBC files mark a 29-bit identifier
NODES = (ROBOT, TOOL, GATEWAY)
# Of a fleet of up to 30 robots, in calm; STANDSTILL and DM1 while a robot stands, the standard stop
# while it is latched, the standard heartbeat while it is asked for.
CYCLE_MS: dict[FrameLayout[Any], int] = {
    POSE: beat_of(1).pose_period_us // 1000,
    HEARTBEAT: beat_of(1).heartbeat_period_us // 1000,
    MEMBER: MEMBER_EVERY * beat_of(1).heartbeat_period_us // 1000,
    STANDSTILL: STANDSTILL_US // 1000,
    ALL_IMPLEMENTS_STOP: 1000,
    DM1: FAULTS_PERIOD_US // 1000,
    STANDARD_HEARTBEAT: HEARTBEAT_PERIOD_MS,
}
CYCLE_MAX_MS = 65_535
START_MAX = (1 << 48) - 1  # the longest run of reserved bits
FORMATS = ("StandardCAN", "ExtendedCAN", "reserved", "J1939PG")
NAME_MAX = 32  # characters of a name in a DBC
TOOL_ADDRESS: Final = 249  # preferred by the tools of operators
ADDRESSES_MAX: Final = 32  # a DBC for more would have 20,000 frames
CONVERTED = (".kcd", ".sym")
# cantools reads ARXML and does not write it, and what canmatrix 1.3 writes cantools 45 refuses.
UNWRITTEN = (".arxml", ".xml", ".cdd", ".xls", ".xlsx", ".ldf")


class AddressesError(Exception):
    """A range of addresses that cannot be used; the text says why."""


class Definition(NamedTuple):
    """One frame of the file: a group as one device sends it to one other."""

    group: FrameLayout[Any]
    name: str
    identifier: int
    sender: str  # node; "": any


def addresses_of(text: str) -> Sequence[int]:
    """The addresses of `128-133` or `128,130-131`. Raises AddressesError.

    >>> list(addresses_of("128,130-131"))
    [128, 130, 131]
    """
    found: set[int] = set()
    for part in text.split(","):
        first, to, last = part.strip().partition("-")
        try:
            run = range(int(first), int(last if to else first) + 1)
        except ValueError:
            raise AddressesError(
                f"{part!r} is no address, as 128, and no range, as 128-133"
            ) from None
        if not run or run[0] < 0 or run[-1] >= NULL_ADDRESS:
            raise AddressesError(
                f"{part}: addresses are 0 to {NULL_ADDRESS - 1}, the lower one first"
            )
        found |= set(run)
    if len(found) > ADDRESSES_MAX:
        raise AddressesError(f"{len(found)} addresses; {ADDRESSES_MAX} at most")
    return sorted(found)


def dbc(out: Path | None, addresses: str | None = None) -> int:
    """Print the DBC, or write it to `out`. The exit code is 2 if that cannot be written."""
    try:
        if out is not None and out.suffix.lower() in UNWRITTEN:
            known = "cantools reads .arxml but does not write it; " if "arx" in out.suffix else ""
            print(f"headland: {out}: {known}write .dbc, .kcd or .sym", file=sys.stderr)
            return 2
        sym = out is not None and out.suffix.lower() == ".sym"
        text = to_dbc(addresses_of(addresses) if addresses else (), one_list=sym)
        if out is None:
            print(text, end="")
            return 0
        if out.suffix.lower() in CONVERTED:
            text = _converted(text, out.suffix.lower())
        out.write_text(text, encoding="utf-8")
    except AddressesError as problem:
        print(f"headland: --addresses: {problem}", file=sys.stderr)
        return 2
    except ImportError as problem:
        line = needed(problem)
        if line is None:
            raise
        print(f"headland: {out}: {line}", file=sys.stderr)
        return 2
    except OSError as problem:
        print(f"headland: {out}: cannot be written: {problem.strerror}", file=sys.stderr)
        return 2
    print(f"{len(GROUPS)} frames in {out}")
    return 0


def _converted(text: str, suffix: str) -> str:
    from cantools.database.can import Database

    database = Database()
    database.add_dbc_string(text)
    return str(database.as_kcd_string() if suffix == ".kcd" else database.as_sym_string())


def to_dbc(addresses: Sequence[int] = (), one_list: bool = False) -> str:
    """The text of the file. `one_list`: for formats with one list of signals for all frames, a name
    that means different things in different groups gets the name of the group added.

    Without `addresses`, source address 254 and destination 255 stand for any, as J1939 files do.
    With them, each frame has its exact identifier, once for each sender and receiver that it may
    have: these addresses, the tools' address 249, and all.
    """
    return "\n".join(_lines(addresses, one_list)) + "\n"


def _definitions(addresses: Sequence[int]) -> Iterator[Definition]:
    if not addresses:
        for group in GROUPS:
            yield _definition(group, group.name, GLOBAL_ADDRESS, NULL_ADDRESS, group.sender)
        return
    for group in GROUPS:
        for source in _sources(group, addresses):
            node = "" if source == NULL_ADDRESS else _node(source)
            name = f"{group.name}_{source}"
            if not _addressed(group):
                yield _definition(group, name, GLOBAL_ADDRESS, source, node)
                continue
            for destination in (*addresses, TOOL_ADDRESS, GLOBAL_ADDRESS):
                if destination != source:
                    yield _definition(group, f"{name}_{destination}", destination, source, node)


def _sources(group: FrameLayout[Any], addresses: Sequence[int]) -> Sequence[int]:
    """The addresses from which a group is sent. Robots pass on some groups of tools. Before its claim
    a tool sends from the null address."""
    if group.sender in (ROBOT, GATEWAY):
        return addresses
    return sorted({*addresses, TOOL_ADDRESS, NULL_ADDRESS})


def _addressed(group: FrameLayout[Any]) -> bool:
    return group.pgn >> 8 & 0xFF < 240


def _node(address: int) -> str:
    return f"address_{address}"


def _definition(
    group: FrameLayout[Any], name: str, destination: int, source: int, sender: str
) -> Definition:
    assert len(name) <= NAME_MAX, name
    identifier = Identifier(group.priority, group.pgn, destination, source).pack() | EXTENDED
    return Definition(group, name, identifier, sender)


def _signals(one_list: bool) -> dict[FrameLayout[Any], list[Signal]]:
    found = {group: group.signals() for group in GROUPS}
    if not one_list:
        return found
    kinds: dict[str, set[Signal]] = {}
    for signals in found.values():
        for signal in signals:
            kinds.setdefault(signal.name, set()).add(signal._replace(start=0, meaning=""))
    return {
        group: [
            each._replace(name=f"{each.name}_{group.name.lower()}")
            if len(kinds[each.name]) > 1
            else each
            for each in signals
        ]
        for group, signals in found.items()
    }


def _lines(addresses: Sequence[int], one_list: bool) -> Iterator[str]:
    definitions, signals = list(_definitions(addresses)), _signals(one_list)
    nodes: Sequence[str] = NODES
    if addresses:
        nodes = [_node(each) for each in sorted({*addresses, TOOL_ADDRESS})]
    yield 'VERSION "headland"'
    yield ""
    yield "NS_ :"
    yield ""
    yield "BS_:"
    yield ""
    yield "BU_: " + " ".join(nodes)
    for group, name, identifier, sender in definitions:
        yield ""
        yield f"BO_ {identifier} {name}: {group.length} {sender or 'Vector__XXX'}"
        yield from (_signal(signal) for signal in signals[group])
    yield ""
    for group, _, identifier, _ in definitions:
        yield f'CM_ BO_ {identifier} "{_comment(group)}";'
        for signal in signals[group]:
            yield f'CM_ SG_ {identifier} {signal.name} "{_quoted(signal.meaning)}";'
    # Exact identifiers are compared whole; a parameter group only by its own bits.
    form = "ExtendedCAN" if addresses else "J1939PG"
    names = ",".join(f'"{each}"' for each in FORMATS)
    yield f'BA_DEF_ BO_ "VFrameFormat" ENUM {names};'
    yield 'BA_DEF_ "ProtocolType" STRING ;'
    yield f'BA_DEF_DEF_ "VFrameFormat" "{form}";'
    yield 'BA_DEF_DEF_ "ProtocolType" "";' if addresses else 'BA_DEF_DEF_ "ProtocolType" "J1939";'
    if not addresses:
        yield 'BA_ "ProtocolType" "J1939";'
    yield f'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 {CYCLE_MAX_MS};'
    yield 'BA_DEF_DEF_ "GenMsgCycleTime" 0;'
    yield f'BA_DEF_ SG_ "GenSigStartValue" INT 0 {START_MAX};'
    yield 'BA_DEF_DEF_ "GenSigStartValue" 0;'
    for group, _, identifier, _ in definitions:
        if group in CYCLE_MS:
            yield f'BA_ "GenMsgCycleTime" BO_ {identifier} {CYCLE_MS[group]};'
        for signal in (s for s in signals[group] if s.reserved is not None):
            yield f'BA_ "GenSigStartValue" SG_ {identifier} {signal.name} {signal.reserved};'
    for definition in definitions:
        yield f'BA_ "VFrameFormat" BO_ {definition.identifier} {FORMATS.index(form)};'
    for group, _, identifier, _ in definitions:
        for signal in signals[group]:
            if signal.choices:
                values = " ".join(f'{value} "{name}"' for value, name in reversed(signal.choices))
                yield f"VAL_ {identifier} {signal.name} {values} ;"


def _comment(group: FrameLayout[Any]) -> str:
    """The first paragraph of what the code says about a frame."""
    return _quoted(" ".join((group.kind.__doc__ or "").split("\n\n", 1)[0].split()))


def _quoted(text: str) -> str:
    return text.replace('"', "'")


def _signal(signal: Signal) -> str:
    top = ((1 << signal.length) - 1) * signal.scale + signal.offset
    return (
        f" SG_ {signal.name} : {signal.start}|{signal.length}@1+ "
        f"({signal.scale!r},{signal.offset!r}) [{signal.offset!r}|{top!r}] "
        f'"{signal.unit}" Vector__XXX'
    )
