"""Plain language and the inspector, measured: phrases, misspellings, times, one-line errors, why."""

import asyncio
import itertools
import resource
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from random import Random
from statistics import median
from string import ascii_lowercase
from typing import Any, NamedTuple

from agent.interface.config import ACTUATOR_TTL_US
from crdt import Phase
from protocol.frames.frame import Frame
from protocol.links.bus import CanBus
from sim.can.simulated_bus import FieldBus
from sim.fleet.simulated_fleet import Cluster
from sim.fleet.virtual_clock import elapse, run_virtual
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.bench.drill import ProtocolFleet
from tools.bench.figure import Figure
from tools.common.child_process import module_command
from tools.inspect.inspector import Inspector
from tools.language.authorize import Authorization, weigh
from tools.language.command_session import CommandSession
from tools.language.fleet_state import FleetNow, RobotNow, SectionNow
from tools.language.goal_queue import GoalQueue
from tools.language.intent import AnyIntent
from tools.language.parse import read
from tools.language.places import Places
from tools.language.question import Question

FILE = Path(__file__).with_suffix(".toml")
WORK_LIMIT_S = 600.0  # of the simulated run whose chains are judged
ALONE = "nothing to compare with"


class Case(NamedTuple):
    """One phrase of the file."""

    say: str
    intents: list[dict[str, Any]] | None
    gives: list[str] | None
    asks: str | None


class Phrases(NamedTuple):
    """The cases of `phrases.toml`, and the fleet and places that they speak about."""

    known: list[Case]
    unseen: list[Case]
    fleet: FleetNow
    places: Places


def phrases() -> Phrases:
    """Read `phrases.toml`."""
    document = tomllib.loads(FILE.read_text(encoding="utf-8"))
    fleet = FleetNow(
        {robot["slot"]: RobotNow(**robot) for robot in document["robot"]},
        {3: SectionNow("STARTED", 2), 7: SectionNow("STARTED", 1)},
    )
    known, unseen = (
        [Case(c["say"], c.get("intents"), c.get("gives"), c.get("asks")) for c in document[kind]]
        for kind in ("phrase", "unseen")
    )
    return Phrases(known, unseen, fleet, Places(document["places"], document["sections"]))


def given(verdict: Authorization) -> list[str]:
    """What would be done, as the file writes it."""
    told = [_order(o.slot, o.what, o.place) for o in verdict.orders]
    told += [f"queued {goal.name}" for goal in verdict.waiting]
    told += ["stop all"] * verdict.stop_all + ["emergency stop"] * verdict.emergency_stop
    told += ["clear queue"] * verdict.clear_queue + ["first asks"] * len(verdict.first_ask)
    return told + [f"answers {query.ask}" for query in verdict.queries]


def _order(slot: int, what: str, place: tuple[float, float] | None) -> str:
    return f"{slot} {what}" + ("" if place is None else f" {place[0]:g},{place[1]:g}")


def understood(say: str, file: Phrases) -> list[str] | Question:
    """What a phrase would do in the fleet of the file."""
    reading = read(say, file.places)
    verdict = reading if isinstance(reading, Question) else weigh(reading, file.fleet, file.places)
    return verdict if isinstance(verdict, Question) else given(verdict)


def misspelt(say: str, rng: Random) -> str:
    """One letter of one word is another, missing, doubled, or has changed places; no digit is touched."""
    places = [at for at, letter in enumerate(say) if letter.isalpha()]
    at = rng.choice(places)
    match rng.randrange(4):
        case 0:
            return say[:at] + rng.choice(ascii_lowercase) + say[at + 1 :]
        case 1:
            return say[:at] + say[at + 1 :]
        case 2:
            return say[:at] + say[at] + say[at:]
        case _:
            return say[:at] + say[at + 1 : at + 2] + say[at] + say[at + 2 :]


# -------------------------------------------------------------------- figures


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Phrases understood, misspelt ones, times of reading, one-line errors, and chains of `--why`."""
    file = phrases()
    yield from _understanding(file)
    yield from _misspelt(file, Random(seed), 2_000 if quick else 50_000)
    yield from _reading_times(file, 3 if quick else 20)
    yield from _help_time(3 if quick else 9)
    yield from _errors()
    yield from _speaking(20, seed)
    yield from _why(seed)
    yield from _screen(20, seed)


def _understanding(file: Phrases) -> Iterator[Figure]:
    results = [(case, understood(case.say, file)) for case in file.known]
    right = sum(
        case.asks == result.reason.name if isinstance(result, Question) else case.gives == result
        for case, result in results
    )
    share = right / len(results)
    yield Figure(
        f"{len(results)} phrases: obeyed, answered or asked back as written", share, "share",
        "= 1", share == 1.0, ALONE, "tools/bench/phrases.toml; bad and dangerous ones among them",
    )  # fmt: skip
    results = [(case, understood(case.say, file)) for case in file.unseen]
    wrong = sum(not isinstance(r, Question) and r != case.gives for case, r in results)
    meant = [(case, r) for case, r in results if case.gives]
    read_right = sum(case.gives == r for case, r in meant)
    scope = "written down once, before the grammar met them; not used to improve it"
    yield Figure(
        f"{len(results)} unseen phrases: taken for something else", wrong, "phrases", "= 0",
        wrong == 0, ALONE, scope,
    )  # fmt: skip
    yield Figure(
        f"{len(meant)} unseen phrases with a meaning: understood, the others asked back",
        read_right / len(meant), "share", "", None, ALONE, scope,
    )  # fmt: skip


def _misspelt(file: Phrases, rng: Random, count: int) -> Iterator[Figure]:
    wrong = 0
    for _ in range(count):
        case = rng.choice(file.known)
        result = understood(misspelt(case.say, rng), file)
        wrong += not isinstance(result, Question) and result != case.gives
    yield Figure(
        f"{count} phrases with one letter wrong: obeyed as something else", wrong, "phrases",
        "= 0", wrong == 0, ALONE, "a letter replaced, left out, doubled or moved",
    )  # fmt: skip


def _reading_times(file: Phrases, rounds: int) -> Iterator[Figure]:
    times_ms = []
    for _ in range(rounds):
        for case in file.known:
            begun_s = time.process_time()
            understood(case.say, file)
            times_ms.append((time.process_time() - begun_s) * 1e3)
    times_ms.sort()
    for name, at in (("median", 0.5), ("95 of 100", 0.95)):
        value = times_ms[int(at * len(times_ms))]
        yield Figure(
            f"one phrase, words to orders, {name}", value, "ms", "<= 20", value <= 20.0, ALONE,
            "CPU time of reading and weighing, grammar loaded; no bus",
        )  # fmt: skip


def _help_time(rounds: int) -> Iterator[Figure]:
    """ABAB with a Python that does nothing, so that the machine's own time is seen."""
    ours, nothing = [], []
    for _ in range(rounds):
        ours.append(_cpu_s([*module_command("tools.cli.headland"), "--help"]))
        nothing.append(_cpu_s([sys.executable, "-c", "pass"]))
    yield Figure(
        "headland --help", median(ours), "s", "<= 0.3", median(ours) <= 0.3,
        f"python -c pass: {median(nothing):.3f} s", "CPU time of the process, median",
    )  # fmt: skip


def _cpu_s(words: Sequence[str]) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(words, stdout=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


# Things a person can do wrong at this part of the command line; the other parts have tests of their own.
ERRORS: tuple[tuple[str, ...], ...] = (
    ("say", "status", "--port", "1"),
    ("say", "status", "-i", "nonsense"),
    ("say", "status", "--by", "bob"),
    ("say", "--read", "status", "--places", "nowhere.toml"),
    ("say", "--read", "status", "--endpoint", "nonsense"),
    ("say", "status", "--log", "nowhere"),
    ("inspect", "nowhere"),
    ("inspect", "--port", "1"),
    ("inspect", "--picture", "x.svg"),
    ("inspect", "nowhere", "--why", "x"),
    ("order", "1", "jump", "--port", "1"),
    ("order", "1", "set-goal", "here", "--port", "1"),
)


def _errors() -> Iterator[Figure]:
    bad = 0
    for words in ERRORS:
        done = subprocess.run(
            [*module_command("tools.cli.headland"), *words],
            capture_output=True,
            text=True,
            check=False,
        )
        bad += not (done.returncode == 2 and done.stderr.count("\n") == 1 and not done.stdout)
    yield Figure(
        f"{len(ERRORS)} wrong calls: not one line with exit code 2", bad, "calls", "= 0", bad == 0,
        ALONE, "say, inspect and order as processes",
    )  # fmt: skip


def _speaking(robots: int, seed: int) -> Iterator[Figure]:
    stood_ms, confirmed, answered = run_virtual(_spoken(robots, seed))
    yield Figure(
        f"the phrase 'stop' to the last zero command, {robots} robots", stood_ms, "ms", "<= 100",
        stood_ms <= 100.0, ALONE, "virtual time on the simulated wire, reading not included",
    )  # fmt: skip
    yield Figure(
        f"the phrase 'stop': confirmed, {robots} robots", confirmed, "robots", f"= {robots}",
        confirmed == robots, ALONE, "within 0.5 s; otherwise an emergency stop would follow",
    )  # fmt: skip
    yield Figure(
        f"peers that answer the same question alike, of {robots}", answered, "peers",
        f"= {robots}", answered == robots, ALONE, "each asked in turn for the state of all",
    )  # fmt: skip


async def _spoken(robots: int, seed: int) -> tuple[float, int, int]:
    """Milliseconds to the last zero command; robots that confirmed; robots that answered alike."""
    fleet, loop = ProtocolFleet(robots, seed), asyncio.get_running_loop()
    bus = CanBus(FieldBus(fleet.channel))
    places = Places({})

    async def words(phrase: str) -> tuple[tuple[AnyIntent, ...] | Question, bool]:
        return read(phrase, places), False

    async def no(question: str) -> bool:
        return False

    with tempfile.TemporaryDirectory() as folder:
        speaker = CommandSession(
            bus, None, places, GoalQueue(Path(folder) / "queue.json"), words, no
        )
        try:
            assert await fleet.until_working()
            answers = []
            for slot in range(robots):
                speaker.by = str(slot)
                told = await speaker.say("status")
                if told.told_by == f"robot {slot}":
                    answers.append([(r["slot"], r["state"]) for r in told.answers[0].value])
            begun_us = round(loop.time() * 1e6)
            told = await speaker.say("stop")
            assert told.stopped is not None
            last_us = max(body.moved_until_us(ACTUATOR_TTL_US) for body in fleet.bodies)
            alike = max(map(answers.count, answers), default=0)
            return (last_us - begun_us) / 1e3, len(told.stopped), alike
        finally:
            bus.close()
            await fleet.close()


def _why(seed: int) -> Iterator[Figure]:
    """A fleet that loses a robot and is cut in two: does every chain lead to the owner?"""
    inspector, owners, dead = run_virtual(_worked(seed))
    chains = {section: inspector.causality.chain(section) for section in owners}
    right = sum(
        bool(chain) and (chain[-1].claim.owner, chain[-1].claim.phase) == owners[section]
        for section, chain in chains.items()
    )
    steps = [step for chain in chains.values() for step in chain[1:]]
    late = sum(not step.because or step.because[0].t_s > step.heard.t_s for step in steps)
    taken = [
        step for chain in chains.values() for before, step in itertools.pairwise(chain)
        if before.claim.owner == dead and step.claim.owner != dead
    ]  # fmt: skip
    shown = sum(any(cause.said_by == dead for cause in step.because[1:]) for step in taken)
    scope = "the log of one run: small, a robot killed, a cut and its heal"
    yield Figure(
        f"chains of frames that end at the owner all replicas have, of {len(owners)}", right,
        "sections", f"= {len(owners)}", right == len(owners), ALONE, scope,
    )  # fmt: skip
    yield Figure(
        f"steps without an earlier cause, of {len(steps)}", late, "steps", "= 0", late == 0, ALONE,
        scope,
    )  # fmt: skip
    yield Figure(
        f"takeovers from the dead robot shown with its last frame, of {len(taken)}", shown,
        "takeovers", f"= {len(taken)}", shown == len(taken), ALONE, scope,
    )  # fmt: skip


async def _worked(seed: int) -> tuple[Inspector, dict[int, tuple[int, Phase]], int]:
    """What a listener heard; the owner and phase of each section; the robot that was killed."""
    rng, inspector = Random(seed), Inspector()
    dead = rng.randrange(1, 3)
    cluster = Cluster(FieldSetup(load("small").changed(seed=seed)), f"why {seed}")
    cluster.segment.taps.append(lambda t_us, frame: inspector.hear(t_us / 1e6, frame))
    cluster.boot_all()
    try:
        await elapse(rng.uniform(20.0, 50.0))
        cluster.kill(dead)
        await elapse(rng.uniform(10.0, 30.0))
        cluster.partition([{0}, {1, 2}])
        await elapse(rng.uniform(5.0, 20.0))
        cluster.segment.wire.heal()
        loop = asyncio.get_running_loop()
        while not cluster.finished and loop.time() < WORK_LIMIT_S:
            await elapse(5.0)
        allocation = cluster.robots[0].peer.allocation
        owners = {s: allocation.entry(s) for s in allocation.sections()}
        return inspector, {s: (c.owner, c.phase) for s, c in owners.items()}, dead
    finally:
        await cluster.close()


def _screen(robots: int, seed: int) -> Iterator[Figure]:
    if find_spec("textual") is None:
        return
    from tools.inspect.screen import LOOKS_A_SECOND

    frames = run_virtual(_heard(robots, seed))
    cpu_ms, looks = asyncio.run(_shown(frames))
    share = cpu_ms / 1e3 * LOOKS_A_SECOND
    yield Figure(
        f"share of one core that the inspector's screen takes, {robots} robots", share, "share",
        "<= 0.25", share <= 0.25, f"{looks} looks of {cpu_ms:.0f} ms",
        "CPU time of hearing the bus, layout and drawing",
    )  # fmt: skip


async def _heard(robots: int, seed: int) -> list[tuple[int, Frame]]:
    fleet, frames = ProtocolFleet(robots, seed), list[tuple[int, Frame]]()
    fleet.segment.taps.append(lambda t_us, frame: frames.append((t_us, frame)))
    try:
        await fleet.until_working()
        await elapse(20.0)
        return frames
    finally:
        await fleet.close()


async def _shown(frames: Sequence[tuple[int, Frame]]) -> tuple[float, int]:
    """Milliseconds of CPU a look, and how many looks."""
    from tools.inspect.screen import LOOKS_A_SECOND, InspectScreen

    async def nothing(screen: InspectScreen) -> None: ...

    inspector = Inspector()
    screen = InspectScreen(inspector, "bench", nothing)
    looks, spent_s = 0, 0.0
    async with screen.run_test(size=(150, 42)) as pilot:
        due_at_us = frames[0][0]
        begun_s = time.process_time()
        for t_us, frame in frames:
            inspector.hear(t_us / 1e6, frame)
            if t_us >= due_at_us:
                due_at_us += 1_000_000 // LOOKS_A_SECOND
                screen.look()
                await pilot.pause()
                looks += 1
        spent_s = time.process_time() - begun_s
    return spent_s / looks * 1e3, looks
