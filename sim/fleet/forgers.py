"""An attacker on the bus of a fleet with keys, at a stated position.

`outside`: it has no key. It says everything that would lose, invent or hide work, life or membership, in
the name of a robot, with guessed proofs and tags. `replaying`: it has no key, and repeats what it has
heard: at once, later, in another order, cut short, or with a changed bit. `inside`: it has the keys
of a robot that it has stolen. It says what is not true of the work of all, in the name of that robot and
with valid proofs. After half of its time the owner revokes the robot, and what it has said is void.

What each position can do is in `docs/how/trust.md`.
"""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from random import Random
from typing import Final

from agent.interface.config import MS, S
from agent.interface.lifecycle import State
from crdt import Phase
from protocol.authentication import KEY_SIZE
from protocol.frame_proofs import FleetTime, ProofBatch, ProofKeys
from protocol.frames.codec import decode_once, encode
from protocol.frames.fleet_frames import Heartbeat, LeaderElectionVote, Member, VectorSlice
from protocol.frames.frame import Frame
from protocol.frames.key_frames import PART_BYTES, KeyPart, KeysHeld, KeySwitch
from protocol.frames.messages import Message, configuration_hash
from protocol.frames.safety_frames import Command, EmergencyReset, HeldReset, OperatorCommand
from protocol.frames.trust_frames import FleetTimeTold, Proof
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress
from protocol.rekeying import Rekeying, confirmed, own_key, seal
from sim.fleet.foreign_devices import device, times
from sim.fleet.scheduler import Script
from sim.fleet.simulated_fleet import OPERATOR, Cluster
from sim.scenarios import scenario as kinds

FORGED_US: Final = 10 * MS  # between two frames: 6 % of the bus
LIES_OF_OTHERS: Final = (
    0.4  # share of what a thief says: some dozens a section before its revocation
)
LIES_LAMPORT: Final = 60_000  # of the first one; an earlier time is the greater key
REVOKED_AFTER: Final = 0.5  # share of the time of a thief
KEPT: Final = 400  # frames that a replaying attacker remembers: some seconds of a small fleet
UNITS_MASK: Final = (1 << 40) - 1
PARTS_US: Final = 4 * MS  # between two parts of new keys
SWITCHES: Final = 5
ROUNDS_MAX: Final = 10  # of new keys until all confirm them; the tool goes on for some seconds


def forger(cluster: Cluster, fault: kinds.Forger, rng: Random) -> Script[None]:
    """What the fault says, for its time."""
    if fault.position == "replaying":
        yield from _replay(cluster, fault, rng)
    elif fault.position == "inside":
        yield from _thief(cluster, fault, rng)
    else:
        yield from _outsider(cluster, fault, rng)


def _outsider(cluster: Cluster, fault: kinds.Forger, rng: Random) -> Script[None]:
    with device(cluster, {}) as bus:
        for due_at_us in times(cluster, fault.for_s, FORGED_US):
            yield due_at_us
            address = _address(cluster, fault.robot)
            if address is not None:
                bus.submit(encode(forged(cluster, fault.robot, rng), address))


def _replay(cluster: Cluster, fault: kinds.Forger, rng: Random) -> Script[None]:
    heard: deque[Frame] = deque(maxlen=KEPT)

    def keep(t_us: int, frame: Frame) -> None:
        if frame.data:
            heard.append(frame)

    with _listening(cluster, keep), device(cluster, {}) as bus:
        for due_at_us in times(cluster, fault.for_s, FORGED_US):
            yield due_at_us
            if heard:
                bus.submit(_spoilt(rng.choice(heard), rng))


@contextmanager
def _listening(cluster: Cluster, keep: Callable[[int, Frame], None]) -> Iterator[None]:
    """Pass on every frame of the bus with its time, while it lasts."""
    cluster.segment.taps.append(keep)
    try:
        yield
    finally:
        cluster.segment.taps = [tap for tap in cluster.segment.taps if tap != keep]


def _thief(cluster: Cluster, fault: kinds.Forger, rng: Random) -> Script[None]:
    """The machine is gone from the field's bus; a laptop with its keys speaks from its address."""
    robot, setting = fault.robot, cluster.setting
    address = _address(cluster, robot)
    if address is None or setting.keys is None or not cluster.is_up(robot):
        return
    clock = cluster.robots[robot].peer.named.fleet_clock
    time = FleetTime(clock.time.at(cluster.host.now_us()), cluster.host.now_us())
    time.known = True
    batch = ProofBatch(robot, ProofKeys(setting.keys), time)
    cluster.kill(robot)
    begun_at_us = cluster.host.now_us()
    revoked = False
    with device(cluster, {}) as bus:
        for due_at_us in times(cluster, fault.for_s, FORGED_US):
            yield due_at_us
            if not revoked and due_at_us - begun_at_us >= fault.for_s * S * REVOKED_AFTER:
                revoked = True
                cluster.host.spawn(revocation(cluster, robot))
            message = insider(cluster, robot, rng)
            if cluster.on_lie is not None:
                cluster.on_lie(message)
            bus.submit(encode(message, address))
            batch.add(message, due_at_us)
            proof = batch.seal(address, due_at_us)
            assert proof is not None
            bus.submit(encode(proof, address))


def revocation(cluster: Cluster, robot: int) -> Script[None]:
    """The owner gives the others new keys and makes them switch, as `headland keys revoke` does.

    What a robot does not confirm is said again: one that has just started drops frames of a tool that it
    does not know yet."""
    setting, others = cluster.setting, {r.slot for r in cluster.running if r.slot != robot}
    assert setting.keys is not None and setting.root is not None
    generation = 1 + max((r.peer.named.keys.generation for r in cluster.running), default=0)
    lot = Random(f"{cluster.scenario.run.seed}/revocation/{generation}")
    new = Rekeying(generation, lot.randbytes(KEY_SIZE), robot)
    heard: list[KeysHeld] = []

    def keep(t_us: int, frame: Frame) -> None:
        message = decode_once(frame)[1]
        if isinstance(message, KeysHeld):
            heard.append(message)

    with _listening(cluster, keep):
        for _ in range(ROUNDS_MAX):
            for slot in sorted(others - confirmed(new, heard, False)):
                for part in seal(new, own_key(setting.root, slot), slot):
                    cluster.inject(part)
                    yield cluster.host.now_us() + PARTS_US
            yield cluster.host.now_us() + S // 2
            if others <= confirmed(new, heard, False):
                break
        for _ in range(ROUNDS_MAX):
            for _ in range(SWITCHES):
                cluster.inject(new.switch())
                yield cluster.host.now_us() + PARTS_US
            if confirmed(new, heard, False) <= confirmed(new, heard, True):
                break
            yield cluster.host.now_us() + S // 2
    cluster.rekeyed(new.keys)


# -------------------------------------------------------------------- what they say


def insider(cluster: Cluster, robot: int, rng: Random) -> Message:
    """What a member may say, and what is not true: work that it and others claim, begin and end.

    Of others it says each time something greater, so that each lie changes the register again."""
    section = rng.randrange(cluster.setting.section_count)
    if rng.random() < LIES_OF_OTHERS:
        owner = rng.randrange(cluster.scenario.fleet.robots)
        told_phase = rng.choice((Phase.STARTED, Phase.DONE, Phase.DONE))
        lamport = LIES_LAMPORT - cluster.host.now_us() // FORGED_US % LIES_LAMPORT
        return StateSyncResponse(section, 1, told_phase, 0, lamport, owner)
    phase = rng.choice((Phase.CLAIMED, Phase.STARTED, Phase.DONE))
    if rng.random() < 0.3:
        return WorkProgress(section, rng.randrange(8), rng.getrandbits(40) & UNITS_MASK)
    if rng.random() < 0.1:
        return Heartbeat(1, State.IDLE, False, False, True, False, 1.0, 0, rng.getrandbits(24))
    return TaskClaim(section, rng.randrange(3), phase, 0, rng.randrange(1_000, 60_000), robot)


def forged(cluster: Cluster, robot: int, rng: Random) -> Message:
    """One of the frames that would lose, invent or hide work, life or membership, or release a stop."""
    return rng.choice(FORGERIES)(cluster, robot, rng)


def _claim(cluster: Cluster, robot: int, rng: Random) -> Message:
    section, phase = rng.randrange(cluster.setting.section_count), rng.choice(list(Phase))
    made = rng.choice((TaskClaim, StateSyncResponse))
    return made(section, rng.randrange(256), phase, 0, rng.randrange(60_000), robot)


def _progress(cluster: Cluster, robot: int, rng: Random) -> Message:
    section = rng.randrange(cluster.setting.section_count)
    return WorkProgress(section, rng.randrange(8), UNITS_MASK)


def _farewell(cluster: Cluster, robot: int, rng: Random) -> Message:
    return Heartbeat(255, State.IDLE, False, False, True, True, 1.0, 0, rng.getrandbits(24))


def _life(cluster: Cluster, robot: int, rng: Random) -> Message:
    return Heartbeat(rng.randrange(250), State.WORKING, False, False, True, False, 1.0,
                     rng.randrange(1 << 16), rng.getrandbits(24))  # fmt: skip


def _member(cluster: Cluster, robot: int, rng: Random) -> Message:
    slot = rng.randrange(cluster.scenario.fleet.robots)
    return Member(slot, rng.randrange(1 << 16), configuration_hash(cluster.setting.config_hash))


def _vote(cluster: Cluster, robot: int, rng: Random) -> Message:
    return LeaderElectionVote(0, rng.randrange(256), robot)


def _clock(cluster: Cluster, robot: int, rng: Random) -> Message:
    return VectorSlice(0, tuple(rng.randrange(256) for _ in range(7)))


def _proof(cluster: Cluster, robot: int, rng: Random) -> Message:
    sender = rng.choice((robot, OPERATOR))
    return Proof(sender, rng.randrange(1, 5), rng.getrandbits(12), rng.getrandbits(40))


def _time(cluster: Cluster, robot: int, rng: Random) -> Message:
    return FleetTimeTold(rng.randrange(2), rng.getrandbits(56))


def _reset(cluster: Cluster, robot: int, rng: Random) -> Message:
    fresh, tag = rng.randrange(256), rng.getrandbits(24)
    return rng.choice((
        EmergencyReset(robot, 1, rng.randrange(4), OPERATOR, fresh, tag),
        HeldReset(rng.getrandbits(24), OPERATOR, fresh, tag),
        OperatorCommand(Command.MANUAL_RESET, 255, OPERATOR, 0, fresh, tag),
        OperatorCommand(Command.START, 255, OPERATOR, 0, fresh, tag),
    ))  # fmt: skip


def _keys(cluster: Cluster, robot: int, rng: Random) -> Message:
    if rng.random() < 0.5:
        return KeySwitch(1, rng.getrandbits(48))
    return KeyPart(robot, 1, rng.randrange(7), rng.randbytes(PART_BYTES))


Forgery = Callable[[Cluster, int, Random], Message]
FORGERIES: Final[tuple[Forgery, ...]] = (
    _claim, _claim, _progress, _farewell, _life, _member, _vote, _clock, _proof, _time, _reset,
    _keys,
)  # fmt: skip


def _spoilt(frame: Frame, rng: Random) -> Frame:
    """As it was, cut short, or with another bit."""
    kind = rng.random()
    if kind < 0.6:
        return frame
    if kind < 0.8:
        return frame._replace(data=frame.data[: rng.randrange(len(frame.data))])
    data = bytearray(frame.data)
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return frame._replace(data=bytes(data))


def _address(cluster: Cluster, robot: int) -> int | None:
    return cluster.robots[robot].peer.address if robot in cluster.robots else None
