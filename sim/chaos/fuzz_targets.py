"""One function for every decoder: it takes any bytes and asserts the promises.

Promised: no exception except the declared one, limits are kept, decoding and encoding again gives
the same bytes, and no frame except an operator's reset leaves EMERGENCY_STOP. `headland fuzz` runs
them.
"""

import json
import os
import zipfile
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from random import Random
from struct import Struct
from tempfile import TemporaryDirectory

import numpy as np

from agent.interface.effects import Persist
from agent.interface.identity import Identity
from agent.interface.lifecycle import State
from agent.peer import durable_records as records
from agent.peer.inputs import Press, Received, Timer
from agent.peer.journal_recovery import LOST
from agent.peer.peer import Peer
from agent.runtime.files.field_error import FieldFileError
from agent.runtime.files.field_file import read_boundary
from agent.runtime.files.key_file import FLEET, KeyFileError, key_id, read
from agent.runtime.peer_factory import make_peer
from agent.runtime.sqlite_journal import MARK_SUFFIX, Mark, SqliteJournal
from agent.safety.stop_controller import HOLD_KEY, STOPS_KEY
from crdt import FieldAllocationCRDT, Phase, Progress
from crdt.claim_register import pack
from crdt.occupancy import CELLS, Geometry, OccupancyMap
from crdt.stops import StopDot, StopSet
from protocol.authentication import Keyring, Keys
from protocol.frames.codec import Malformed, decode, encode
from protocol.frames.fleet_frames import Heartbeat, LeaderElectionVote, Member, Pose
from protocol.frames.frame import Frame
from protocol.frames.messages import GROUPS, Message
from protocol.frames.network_frames import AddressClaimed, TransportData, TransportManagement
from protocol.frames.safety_frames import EmergencyReset, EmergencyStop, OperatorCommand, Reason
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress
from protocol.name import fleet_name
from protocol.sync.synchronizer import Synchronizer
from protocol.transport import Transport
from sim.chaos.power_cuts import RAM
from sim.files.candump import read_candump
from sim.files.coverage_plan_file import Plan, read_plan, write_plan
from sim.files.grid_map import GridFileError, read_instance, read_map
from sim.fleet.simulated_disk import Disk, LogJournal
from sim.record.mcap_log import McapLog, read_recording
from sim.record.scene_builder import scene_of
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import ScenarioError, load

ENTRY = Struct("<IB8s")  # of a sequence: identifier, milliseconds since the last, data
STEPS_MAX = 64
UNITS = dict.fromkeys(range(8), 70)


Target = Callable[[bytes], None]


def frame(data: bytes) -> None:
    """A frame: 4 bytes of identifier, then its data. A decoded message encodes to the same
    bytes."""
    if len(data) < 4:
        return
    identifier = int.from_bytes(data[:4], "little") & 0x1FFFFFFF
    source, message = decode(Frame(identifier, data[4:12]))
    assert source == identifier & 0xFF
    if isinstance(message, Malformed):
        return
    again = decode(encode(message, source, identifier >> 8 & 0xFF))
    assert again[1] == message or message != message, (message, again)


def transport(data: bytes) -> None:
    """Frames of the transport protocol in any order, with time passing between."""
    ours, now_us = Transport(), 0
    for identifier, wait_for_ms, body in ENTRY.iter_unpack(_whole(data)):
        now_us += wait_for_ms * 10_000
        source, message = decode(Frame(identifier & 0x1FFFFFFF, body))
        if isinstance(message, TransportManagement | TransportData):
            ours.on_message(source, identifier >> 8 & 0xFF, message, now_us)
        list(ours.on_tick(now_us))
        assert ours.sessions <= 64, ours.sessions
        if wait_for_ms == 7:
            ours.send(0xFEEB, body * 3, source, now_us)


def sync(data: bytes) -> None:
    """Sync frames of three peers, and ticks; the replica may only grow."""
    allocation, progress = FieldAllocationCRDT(), Progress(UNITS)
    replica, now_us = Synchronizer(0, allocation, progress), 0
    replica.live(frozenset((0, 1, 2)), now_us)
    for identifier, wait_for_ms, body in ENTRY.iter_unpack(_whole(data)):
        now_us += wait_for_ms * 1_000
        _, message = decode(Frame(identifier & 0x1FFFFFFF, body))
        before = dict(allocation.entries())
        if isinstance(message, Heartbeat):
            replica.heard_digest(1 + identifier % 2, message.digest, now_us)
        else:
            replica.on_message(1 + identifier % 2, message, now_us)
        list(replica.on_tick(now_us))
        after = allocation.entries()
        assert all(after[section] >= key for section, key in before.items())
    assert FieldAllocationCRDT.deserialize(allocation.serialize()).entries() == allocation.entries()


def peer(data: bytes) -> None:
    """Frames to a whole peer, stopped first if the first byte is odd: only a reset releases it."""
    ours, now_us, resets = _peer({}), 0, 0
    for _ in range(4):  # ticks until the peer has joined
        now_us = max(now_us, ours.due_at_us)
        ours.step(Timer(), now_us)
    if data[:1] and data[0] & 1:
        ours.step(Press(Reason.PERSON_IN_FIELD), now_us)
    for identifier, wait_for_ms, body in ENTRY.iter_unpack(_whole(data[1:])):
        stopped = ours.state is State.EMERGENCY_STOP
        now_us += wait_for_ms * 1_000
        arrived = Frame(identifier & 0x1FFFFFFF, body)
        resets += isinstance(decode(arrived)[1], OperatorCommand)
        ours.step(Received(arrived), now_us)
        if now_us >= ours.due_at_us:
            ours.step(Timer(), now_us)
        if stopped and not resets:
            assert ours.state is State.EMERGENCY_STOP
        assert len(ours.membership.standing) <= 8 and len(ours.membership.slot_of) <= 8


def keyed(data: bytes) -> None:
    """The same for a peer with keys: no frame without a tag releases it."""
    ours, now_us = _peer({}, KEYRING), 1_000_000
    ours.step(Press(Reason.PERSON_IN_FIELD), now_us)
    for identifier, wait_for_ms, body in ENTRY.iter_unpack(_whole(data)):
        now_us += wait_for_ms * 1_000
        ours.step(Received(Frame(identifier & 0x1FFFFFFF, body)), now_us)
        assert ours.state is State.EMERGENCY_STOP


def memory(data: bytes) -> None:
    """The contents of a journal, with any value under any of our keys."""
    recalled, at = dict[str, bytes](), 0
    while at + 2 <= len(data):
        key, size = KEYS[data[at] % len(KEYS)], data[at + 1] % 80
        recalled[key], at = data[at + 2 : at + 2 + size], at + 2 + size
    ours = _peer(recalled)
    if recalled.get(STOPS_KEY) and not ours.safety.latched:
        assert not StopSet.deserialize(recalled[STOPS_KEY]).latched
    ours.step(Timer(), ours.due_at_us)


def stop_set(data: bytes) -> None:
    """A stop set that can be read is written back equal; anything else is a ValueError."""
    try:
        stops = StopSet.deserialize(data)
    except ValueError:
        return
    assert StopSet.deserialize(stops.serialize()) == stops


def allocation(data: bytes) -> None:
    """Registers that can be read are written back equal; anything else is a ValueError."""
    try:
        replica = FieldAllocationCRDT.deserialize(data)
    except ValueError:
        return
    assert FieldAllocationCRDT.deserialize(replica.serialize()).entries() == replica.entries()


def progress(data: bytes) -> None:
    """Progress that can be read stays within the units of its sections, and is written back with an
    equal digest."""
    try:
        replica = Progress.deserialize(data, UNITS)
    except ValueError:
        return
    assert all(replica.covered(section) <= units for section, units in UNITS.items())
    assert Progress.deserialize(replica.serialize(), UNITS).digest == replica.digest


def occupancy(data: bytes) -> None:
    """A map that can be read is written back equal; anything else is a ValueError."""
    try:
        replica = OccupancyMap.deserialize(data)
    except ValueError:
        return
    assert OccupancyMap.deserialize(replica.serialize()) == replica


def journal(data: bytes) -> None:
    """A disk with any contents: what was recovered once is recovered again."""
    ours = LogJournal(Disk(data))
    known = dict(ours.load())
    ours.write([Persist("key", b"value")])
    again = LogJournal(Disk(ours.disk.read())).load()
    assert again == known | {"key": b"value"}


def sqlite_journal(data: bytes) -> None:
    """The files of a robot's journal with any contents. What is recalled was once written, or the
    memory is reported as lost. Nothing older than the mark is recalled. The journal stays
    usable."""
    sizes, files = data[: SIZES.size].ljust(SIZES.size, b"\0"), data[SIZES.size :]
    main, log = (min(size, len(files)) for size in SIZES.unpack(sizes))
    parts = files[:main], files[main : main + log], files[main + log :]
    for left in _ram().glob(f"{JOURNAL}*"):
        left.unlink()
    path = _ram() / JOURNAL
    for suffix, part in zip(("", "-wal", MARK_SUFFIX), parts, strict=True):
        path.with_name(JOURNAL + suffix).write_bytes(part)
    marked = Mark(path.with_name(JOURNAL + MARK_SUFFIX)).number
    ours, recalled = SqliteJournal.opened(path)
    try:
        assert LOST in recalled or dict(recalled) in WRITTEN[marked : marked + 2], dict(recalled)
        if zlib.crc32(data) % AGAIN_EVERY == 0:
            ours.write([Persist(records.OPERATIONS, bytes(4))])
    finally:
        ours.close()
    if zlib.crc32(data) % AGAIN_EVERY == 0:
        ours, again = SqliteJournal.opened(path)
        ours.close()
        assert again == {**recalled, records.OPERATIONS: bytes(4)}


def scenario(data: bytes) -> None:
    """A scenario file is loaded, or refused with a ScenarioError of one line."""
    path = _scratch("scenario.toml", data)
    try:
        load(str(path))
    except ScenarioError as problem:
        assert "\n" not in str(problem)


def key_file(data: bytes) -> None:
    """A file of keys is read, or refused with a KeyFileError of one line."""
    path = _scratch("keys.json", data)
    path.chmod(0o600)
    try:
        read(path)
    except KeyFileError as problem:
        assert "\n" not in str(problem)


def field_file(data: bytes) -> None:
    """A GeoJSON boundary is read, or refused with a FieldFileError of one line."""
    path = _scratch("field.geojson", data)
    try:
        read_boundary(path)
    except FieldFileError as problem:
        assert "\n" not in str(problem)


def task_data(data: bytes) -> None:
    """The XML of ISO 11783-10 is read, or refused with a FieldFileError of one line."""
    _boundary(_scratch("TASKDATA.XML", data))


def task_zip(data: bytes) -> None:
    """A zip with ISO 11783-10 data is read, or refused with a FieldFileError of one line."""
    _boundary(_scratch("taskdata.zip", data))


def _boundary(path: Path) -> None:
    try:
        read_boundary(path)
    except FieldFileError as problem:
        assert "\n" not in str(problem)


def grid_map(data: bytes) -> None:
    """A Moving-AI floor is read, or refused with a GridFileError of one line."""
    try:
        read_map(_scratch("floor.map", data))
    except GridFileError as problem:
        assert "\n" not in str(problem)


def grid_instance(data: bytes) -> None:
    """Starts for a map are read, or refused with a GridFileError of one line."""
    _scratch("floor.map", GRID)
    try:
        read_instance(_scratch("robots.mcpp", data))
    except GridFileError as problem:
        assert "\n" not in str(problem)


def grid_plan(data: bytes) -> None:
    """A plan of actions is read, or refused with a GridFileError of one line."""
    try:
        read_plan(_scratch("plan.json", data))
    except GridFileError as problem:
        assert "\n" not in str(problem)


def mcap(data: bytes) -> None:
    """A recording is read, or refused with a ValueError of one line."""
    try:
        read_recording(_scratch("run.mcap", data))
    except ValueError as problem:
        assert "\n" not in str(problem)


def candump(data: bytes) -> None:
    """Lines that can be read are frames of at most 8 bytes with 29-bit identifiers; others are
    skipped."""
    for t_us, sent in read_candump(_scratch("can.log", data)):
        assert t_us >= 0 and len(sent.data) <= 8 and sent.identifier >> 29 == 0


GRID = b"type octile\nheight 2\nwidth 3\nmap\n..@\n...\n"
JOURNAL = "robot.sqlite"
SIZES = Struct("<II")  # bytes of the database and of its log; the mark follows
AGAIN_EVERY = 16  # every 16th input is also written to, because each write waits for a disk
WRITES = (
    {records.INCARNATION: b"\1\0", records.OPERATIONS: bytes(4)},
    {f"{records.REGISTER}3": bytes(range(8)), records.OPERATIONS: b"\1\0\0\0"},
    {f"{records.PROGRESS}3/1": bytes(range(8)), f"{records.REGISTER}4": bytes(range(1, 9))},
)
WRITTEN: list[dict[str, bytes]] = [{}]  # the expected contents after each write
for _records in WRITES:
    WRITTEN.append({**WRITTEN[-1], **_records})
# Targets that read a file from someone else, or from before a crash: `headland fuzz --files`.
FILES = [journal, sqlite_journal, scenario, key_file, field_file]
FILES += [grid_map, grid_instance, grid_plan, candump]
FILES += [task_data, task_zip] if find_spec("isoxml") is not None else []
FILES += [mcap] if find_spec("mcap") is not None else []
TARGETS: dict[str, Target] = {
    target.__name__: target
    for target in (frame, transport, sync, peer, keyed, memory, stop_set, allocation, progress,
                   occupancy, *FILES)
}  # fmt: skip
KEYRING = Keyring(Keys(bytes(range(16)), bytes(range(16, 32))), 0, b"fuzz")
KEYS = (records.INCARNATION, records.OPERATIONS, records.ELECTION, STOPS_KEY, HOLD_KEY,
        f"{records.REGISTER}3", f"{records.REGISTER}70000", f"{records.PROGRESS}3/1",
        f"{records.PROGRESS}9/200")  # fmt: skip


def _peer(recalled: dict[str, bytes], keyring: Keyring | None = None) -> Peer:
    identity = Identity(0, frozenset(range(4)), fleet_name("fuzz", 0), 1, started=True)
    return make_peer(identity, Random(1), 0, recalled, keyring=keyring)


def _whole(data: bytes) -> bytes:
    """As many whole entries of a sequence as there are."""
    return data[: min(len(data) // ENTRY.size, STEPS_MAX) * ENTRY.size]


@cache
def _folder() -> "TemporaryDirectory[str]":
    """A folder of this process, which no other user can have created before."""
    where = RAM if os.access(RAM, os.W_OK) else None  # these files need not survive a power cut
    return TemporaryDirectory(prefix="headland-fuzz-", dir=where)


def _ram() -> Path:
    return Path(_folder().name)


def _scratch(name: str, data: bytes) -> Path:
    path = _ram() / name
    path.write_bytes(data)
    return path


# -------------------------------------------------------------------- initial inputs


def seeds(name: str) -> Iterator[bytes]:
    """Valid inputs of a target, to start from."""
    messages = _messages()
    if name == "frame":
        for message in messages:
            sent = encode(message, 130)
            yield sent.identifier.to_bytes(4, "little") + sent.data
        for group in GROUPS:
            yield (6 << 26 | group.pgn << 8 | 1).to_bytes(4, "little") + bytes(group.length)
    elif name in ("transport", "sync", "peer", "keyed"):
        frames = [encode(message, 130 + k % 3) for k, message in enumerate(messages)]
        names = [AddressClaimed(fleet_name("fuzz", 1 + k).pack()) for k in range(3)]
        frames[:0] = [encode(name, 130 + k) for k, name in enumerate(names)]
        entries = b"".join(ENTRY.pack(sent.identifier, 50, sent.data) for sent in frames)
        yield (b"\x01" if name == "peer" else b"") + entries
        yield (b"\x00" if name == "peer" else b"") + entries[::-1]
    elif name == "memory":
        yield b"".join(bytes((k, 8)) + bytes(range(8)) for k in range(len(KEYS)))
    elif name == "stop_set":
        stops = StopSet()
        stops.press(StopDot(1, 1, 1))
        stops.press(StopDot(2, 1, 1))
        stops.clear(StopDot(1, 1, 1))
        yield stops.serialize()
    elif name == "allocation":
        replica = FieldAllocationCRDT(1)
        for section in range(4):
            replica.claim(section, section)
        yield replica.serialize()
    elif name == "progress":
        covered = Progress(UNITS)
        covered.cover(1, 2)
        covered.cover(3, 50)
        yield covered.serialize()
    elif name == "journal":
        log = LogJournal(Disk())
        log.write([Persist("a", b"1"), Persist("b", b"22")])
        log.write([Persist("a", b"3")])
        yield log.disk.read()
    elif name == "sqlite_journal":
        yield from _journals()
    else:
        yield from _texts(name)


def _journals() -> Iterator[bytes]:
    """Journals of a robot that was killed before its log was in the database, and of one that
    ended."""
    with TemporaryDirectory(dir=_folder().name) as folder:
        path = Path(folder) / JOURNAL
        ours = SqliteJournal(path)
        for written in WRITES:
            ours.write([Persist(key, value) for key, value in written.items()])
        for ended in (False, True):
            if ended:
                ours.close()
            files = [path.with_name(JOURNAL + suffix) for suffix in ("", "-wal", MARK_SUFFIX)]
            parts = [file.read_bytes() if file.exists() else b"" for file in files]
            yield SIZES.pack(len(parts[0]), len(parts[1])) + b"".join(parts)


def _messages() -> list[Message]:
    key = pack(1, Phase.CLAIMED, 3, 4, 1)
    assert key > 0
    return [
        Pose(1.0, -2.0, 0.5, 1.5, 2, False, 7), Member(1, 1, 1),
        Heartbeat(251, 2, False, False, True, False, 1.0, 3, 0x1234),
        EmergencyStop(1, 1, 1, int(Reason.PERSON_IN_FIELD)), EmergencyReset(1, 1, 1, 200),
        OperatorCommand(1, 255, 200), LeaderElectionVote(1, 1, 0),
        TaskClaim(3, 1, 1, 3, 4, 1), StateSyncResponse(3, 1, 2, 3, 5, 1), WorkProgress(3, 0, 0xFF),
    ]  # fmt: skip


def _texts(name: str) -> Iterator[bytes]:
    shipped = Path(__file__).parents[1] / "scenarios"
    if name == "scenario":
        yield (shipped / "yard.toml").read_bytes()
        yield (shipped / "bystander.toml").read_bytes()
    elif name == "field_file":
        yield (shipped / "yard.geojson").read_bytes()
    elif name == "key_file":
        text = {name: key_id(bytes(16)) for name in ("id", "operator_id")}
        text |= dict.fromkeys(("key", "operator_key"), "00" * 16) | {"kind": FLEET}
        yield json.dumps(text).encode()
    elif name in ("task_data", "task_zip"):
        yield from _task_data(name)
    elif name == "grid_map":
        yield GRID
    elif name == "grid_instance":
        yield b"map: floor\nroot: [[0, 0],\n  [1, 1]]\nweighted: False\n"
        yield b"map: floor\nroot: [0, 3]\n"
    elif name == "grid_plan":
        walls = np.zeros((2, 3), dtype=np.bool_)
        plan = Plan(walls, [(0, 0)], [[1, 2, 0]], ~walls)
        path = _scratch("plan.json", b"")
        write_plan(path, plan)
        yield path.read_bytes()
    elif name == "candump":
        yield b"(1.000000) can0 0CFF1080#0011223344556677\n(1.5) can0 123#00 R\n"
    elif name == "mcap":
        path = _scratch("run.mcap", b"")
        log = McapLog(path, scene_of(FieldSetup(load("small"))))
        for k in range(40):
            log.write(k * 1000, Frame(0x0CFF1080, bytes((k,) * 8)))
        log.place(50_000, [[1.0, 2.0, 3.0, 0.5, 0.5, 1.0, 0.0]])
        log.close()
        yield path.read_bytes()
    elif name == "occupancy":
        chart = OccupancyMap(Geometry(8, 8, (0.0, 0.0), 0.5))
        chart.join(0, np.arange(CELLS, dtype=np.int64) << 20)
        yield chart.serialize()


def _task_data(name: str) -> Iterator[bytes]:
    """A field with a hole, as XML or zipped."""
    squares = []
    for kind, low, high in ((1, 0.0, 2e-3), (2, 5e-4, 1e-3)):
        corners = ((low, low), (high, low), (high, high), (low, high), (low, low))
        points = "".join(f'<PNT A="2" C="{lat}" D="{lon}"/>' for lon, lat in corners)
        squares.append(f'<LSG A="{kind}">{points}</LSG>')
    text = (
        '<?xml version="1.0" encoding="UTF-8"?><ISO11783_TaskData VersionMajor="4">'
        f'<PFD A="PFD1" C="f" D="1"><PLN A="1">{"".join(squares)}</PLN></PFD></ISO11783_TaskData>'
    )
    if name == "task_data":
        yield text.encode()
        return
    for method in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        whole = BytesIO()
        with zipfile.ZipFile(whole, "w", method) as archive:
            archive.writestr("TASKDATA/TASKDATA.XML", text)
        yield whole.getvalue()
