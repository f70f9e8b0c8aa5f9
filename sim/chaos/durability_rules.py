"""What peers wrote to disk and what they sent, in order: the input of every durability campaign.

`lost` is the judge. It knows the rules (durable before revealed; brake and send a stop first) and
does not know how a journal works.
"""

import asyncio
from collections.abc import Container, Iterable, Iterator, Mapping
from random import Random

from agent.interface.effects import Effect, Persist, Send
from agent.peer.durable_records import (
    ELECTION,
    INCARNATION,
    OPERATIONS,
    PROGRESS,
    REGISTER,
    U16,
    U32,
    VOTE,
    key_of,
    units_of,
)  # fmt: skip
from agent.safety.stop_controller import HOLD_KEY, LATCHED, STOPS_KEY
from crdt import FieldAllocationCRDT, Phase, Progress
from crdt.claim_register import pack
from crdt.progress import BLOCK_UNITS
from crdt.stops import StopDot, StopSet
from protocol.frames.fleet_frames import Heartbeat, LeaderElectionVote, Member, Pose
from protocol.frames.messages import Message
from protocol.frames.safety_frames import EmergencyStop, Reason
from protocol.frames.work_frames import TaskClaim, WorkProgress
from sim.fleet.fault_injector import FaultPlan
from sim.fleet.simulated_disk import MemoryJournal
from sim.fleet.simulated_fleet import Cluster
from sim.fleet.virtual_clock import run_virtual
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import Reset, load

BEGUN = (Phase.STARTED, Phase.DONE)  # a robot that lost a claim only repeats units of others
STANDS = "that it stands until a person resets it"
Batch = tuple[Persist, ...]
Tape = list[Batch | Message]
Worked = Container[tuple[int, int]]


class RecordingJournal(MemoryJournal):
    """The `Journal` port; records each write on the tape as well."""

    def __init__(self, tape: Tape) -> None:
        super().__init__()
        self.tape = tape

    def write(self, records: Iterable[Persist]) -> None:
        """Keep the records, and note the whole batch on the tape."""
        batch = tuple(records)
        super().write(batch)
        self.tape.append(batch)


def record(seed: int, simulated_s: float = 180.0) -> dict[int, Tape]:
    """Three robots work a small field and are stopped and released many times; their tapes by
    slot."""
    rng = Random(f"{seed}/tape")
    resets = [Reset(at_s=float(at_s), kind="reset") for at_s in range(20, int(simulated_s), 15)]
    scenario = load("small").changed(3, seed).model_copy(update={"fault": resets})
    tapes: dict[int, Tape] = {slot: [] for slot in range(scenario.fleet.robots)}

    def keep(slot: int, now_us: int, effect: Effect) -> None:
        if isinstance(effect, Send):
            tapes[slot].append(effect.message)

    async def play() -> None:
        cluster = Cluster(FieldSetup(scenario), f"tape {seed}", keep)
        for slot, tape in tapes.items():
            cluster.journals[slot] = RecordingJournal(tape)
        cluster.boot_all()
        script = asyncio.create_task(FaultPlan(cluster).run())
        loop = asyncio.get_running_loop()
        while loop.time() < simulated_s:
            await asyncio.sleep(15.0)
            cluster.press(rng.choice(list(cluster.robots)), rng.choice(list(Reason)))
            cluster.check()
        assert not cluster.stops.violations
        script.cancel()
        await cluster.close()

    run_virtual(play())
    return tapes


def lost(
    revealed: Iterable[Message], recalled: Mapping[str, bytes], worked: Worked | None = None
) -> str:
    """The first of `losses`; empty if there is none."""
    return next(losses(revealed, recalled, worked), "")


def losses(
    revealed: Iterable[Message], recalled: Mapping[str, bytes], worked: Worked | None = None
) -> Iterator[str]:
    """Each thing that this robot has sent but would have lost, in words.

    `worked`: the units that some robot has worked in truth, as section and unit; None: all. What a
    thief told may be repeated, and is nobody's work."""
    # Progress of other robots, relayed to robots that lack it, is not ours.
    claims, owned = 0, set[int]()
    operations = _number(recalled, OPERATIONS, U32.size)
    stopped, sent, told_stops = False, set[StopDot](), set[StopDot]()
    for m in revealed:
        if isinstance(m, Member) and m.incarnation != _number(recalled, INCARNATION, U16.size):
            yield f"incarnation {m.incarnation}"
        if isinstance(m, LeaderElectionVote):
            raw = recalled.get(ELECTION, b"")
            if len(raw) != VOTE.size or VOTE.unpack(raw)[0] < m.term:
                yield f"the vote of term {m.term}"
        if isinstance(m, TaskClaim):
            claims += 1
            if m.phase in BEGUN:
                owned.add(m.section)
            told = pack(m.epoch, Phase(m.phase), m.bid, m.lamport, m.owner)
            if key_of(recalled.get(f"{REGISTER}{m.section}", b"")) < told or operations < claims:
                yield f"own operation {claims}: S{m.section} {Phase(m.phase).name}"
        if isinstance(m, WorkProgress) and m.section in owned:
            known = units_of(recalled.get(f"{PROGRESS}{m.section}/{m.block}", b""))
            if true_units(m, worked) & ~known:
                yield f"units of S{m.section}"
        if isinstance(m, EmergencyStop):
            sent.add(StopDot(m.slot, m.incarnation, m.counter))
        # The next frame after a stop: by then the stop must be on the disk.
        if isinstance(m, Pose | Heartbeat):
            stopped = m.stopped
            told_stops |= sent
    try:
        stops = StopSet.deserialize(recalled.get(STOPS_KEY, b"\0\0"))
    except ValueError:
        yield "every stop: the record on the disk is no stop set"
        return
    forgotten = {dot for dot in told_stops - stops.active if not stops.is_cleared(dot)}
    if forgotten:
        yield f"stops {sorted(forgotten)}"
    if stopped and recalled.get(HOLD_KEY) != LATCHED:
        yield STANDS


def unknown(
    revealed: Iterable[Message],
    allocation: FieldAllocationCRDT,
    progress: Progress,
    worked: Worked | None = None,
) -> str:
    """Own work that this robot has sent but that its replicas lack after a restart, before it
    receives any frame. Data that is on the disk but is not read counts as lost as well. Empty if
    nothing. `worked`: as for `lost`."""
    owned = set[int]()
    for m in revealed:
        if isinstance(m, TaskClaim):
            if m.phase in BEGUN:
                owned.add(m.section)
            if (allocation.key(m.section) or 0) < pack(
                m.epoch, Phase(m.phase), m.bid, m.lamport, m.owner
            ):
                return f"S{m.section} {Phase(m.phase).name}"
        if not isinstance(m, WorkProgress) or m.section not in owned:
            continue
        if true_units(m, worked) & ~progress.bits(m.section, m.block):
            return f"units of S{m.section}"
    return ""


def true_units(m: WorkProgress, worked: Worked | None) -> int:
    """The units in a frame that were worked in truth."""
    if worked is None:
        return m.bits
    first = m.block * BLOCK_UNITS
    return sum(1 << k for k in range(BLOCK_UNITS) if (m.section, first + k) in worked) & m.bits


def _number(recalled: Mapping[str, bytes], key: str, size: int) -> int:
    raw = recalled.get(key, b"")
    return int.from_bytes(raw, "little") if len(raw) == size else 0
