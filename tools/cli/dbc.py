"""`headland dbc`: every frame for tools of other makers (cantools, SavvyCAN, CANalyzer, can-utils).

The text of a DBC is written here, because the format is only a page long and the interface of the
writer of cantools has changed over the years. So our tests can use cantools as an independent judge.
KCD and SYM are converted from the DBC by cantools, ARXML is written by `tools/cli/arxml.py`.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from protocol.frames.layout import Signal
from protocol.frames.messages import GROUPS
from tools.cli.defined_frames import (
    CYCLE_MS,
    AddressesError,
    addresses_of,
    comment_of,
    definitions,
    nodes_of,
    signals_of_groups,
)
from tools.common.exit_codes import code_of, wrong
from tools.common.extras import needed

EXTENDED = 1 << 31  # how DBC files mark a 29-bit identifier
CYCLE_MAX_MS = 65_535
START_MAX = (1 << 48) - 1  # the longest run of reserved bits
FORMATS = ("StandardCAN", "ExtendedCAN", "reserved", "J1939PG")
CONVERTED = (".kcd", ".sym")
UNWRITTEN = (".xml", ".cdd", ".xls", ".xlsx", ".ldf")


def dbc(out: Path | None, addresses: str | None = None, as_json: bool = False) -> int:
    """Print the DBC, or write it to `out`. The exit code is 2 or 75 if that cannot be written. `as_json`:
    an object with the number of frames, and the file or its text."""
    try:
        if out is not None and out.suffix.lower() in UNWRITTEN:
            return wrong(f"{out}: write .dbc, .arxml, .kcd or .sym")
        suffix = "" if out is None else out.suffix.lower()
        robots = addresses_of(addresses) if addresses else ()
        if suffix == ".arxml":
            from tools.cli.arxml import to_arxml  # and a parser of XML

            text = to_arxml(robots)
        else:
            text = to_dbc(robots, suffix == ".sym")
        if out is None:
            if as_json:
                _print_json({"frames": len(GROUPS), "text": text})
            else:
                print(text, end="")
            return 0
        if suffix in CONVERTED:
            text = _converted(text, suffix)
        from sim.files.whole_file import write_whole  # not before it is needed: a quick start

        write_whole(out, text)
    except AddressesError as problem:
        return wrong(f"--addresses: {problem}")
    except ImportError as problem:
        line = needed(problem)
        if line is None:
            raise
        return wrong(f"{out}: {line}")
    except OSError as problem:
        where = "standard output" if out is None else out
        return wrong(f"{where}: cannot be written: {problem.strerror}", code_of(problem))
    if as_json:
        _print_json({"frames": len(GROUPS), "file": str(out)})
    else:
        print(f"{len(GROUPS)} frames in {out}")
    return 0


def _print_json(found: dict[str, object]) -> None:
    from sim.files.strict_json import dumps  # not before it is asked for: a quick start

    print(dumps(found))


def _converted(text: str, suffix: str) -> str:
    from cantools.database.can import Database

    database = Database()
    database.add_dbc_string(text)
    return str(database.as_kcd_string() if suffix == ".kcd" else database.as_sym_string())


def to_dbc(addresses: Sequence[int] = (), one_list: bool = False) -> str:
    """The text of the file. `one_list`: for formats with one list of signals for all frames, a name
    that means different things in different groups gets the name of the group added.

    `addresses`: as `tools/cli/defined_frames.py` says.
    """
    return "\n".join(_lines(addresses, one_list)) + "\n"


def _lines(addresses: Sequence[int], one_list: bool) -> Iterator[str]:
    defined = [
        each._replace(identifier=each.identifier | EXTENDED) for each in definitions(addresses)
    ]
    signals = signals_of_groups(one_list)
    yield 'VERSION "headland"'
    yield ""
    yield "NS_ :"
    yield ""
    yield "BS_:"
    yield ""
    yield "BU_: " + " ".join(nodes_of(addresses))
    for group, name, identifier, sender in defined:
        yield ""
        yield f"BO_ {identifier} {name}: {group.length} {sender or 'Vector__XXX'}"
        yield from (_signal(signal) for signal in signals[group])
    yield ""
    for group, _, identifier, _ in defined:
        yield f'CM_ BO_ {identifier} "{_quoted(comment_of(group))}";'
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
    for group, _, identifier, _ in defined:
        if group in CYCLE_MS:
            yield f'BA_ "GenMsgCycleTime" BO_ {identifier} {CYCLE_MS[group]};'
        for signal in (s for s in signals[group] if s.reserved is not None):
            yield f'BA_ "GenSigStartValue" SG_ {identifier} {signal.name} {signal.reserved};'
    for definition in defined:
        yield f'BA_ "VFrameFormat" BO_ {definition.identifier} {FORMATS.index(form)};'
    for group, _, identifier, _ in defined:
        for signal in signals[group]:
            if signal.choices:
                values = " ".join(f'{value} "{name}"' for value, name in reversed(signal.choices))
                yield f"VAL_ {identifier} {signal.name} {values} ;"


def _quoted(text: str) -> str:
    return text.replace('"', "'")


def _signal(signal: Signal) -> str:
    top = ((1 << signal.length) - 1) * signal.scale + signal.offset
    return (
        f" SG_ {signal.name} : {signal.start}|{signal.length}@1+ "
        f"({signal.scale!r},{signal.offset!r}) [{signal.offset!r}|{top!r}] "
        f'"{signal.unit}" Vector__XXX'
    )
