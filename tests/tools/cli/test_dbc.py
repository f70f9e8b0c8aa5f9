"""A recorded run, read by cantools alone with the DBC we write, against what our codec reads."""

import keyword
import re
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any
from xml.etree import ElementTree

import pytest

from agent.interface.lifecycle import State
from protocol.frames.codec import Malformed, decode, encode
from protocol.frames.fleet_frames import MEMBER, STATES, Member
from protocol.frames.frame import Frame
from protocol.frames.identifier import Identifier
from protocol.frames.messages import GROUPS
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import ALL_IMPLEMENTS_STOP, AllImplementsStop, Switch
from protocol.name import Name
from sim.files.candump import CandumpWriter, read_candump
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tests.tools.documented import blocks, lines_of
from tools.bench.cantools_judge import expected_values, judge
from tools.cli.arxml import to_arxml
from tools.cli.dbc import dbc as dbc_command
from tools.cli.dbc import to_dbc

cantools = pytest.importorskip("cantools", reason="cantools is not installed")


def pgn_key(identifier: int) -> int:
    """What the identifiers of one parameter group have in common, for any sender and receiver."""
    addressed = identifier >> 16 & 0xFF < 240
    return identifier & (0x03FF0000 if addressed else 0x03FFFF00)


@pytest.fixture(scope="module")
def by_group() -> dict[int, Any]:
    database = cantools.database.load_string(to_dbc(), "dbc")
    assert all(m.protocol == "j1939" for m in database.messages)
    return {pgn_key(m.frame_id): m for m in database.messages}


@pytest.fixture(scope="module")
def short_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """From boot into the work: what comes later is of the same kinds."""
    out = tmp_path_factory.mktemp("run")
    scenario = load("small").changed(3, 1)
    limit = scenario.run.model_copy(update={"time_limit_s": 60.0})
    FieldRun(FieldSetup(scenario.model_copy(update={"run": limit})), out).run()
    return out


def compare(identifier: int, data: bytes, by_group: dict[int, Any]) -> str:
    _, ours = decode(Frame(identifier, data))
    assert not isinstance(ours, Malformed), (hex(identifier), data.hex(), ours)
    definition = by_group[pgn_key(identifier)]
    theirs = {
        name: value
        for name, value in definition.decode(data, decode_choices=False).items()
        if not name.startswith("reserved_")
    }
    expected = expected_values(ours)
    assert theirs.keys() == expected.keys()
    for name, value in theirs.items():
        assert value == pytest.approx(float(expected[name]), abs=1e-9), (definition.name, name)
    return str(definition.name)


def test_random_frames_of_every_kind_read_alike(by_group: dict[int, Any]) -> None:
    rng, read = Random(1), Counter[str]()
    for group in GROUPS:
        while read[group.name] < 50:
            data = rng.randbytes(group.length)
            identifier = Identifier(group.priority, group.pgn, 255, rng.randrange(254)).pack()
            if not isinstance(decode(Frame(identifier, data))[1], Malformed):
                read[compare(identifier, data, by_group)] += 1
    assert read.keys() == {group.name for group in GROUPS}


@pytest.mark.slow
def test_a_recorded_run_reads_alike(by_group: dict[int, Any], short_run: Path) -> None:
    read = Counter(
        compare(frame.identifier, frame.data, by_group)
        for _, frame in read_candump(short_run / "can.log")
    )
    for kind in ("POSE", "HEARTBEAT", "TASK_CLAIM", "WORK_PROGRESS", "ADDRESS_CLAIMED", "MEMBER"):
        assert read[kind] > 0, kind


def test_states_are_the_agents() -> None:
    assert tuple((int(state), state.name) for state in State) == STATES


def test_encoded_frames_have_the_identifier_of_their_group(by_group: dict[int, Any]) -> None:
    frame = encode(Member(1, 1, 5), 130)
    assert by_group[pgn_key(frame.identifier)].name == "MEMBER"
    named = {signal.name for signal in MEMBER.signals() if signal.reserved is None}
    assert named == {*Member._fields}


# C17 and C++20; those that are in both stand once.
WORDS = """alignas alignof and and_eq asm auto bitand bitor bool break case catch char char8_t char16_t
char32_t class co_await co_return co_yield compl concept const const_cast consteval constexpr
constinit continue decltype default delete do double dynamic_cast else enum explicit export extern
false float for friend goto if inline int long mutable namespace new noexcept not not_eq nullptr
operator or or_eq private protected public register reinterpret_cast requires restrict return short
signed sizeof static static_assert static_cast struct switch template this thread_local throw true
try typedef typeid typename union unsigned using virtual void volatile wchar_t while xor xor_eq"""
KEYWORDS = frozenset(WORDS.split())


def test_a8_no_signal_is_a_keyword_of_c_or_cpp() -> None:
    names = {signal.name for group in GROUPS for signal in group.signals()}
    assert not names & KEYWORDS and not any(keyword.iskeyword(name) for name in names)


@pytest.mark.parametrize("addresses", [(), pytest.param((128, 129), marks=pytest.mark.slow)])
def test_a8_the_generated_c_source_compiles(addresses: Any, tmp_path: Path) -> None:
    compilers = [c for c in ("gcc", "g++") if shutil.which(c)]
    if not compilers:
        pytest.skip("no C compiler is installed")
    (tmp_path / "headland.dbc").write_text(to_dbc(addresses), encoding="ascii")
    for words in (
        [sys.executable, "-m", "cantools", "generate_c_source", "headland.dbc"],
        *([c, "-c", "-Wall", "-Wextra", "-Werror", "headland.c"] for c in compilers),
    ):
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


def test_a16_the_name_of_a_claim_is_nine_signals(by_group: dict[int, Any]) -> None:
    name = Name(5, 1407, 2, 3, 129, 0, 15, 2, 1)
    claim = encode(AddressClaimed(name.pack()), 249)
    read = by_group[pgn_key(claim.identifier)].decode(claim.data)
    assert {k: v for k, v in read.items() if not k.startswith("reserved")} == name._asdict()


def test_a16_reserved_bits_are_ones_where_an_encoder_of_others_starts(
    by_group: dict[int, Any],
) -> None:
    """Cantools with its start values makes the very bytes that we send."""
    frame = encode(AllImplementsStop(3, Switch.STOP), 130)
    definition = by_group[pgn_key(frame.identifier)]
    values = {signal.name: signal.initial or 0 for signal in definition.signals}
    assert definition.encode({**values, "transition": 3, "state": 0}) == frame.data
    unused = {s.reserved for s in ALL_IMPLEMENTS_STOP.signals()} - {None}
    assert unused == {(1 << 48) - 1, 63}


def test_a16_cycle_times_and_nodes_are_told(by_group: dict[int, Any]) -> None:
    told = {m.name: (m.cycle_time, m.senders) for m in by_group.values()}
    assert told["POSE"] == (50, ["robot"]) and told["HEARTBEAT"] == (500, ["robot"])
    assert told["OPERATOR_COMMAND"][1] == ["tool"] and told["GATEWAY_BEAT"][1] == ["gateway"]


def test_a17_cantools_reads_a_log_as_the_documents_say(short_run: Path, tmp_path: Path) -> None:
    shown = [line for _, block in blocks("use/bus.md") for line in lines_of(block)]
    command = next(line for line in shown if "--frame-id-mask" in line).split(" <")[0]
    (tmp_path / "headland.dbc").write_text(to_dbc(), encoding="ascii")
    with (short_run / "can.log").open() as log:
        done = subprocess.run(
            [sys.executable, *command.split()[1:]], stdin=log, cwd=tmp_path,
            capture_output=True, text=True, check=False,
        )  # fmt: skip
    lines = done.stdout.splitlines()
    assert done.returncode == 0 and len(lines) > 1000, done.stderr
    assert not [line for line in lines if "Unknown frame id" in line]
    assert any("POSE(" in line for line in lines)


@pytest.mark.slow
def test_cantools_decodes_a_run_without_flags_as_we_do(short_run: Path, tmp_path: Path) -> None:
    dbc = tmp_path / "headland.dbc"
    dbc.write_text(to_dbc(range(128, 131)), encoding="utf-8")
    judgement = judge(short_run / "can.log", dbc)
    assert judgement.frames > 1000
    assert judgement.equal == judgement.frames, judgement.first_difference


@pytest.mark.slow
def test_cantools_decodes_every_kind_of_frame_without_flags(tmp_path: Path) -> None:
    """Random frames of every group, between every two addresses that may send and receive it."""
    rng, log = Random(6), tmp_path / "all.log"
    robots = [128, 131]
    writer = CandumpWriter(log)
    for group in GROUPS:
        for _ in range(20):
            sources = robots if group.sender in ("robot", "gateway") else [*robots, 249, 254]
            source = rng.choice(sources)
            to = rng.choice([a for a in (*robots, 249, 255) if a != source])
            identifier = Identifier(group.priority, group.pgn, to, source).pack()
            frame = Frame(identifier, rng.randbytes(group.length))
            while isinstance(decode(frame)[1], Malformed):
                frame = Frame(identifier, rng.randbytes(group.length))
            writer.write(1_000_000, frame)
    writer.close()
    dbc = tmp_path / "headland.dbc"
    dbc.write_text(to_dbc(robots), encoding="utf-8")
    judgement = judge(log, dbc)
    assert judgement.equal == judgement.frames == 20 * len(GROUPS), judgement.first_difference


@pytest.mark.parametrize("addresses", [(), range(128, 134)])
def test_every_signal_has_a_comment_and_every_name_fits(addresses: Any) -> None:
    database = cantools.database.load_string(to_dbc(addresses), "dbc")
    names = [message.name for message in database.messages]
    assert len(set(names)) == len(names) and max(map(len, names)) <= 32
    for message in database.messages:
        assert message.comment and message.is_extended_frame
        for signal in message.signals:
            assert signal.comment and len(signal.name) <= 32, (message.name, signal.name)
    units = {
        f"{m.name}.{s.name}"
        for m in database.messages
        for s in m.signals
        if s.unit is None and s.name.endswith(("_m", "_s", "_ms", "_us", "_rad", "_m_s"))
    }
    assert not units
    pose = next(m for m in database.messages if m.name.startswith("POSE"))
    assert pose.cycle_time == 50
    assert {c: str(n) for c, n in pose.get_signal_by_name("heard").choices.items()} == {255: "NONE"}


@pytest.mark.parametrize("kind", ["kcd", "sym"])
def test_other_formats_say_the_same(kind: str, tmp_path: Path) -> None:
    out = tmp_path / f"headland.{kind}"
    assert dbc_command(out, "128-129") == 0
    theirs = {m.frame_id: m for m in cantools.database.load_file(out).messages}
    ours = cantools.database.load_string(to_dbc((128, 129)), "dbc").messages
    assert theirs.keys() == {m.frame_id for m in ours}
    rng = Random(3)
    for message in ours:
        data = rng.randbytes(message.length)
        expected = message.decode(data, decode_choices=False)
        group = "_" + re.sub(r"(_\d{3})+$", "", message.name).lower()
        read = theirs[message.frame_id].decode(data, decode_choices=False)
        plain = {k if k in expected else k.removesuffix(group): v for k, v in read.items()}
        assert plain == pytest.approx(expected), message.name


SAID_OF_MESSAGES = ("name", "length", "is_extended_frame", "senders")
SAID_OF_SIGNALS = ("start", "length", "byte_order", "is_signed", "scale", "offset", "unit")


@pytest.mark.parametrize("addresses", ["", "128-129", "131,140"])
def test_arxml_says_the_same(addresses: str, tmp_path: Path) -> None:
    """Message by message and signal by signal, as plain cantools reads both files."""
    out, plain = tmp_path / "fleet.arxml", tmp_path / "fleet.dbc"
    assert dbc_command(out, addresses or None) == 0 and dbc_command(plain, addresses or None) == 0
    theirs = {m.frame_id: m for m in cantools.database.load_file(out).messages}
    ours = cantools.database.load_file(plain).messages
    assert theirs.keys() == {m.frame_id for m in ours}
    rng = Random(5)
    for message in ours:
        read = theirs[message.frame_id]
        for said in SAID_OF_MESSAGES:
            assert getattr(read, said) == getattr(message, said), (message.name, said)
        assert quoted(read.comment) == message.comment
        assert (read.cycle_time or 0) == (message.cycle_time or 0), message.name
        signals = {signal.name: signal for signal in read.signals}
        assert signals.keys() == {signal.name for signal in message.signals}
        for signal in message.signals:
            same = signals[signal.name]
            for said in SAID_OF_SIGNALS:
                assert getattr(same, said) == getattr(signal, said), (message.name, signal.name)
            assert quoted(same.comment) == signal.comment
            assert (same.raw_initial or 0) == (signal.raw_initial or 0)
            assert named(same) == named(signal), (message.name, signal.name)
        data = rng.randbytes(message.length)
        assert read.decode(data) == message.decode(data), message.name
        assert read.encode(read.decode(data), strict=False) == data


def quoted(text: str) -> str:
    """A DBC has no quotes in its comments."""
    return text.replace('"', "'")


def named(signal: Any) -> dict[int, str]:
    return {value: str(name) for value, name in (signal.choices or {}).items()}


def test_every_name_of_the_arxml_is_one_of_autosar(tmp_path: Path) -> None:
    """Names begin with a letter and have no two underscores in a row; all references lead somewhere."""
    root = ElementTree.fromstring(to_arxml((128, 129)).encode())
    space = "{http://autosar.org/schema/r4.0}"
    assert root.tag == f"{space}AUTOSAR"
    names = [each.text or "" for each in root.iter(f"{space}SHORT-NAME")]
    wrong = [n for n in names if not re.fullmatch(r"[a-zA-Z](_?[a-zA-Z0-9])*_?", n) or len(n) > 128]
    assert names and not wrong

    places = dict[str, str]()

    def walk(element: ElementTree.Element, path: str) -> None:
        name = element.find(f"{space}SHORT-NAME")
        if name is not None:
            path = f"{path}/{name.text}"
            assert path not in places, path
            places[path] = element.tag.removeprefix(space)
        for child in element:
            walk(child, path)

    walk(root, "")
    for element in root.iter():
        if "DEST" in element.attrib:
            assert places[element.text or ""] == element.attrib["DEST"], element.text


@pytest.mark.parametrize("wrong", ["robots", "128-", "133-128", "254", "0-100"])
def test_wrong_addresses_are_one_line(wrong: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert dbc_command(None, wrong) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("suffix", ["XML", "ldf", "xlsx"])
def test_a_format_that_cannot_be_written_is_refused(
    suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A DBC under another format's name would be a riddle for its reader."""
    out = tmp_path / f"fleet.{suffix}"
    assert dbc_command(out) == 2 and not out.exists()
    assert "write .dbc, .arxml, .kcd or .sym" in capsys.readouterr().err


def test_no_dbc_extra_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "cantools.database.can", None)
    assert dbc_command(tmp_path / "x.kcd") == 2
    assert "headland[formats]" in capsys.readouterr().err
