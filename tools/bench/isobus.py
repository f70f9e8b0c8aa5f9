"""A robot beside devices of other makers: what it answers them, and what their tools read of it."""

import subprocess
from collections.abc import Iterator
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from agent.interface.config import ADDRESS_FIRST, ADDRESS_LAST, S
from agent.interface.effects import Send
from agent.interface.identity import Identity
from agent.peer.inputs import Received, Timer
from agent.peer.peer import Peer
from agent.runtime.peer_factory import make_peer
from agent.safety.stop_cause import StopCause
from protocol.frames.codec import encode
from protocol.frames.diagnostic_frames import (
    DM1,
    DM22,
    STANDARD_HEARTBEAT,
    BroadcastControl,
    ClearFault,
    StandardHeartbeat,
)
from protocol.frames.messages import Message
from protocol.frames.network_frames import (
    Acknowledgment,
    AcknowledgmentControl,
    RepetitionRateRequest,
    Request,
    Request2,
)
from protocol.name import fleet_name
from sim.files.candump import read_candump
from sim.rigs.faults_rig import StandingFleet
from sim.rigs.implements_rig import two_sprayers
from sim.rigs.task_session_rig import standing_load, task_session
from sim.rigs.terminal_rig import killed_screens
from tools.bench.cantools_judge import judge
from tools.bench.figure import Figure
from tools.bench.task_data import (
    LIMIT_S,
    QUICK_LIMIT_S,
    READER,
    ReaderAbsent,
    exported,
    kinds,
    warnings_of,
)
from tools.common.child_process import module_command

TOOL = 249  # an address
ROBOTS = 20
VALUES_AGREE = 0.001  # share: values are whole square metres and millimetres
LOAD_MAX = 0.04  # share of the bus
LOAD_FOR_S = 4  # four DM1 of each robot
STANDARD_HOLD_S = (
    5  # a robot's standard stop holds the others for 3 s, and two causes are told in 2 s
)
STOP_BOUND_MS = 20.0  # as for a press at a robot: seven frames of the highest priority
NOTHING = 1e-6  # share: rounding of polygons
# Groups that a tool asks for first, and whether a robot sends them (findings, table B).
ASKED = {65259: True, 64965: True, 65242: True, 64653: True, 64654: True, 64818: True, DM1.pgn: True,
         65227: True, 65228: True, 65235: False, 57088: False}  # fmt: skip
QUICK_RUN_S = 25  # from boot into the work
RUNS = {
    "field": ("run", "small", "--limit", "120"),
    "delivery": ("run", "warehouse", "--limit", "60"),
    "navigation": ("run", "rooms", "--limit", "60"),
    "yard": ("run", "yard", "--limit", "60"),
    "exploration": ("explore", "--robots", "3"),
}


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Requests of diagnostic tools, the bus load of all, and runs as cantools reads them."""
    yield _answers(seed)
    screen_load = 0.0
    for figure in _screen(seed, quick):
        screen_load = figure.value if figure.figure.startswith("bus load") else screen_load
        yield figure
    yield from _task_sessions(seed, quick, screen_load)
    yield from _standing(seed, screen_load)
    yield from _two_sprayers(seed, quick)
    with TemporaryDirectory() as folder:
        for kind in list(RUNS)[: 1 if quick else None]:
            yield _read_by_cantools(kind, Path(folder), quick)
        yield from _task_data(Path(folder) / "task data", quick)


def _task_data(folder: Path, quick: bool) -> Iterator[Figure]:
    """Task data of several makers, worked and written again."""
    from importlib.metadata import version

    written = []
    for number, kind in enumerate(list(kinds(folder / "given"))[: 1 if quick else None]):
        place = folder / f"{number}"
        place.mkdir()
        written.append(exported(kind, place, QUICK_LIMIT_S if quick else LIMIT_S))
    wrong = [f"{one.kind}: {error}" for one in written for error in one.schema_errors]
    scope = f"{len(written)} kinds: {'; '.join(one.kind for one in written)}"
    yield Figure("errors of our task data by the schemas of V4.3", float(len(wrong)), "", "0", not wrong,
                 f"models of isoxml {version('isoxml')}", f"{scope}. {'; '.join(wrong[:1])}")  # fmt: skip
    if quick:
        return  # npm takes most of a minute
    try:
        read = warnings_of([one.zipped for one in written], folder)
    except ReaderAbsent as problem:
        yield Figure(
            "warnings of a reader of our task data", 0.0, "", "0", None, READER, f"{problem}"
        )
        return
    said = [str(warning) for one in read for warning in one["warnings"]]
    records = sum(one["records"] for one in read)
    yield Figure("warnings of a reader of our task data", float(len(said)), "", "0", not said, READER,
                 f"{scope}; {records} log records. {'; '.join(said[:1])}")  # fmt: skip


def _joined(seed: int) -> tuple[Peer, int]:
    """A robot on the bus without a fault, and the time."""
    identity = Identity(
        0, frozenset({0}), fleet_name("isobus", 0), 1, started=True, first_boot=True
    )
    peer, now_us = make_peer(identity, Random(seed), 0, {}), 0
    while not peer.joining.joined:
        now_us = max(now_us, peer.due_at_us)
        peer.step(Timer(), now_us)
    return peer, now_us


def _answers(seed: int) -> Figure:
    """Requests and commands of table B, each to a robot alone."""
    peer, now_us = _joined(seed)

    def said(message: Message) -> list[Message]:
        frame = encode(message, TOOL, peer.address or 0)
        effects = peer.step(Received(frame), now_us)
        return [effect.message for effect in effects if isinstance(effect, Send)]

    right = 0
    for pgn, served in ASKED.items():
        for message in (Request(pgn), Request2(pgn, 0)):
            peer, now_us = _joined(seed)  # each is a message to one receiver: one at a time
            answer = said(message)
            refused = any(
                isinstance(m, Acknowledgment) and m.control == AcknowledgmentControl.NACK
                for m in answer
            )
            right += bool(answer) and refused is not served
    right += said(Request2(DM1.pgn, 1)) != []
    right += isinstance(said(BroadcastControl(0))[0], Acknowledgment)
    right += isinstance(said(ClearFault(17, 255, 110, 3, 0))[0], ClearFault)
    right += said(RepetitionRateRequest(STANDARD_HEARTBEAT.pgn, 100)) == [] and any(
        isinstance(effect.message, StandardHeartbeat)
        for effect in peer.step(Timer(), now_us)
        if isinstance(effect, Send)
    )
    asked = 2 * len(ASKED) + 4
    return Figure("requests of diagnostic tools that are answered", right / asked, "share", "1",
                  right == asked, "ISO 11783-3, -7, -12, SAE J1939-73",
                  f"{asked} requests: identification, DM1 to DM3, DM11, DM13, {DM22.name}, Request2, "
                  "repetition rate")  # fmt: skip


def _standing(seed: int, screen_load: float) -> Iterator[Figure]:
    """The load of all this while all robots stand: sessions, faults and the screen."""
    rig = StandingFleet(ROBOTS, seed)
    sessions = ROBOTS * standing_load((), seed).session

    def row(what: str, faults: float, target: bool, told: str) -> Figure:
        load = faults + sessions + screen_load
        return Figure(
            f"bus load of all this, {ROBOTS} robots {what}", load, "share",
            f"<= {LOAD_MAX}" if target else "", load <= LOAD_MAX if target else None, "250 kbit/s",
            f"DM1 each second, {told}, {faults:.2%}; sessions with a task controller {sessions:.2%}; "
            f"screen {screen_load:.2%}",
        )  # fmt: skip

    rig.fleet.press_stop()
    rig.fleet.run(STANDARD_HOLD_S * S)
    against = "as a tool written from SAE J1939-21 and -73 reads it"
    yield row(
        "that stand for an emergency stop", rig.load(LOAD_FOR_S), True, f"one fault, {against}"
    )
    rig.button.press()
    rig.fleet.run(STANDARD_HOLD_S * S)
    load = rig.load(LOAD_FOR_S)
    yield row("that stand for an emergency stop and a stop button of another maker", load, True,
              f"two faults of the leader and one of each other robot, {against}")  # fmt: skip
    leader = rig.fleet.serving
    assert leader is not None, f"no leader with seed {seed}"
    leader.alive = False
    load = rig.load(3 * LOAD_FOR_S)
    yield row("of which the leader dies meanwhile", load, True,
              f"two faults of each robot until another one leads, {against}")  # fmt: skip
    own = standing_load((StopCause.IMPLEMENTS_STOP,), seed)
    yield row("each of which has two faults of its own device", ROBOTS * own.faults, False,
              f"{own.told} faults of each robot: no single event does that")  # fmt: skip


def _two_sprayers(seed: int, quick: bool) -> Iterator[Figure]:
    """Section control by a shared map: two makers' sprayers, each with a task controller of ours."""
    found = two_sprayers(seed, passes=1 if quick else 4, length_m=100.0 if quick else 200.0)
    against = "two implements written from ISO 11783-10, versions 3 and 4; exact polygons"
    scope = (
        f"{found.overlap:.0%} of the field is sent to both; booms of 12 m, 3 m/s, valves of 150 to "
        f"300 ms, exact guidance; map and beats of its fleet: {found.map_load:.1%} of a bus"
    )
    yield Figure("overlap worked twice with section control", found.twice, "share", "<= 0.01",
                 found.twice <= 0.01, against, scope)  # fmt: skip
    yield Figure("ground left out with section control", found.left_out, "share", "0",
                 found.left_out < NOTHING, against, scope)  # fmt: skip
    yield Figure("log-in of an implement at our task controller", found.log_in_for_s, "s", "<= 3",
                 found.log_in_for_s <= 3, against, "from power-up of all, the slower one")  # fmt: skip


def _task_sessions(seed: int, quick: bool, screen_load: float) -> Iterator[Figure]:
    """Hours of a robot with a task controller whose bytes were recorded, and the load of all."""
    hours = 0.2 if quick else 8.0
    against = "constant bytes of a task controller; what the body was told"
    versions = (4,) if quick else (3, 4)
    found = {version: task_session(version, hours, seed) for version in versions}
    for version, record in found.items():
        scope = (
            f"version {version}, {hours:g} h, {record.told} values by time, by way and on change"
        )
        yield Figure(f"log-in at a task controller, version {version}", record.log_in_for_s, "s", "<= 3",
                     record.log_in_for_s <= 3, against, f"{scope}; from power-up")  # fmt: skip
        lost = record.log_ins - 1
        yield Figure(f"sessions lost, version {version}", float(lost), "times", "0", lost == 0, against,
                     scope)  # fmt: skip
        worst = max(record.area_error, record.distance_error)
        right = worst <= VALUES_AGREE and record.time_error_for_s <= 1 and record.states_missed == 0
        yield Figure(f"values against the work record, version {version}", worst, "share",
                     f"<= {VALUES_AGREE}", right, against,
                     f"{scope}; area and distance; time differs by {record.time_error_for_s:.2f} s, "
                     f"{record.states_missed} changes of the implement not told")  # fmt: skip
    sessions = ROBOTS * max(record.load for record in found.values())
    scope = (
        "each robot's session with one task controller, and the screen; not the map of implements"
    )
    load = screen_load + sessions
    yield Figure(f"bus load of all this, {ROBOTS} robots at work", load, "share", "<= 0.04",
                 load <= LOAD_MAX, "250 kbit/s", f"{scope}; no faults")  # fmt: skip


def _screen(seed: int, quick: bool) -> Iterator[Figure]:
    """The fleet's screen on a terminal of another maker, whose serving robot is killed."""
    found = killed_screens(1 if quick else 100, seed=seed)
    against = "a terminal written from ISO 11783-6 and -3"
    scope = (
        f"4 robots; {found.kills} kills, each robot starts again with its memory; a pool of "
        f"{found.pool_bytes} bytes by ETP; {len(found.errors)} errors of the pool or its changes"
    )
    yield Figure("screen on a terminal is back after its robot was killed", found.back_for_s, "s",
                 "<= 3", found.back_for_s <= 3 and not found.errors, against, scope)  # fmt: skip
    yield Figure("two screens of one fleet within a second", float(found.twice), "times", "0",
                 found.twice == 0, against, scope)  # fmt: skip
    yield Figure("from the stop key to the last robot that has latched", found.stop_for_ms, "ms",
                 f"<= {STOP_BOUND_MS:.0f}", found.stop_for_ms <= STOP_BOUND_MS, against,
                 f"{found.stops} presses, {found.released} released by the key")  # fmt: skip
    seconds = 4 if quick else 10
    large = killed_screens(0, robots=ROBOTS, seed=seed, load_for_s=seconds)
    yield Figure(f"bus load of the screen, {ROBOTS} robots", large.load, "share", "<= 0.04",
                 large.load <= LOAD_MAX, "250 kbit/s", f"{seconds} s of a fleet that stands")  # fmt: skip


def _read_by_cantools(kind: str, folder: Path, quick: bool) -> Figure:
    """A run of one kind, as `cantools decode` reads it without flags."""
    from cantools import __version__

    out, dbc = folder / kind, folder / "headland.dbc"
    command = module_command("tools.cli.headland")
    # A run that is cut short exits with 1.
    limit = ("--limit", f"{QUICK_RUN_S}") if quick else ()
    subprocess.run(
        [*command, *RUNS[kind], *limit, "--out", str(out)], capture_output=True, check=False
    )
    sources = {frame.identifier & 0xFF for _, frame in read_candump(out / "can.log")}
    robots = [address for address in sorted(sources) if ADDRESS_FIRST <= address <= ADDRESS_LAST]
    addresses = ",".join(map(str, robots))
    subprocess.run(
        [*command, "dbc", str(dbc), "--addresses", addresses], capture_output=True, check=True
    )
    result = judge(out / "can.log", dbc)
    share = result.equal / result.frames
    return Figure(f"frames of a run that cantools reads as we do: {kind}", share, "share", "1",
                  share == 1 and not result.first_difference, f"cantools {__version__}, no flags",
                  f"{result.frames} frames, every signal; {result.first_difference}")  # fmt: skip
