"""Faults by machines that should not be on this bus: of other makers, with a robot's identity, or
faulty.

Their frames are malformed, false or meant for others. No robot may believe them, and no effect may
remain when they are gone; the rules of `sim/chaos/verdict.py` check that.
"""

from collections.abc import Iterator
from random import Random
from typing import Final

from agent.interface.config import ADDRESS_FIRST, ADDRESS_LAST, BEATS, MS, PEERS_MAX, S
from agent.interface.lifecycle import State
from crdt import Phase
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import NOBODY, Heartbeat, Member, Pose
from protocol.frames.frame import Frame
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.work_frames import TaskClaim, WorkProgress
from protocol.name import Name, fleet_name
from sim.fleet.foreign_devices import device, times
from sim.fleet.scheduler import Script
from sim.fleet.simulated_fleet import Cluster
from sim.scenarios import scenario as kinds

# Source addresses below those of robots; `sim/fleet/foreign_devices.py` has those up to 120.
CLAIMED_ADDRESS: Final = 121
UNCLAIMED_ADDRESS: Final = 122
TWIN_ADDRESS: Final = 124
NONSENSE_ADDRESS: Final = 125
FOREIGN_NAME: Final = Name(77, manufacturer=100, function=61, device_class=7)
FOREIGN_PF, FOREIGN_GROUPS = 0xFF, 0x1A  # PGN 0xFF00 to 0xFF19: those that robots use
FOREIGN_US: Final = 20 * MS  # between two frames: 3 % of the bus
# Share of bytes that are 0xFF; share up to which the rest are small numbers.
FILLED, SMALL = 0.4, 0.8
BEATS_A_HEARTBEAT: Final = 4
TWIN_PLACE_M: Final = 8.0  # the twin reports a position within this distance of the middle
NONSENSE_US: Final = 100 * MS
SAID_US: Final = 1 * S  # time in which 108 claims have left
# Above `EPOCH_EXPLAINED_MAX`. An epoch that is repeated for 3 s is believed
# (`agent/peer/work_admission.py`), so all kinds take turns.
EPOCH_LEAST, EPOCH_MOST = 100, 255
SECTION_BEYOND: Final = 60_000  # section numbers from here are in no field
OWNER_BEYOND: Final = 200  # slots from here are in no fleet
HASH_FLIPS: Final = 0x5A5A5A  # flipped bits of a field hash: another field


def foreign(cluster: Cluster, fault: kinds.Foreign, rng: Random) -> Script[None]:
    """A device of another maker uses the proprietary groups for its own data, each in turn."""
    address = CLAIMED_ADDRESS if fault.claims else UNCLAIMED_ADDRESS
    with device(cluster, {address: FOREIGN_NAME} if fault.claims else {}) as bus:
        for turn, due_at_us in enumerate(times(cluster, fault.for_s, FOREIGN_US)):
            yield due_at_us
            pgn = FOREIGN_PF << 8 | turn % FOREIGN_GROUPS
            identifier = rng.randrange(8) << 26 | pgn << 8 | address
            bus.submit(Frame(identifier, bytes(_byte(rng) for _ in range(8))))


def twin(cluster: Cluster, fault: kinds.Twin, rng: Random) -> Script[None]:
    """A second machine with a robot's slot and NAME sends beats, from its address or another
    one."""
    robot = cluster.robots[fault.robot]
    address = robot.peer.address if fault.same_address else TWIN_ADDRESS
    if address is None:
        return
    x_m, y_m = rng.uniform(-TWIN_PLACE_M, TWIN_PLACE_M), rng.uniform(-TWIN_PLACE_M, TWIN_PLACE_M)
    pose = Pose(x_m, y_m, 0.0, 0.0, State.IDLE, False, NOBODY)
    incarnation = (robot.peer.records.incarnation + 1) & 0xFFFF
    member = Member(fault.robot, incarnation, robot.peer.identity.field_hash)
    name, digest = robot.peer.identity.name.pack(), rng.randrange(1 << 24)
    cluster.acquaintance.doubled(fault.robot, cluster.host.now_us() + round(fault.for_s * S))
    cluster.stops.doubled(fault.robot)
    with device(cluster, {}) as bus:  # the twin sends its own claim
        bus.submit(encode(AddressClaimed(name), address))
        bus.submit(encode(member, address))
        for turn, due_at_us in enumerate(times(cluster, fault.for_s, BEATS[0].pose_period_us)):
            yield due_at_us
            bus.submit(encode(pose, address))
            if turn % BEATS_A_HEARTBEAT == 0:
                beat = Heartbeat(turn % 250, State.IDLE, False, False, True, False, 1.0, 0, digest)
                bus.submit(encode(beat, address))


def nonsense(cluster: Cluster, fault: kinds.Nonsense, rng: Random) -> Script[None]:
    """Impossible data: fields, work and addresses that no fleet can have."""
    address, said = _NONSENSE[fault.what](cluster, fault, rng)
    if address is None:
        return
    with device(cluster, {}) as bus:  # the device sends its own claim
        if fault.what == "claims":
            for taken in range(ADDRESS_FIRST, ADDRESS_LAST + 1):
                bus.submit(encode(AddressClaimed(0), taken))
            yield cluster.host.now_us() + SAID_US
            return
        for due_at_us in times(cluster, fault.for_s, NONSENSE_US):
            yield due_at_us
            bus.submit(encode(next(said), address))


def _another_field(
    cluster: Cluster, fault: kinds.Nonsense, rng: Random
) -> tuple[int | None, Iterator[Message]]:
    """A device with a robot's NAME of this fleet reports another field description."""
    claim = AddressClaimed(fleet_name(cluster.scenario.name, fault.robot).pack())
    if not fault.same_slot:
        claim = AddressClaimed(fleet_name(cluster.scenario.name, PEERS_MAX - 1).pack())
    field_hash = cluster.robots[fault.robot].peer.identity.field_hash ^ HASH_FLIPS
    member = Member(fault.robot if fault.same_slot else PEERS_MAX - 1, 1, field_hash)

    def said() -> Iterator[Message]:
        yield claim
        while True:
            yield member

    return NONSENSE_ADDRESS, said()


def _impossible_work(
    cluster: Cluster, fault: kinds.Nonsense, rng: Random
) -> tuple[int | None, Iterator[Message]]:
    """Sends from the address of a robot, so that receivers attribute the frames to it. They are signs of
    life of that robot, too, so its silence is not noticed meanwhile."""
    cluster.acquaintance.doubled(fault.robot, cluster.host.now_us() + round(fault.for_s * S))
    cluster.stops.doubled(fault.robot)
    sections = cluster.setting.section_count
    epochs = list(range(EPOCH_LEAST, EPOCH_MOST))
    rng.shuffle(epochs)

    def said() -> Iterator[Message]:
        turn = 0
        while True:
            lamport, phase = rng.randrange(1_000, 60_000), rng.choice((Phase.CLAIMED, Phase.DONE))
            section, beyond = rng.randrange(sections), SECTION_BEYOND + rng.randrange(1_000)
            owner = rng.randrange(cluster.scenario.fleet.robots)
            yield TaskClaim(beyond, 1, phase, 3, lamport, owner)
            yield TaskClaim(section, 1, phase, 3, lamport, OWNER_BEYOND + rng.randrange(50))
            yield TaskClaim(section, epochs[turn % len(epochs)], phase, 3, lamport, owner)
            # Each frame is an operation.
            yield TaskClaim(section, 9, phase, 3, rng.randrange(9), owner)
            yield WorkProgress(beyond, rng.randrange(8), rng.getrandbits(32))
            turn += 1

    return cluster.robots[fault.robot].peer.address, said()


def _every_address(
    cluster: Cluster, fault: kinds.Nonsense, rng: Random
) -> tuple[int | None, Iterator[Message]]:
    """NAME 0 wins every address that a robot may have."""
    return ADDRESS_FIRST, iter(())


_NONSENSE: Final = {
    "field": _another_field, "work": _impossible_work, "claims": _every_address,
}  # fmt: skip


def _byte(rng: Random) -> int:
    """A byte as machines fill their frames: 0xFF, a small number, or any value."""
    kind = rng.random()
    if kind < FILLED:
        return 0xFF
    return rng.randrange(12) if kind < SMALL else rng.randrange(256)
