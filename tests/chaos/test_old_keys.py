"""Somebody with the keys of before a revocation, at a fleet that has others now: frames alone."""

from collections.abc import Callable

import pytest

from agent.interface.config import MS, S
from crdt import Phase
from protocol.authentication import Keys
from protocol.frame_proofs import FleetTime, ProofBatch, ProofKeys
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Member
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.work_frames import TaskClaim, WorkProgress
from protocol.name import fleet_name
from sim.fleet.event_loop import EventLoop
from sim.fleet.foreign_devices import device
from sim.fleet.forgers import revocation
from sim.fleet.scheduler import Script
from sim.fleet.simulated_fleet import Cluster
from sim.scenarios.fleet_setup import DRAWN
from sim.scenarios.protocol_setup import ProtocolSetup, drill

SEED, REVOKED = 28, 2
AT_WORK_US, LATER_US = 8 * S, 5 * S
Tell = Callable[[Cluster, "Thief"], Script[None]]


class Thief:
    """A laptop with the old keys, and the fleet's time."""

    def __init__(self, cluster: Cluster, keys: Keys, slot: int, address: int) -> None:
        self.cluster, self.slot, self.address = cluster, slot, address
        now_us = cluster.host.now_us()
        clock = cluster.robots[0].peer.named.fleet_clock
        time = FleetTime(clock.time.at(now_us), now_us)
        time.known = True
        self.batch = ProofBatch(slot, ProofKeys(keys), time)

    def say(self, *messages: Message) -> Script[None]:
        """Frames and their proof."""
        now_us = self.cluster.host.now_us()
        with device(self.cluster, {}) as bus:
            for message in messages:
                bus.submit(encode(message, self.address))
                self.batch.add(message, now_us)
            proof = self.batch.seal(self.address, now_us)
            assert proof is not None
            bus.submit(encode(proof, self.address))
            yield now_us + 20 * MS

    def lie(self) -> Script[None]:
        """All sections are done, and all their units are covered."""
        for section in range(self.cluster.setting.section_count):
            done = TaskClaim(section, 1, Phase.DONE, 0, 900, self.slot)
            yield from self.say(done, WorkProgress(section, 0, (1 << 40) - 1))


def believed(cluster: Cluster, slots: tuple[int, ...]) -> int:
    """Sections that one of these robots believes to be done."""
    return sum(
        cluster.robots[slot].peer.allocation.phase_of(section) is Phase.DONE
        for slot in slots
        for section in range(cluster.setting.section_count)
    )


def play(slot: int, address: int | None, tell: Tell, revoked: bool) -> int:
    """How many sections the others believe to be done more than before the thief spoke, after 2 s.

    `address`: of the thief; None: that of the robot in whose name it speaks."""
    loop, others = EventLoop(), (0, 1)
    setting = ProtocolSetup(drill(3, SEED, keys=DRAWN))
    cluster = Cluster(setting, f"old keys {slot}/{revoked}", lambda *_: None, loop)
    setting.parade.checker()
    news: list[int] = []

    def main() -> Script[None]:
        cluster.boot_all()
        yield AT_WORK_US
        old = setting.keys
        assert old is not None
        if revoked:
            yield from revocation(cluster, REVOKED)
            yield cluster.host.now_us() + S
        source = cluster.robots[slot].peer.address if address is None else address
        assert source is not None
        cluster.kill(REVOKED)
        before = believed(cluster, others)
        yield from tell(cluster, Thief(cluster, old, slot, source))
        yield cluster.host.now_us() + 2 * S
        news.append(believed(cluster, others) - before)
        yield cluster.host.now_us() + LATER_US
        if revoked:
            for number in others:
                peer = cluster.robots[number].peer
                assert peer.membership.live == set(others) and peer.safety.may_move, number

    loop.run(main())
    cluster.end()
    return news[0]


def lies(cluster: Cluster, thief: Thief) -> Script[None]:
    yield from thief.lie()


def test_the_attack_works_with_the_keys_of_the_fleet() -> None:
    """Else the tests below would show nothing."""
    assert play(REVOKED, None, lies, revoked=False) > 4


@pytest.mark.parametrize("slot", [1, REVOKED])
def test_proofs_with_the_keys_of_before_a_revocation_prove_nothing_after_it(slot: int) -> None:
    assert play(slot, None, lies, revoked=True) <= 1, "one that a robot has really ended"


@pytest.mark.parametrize("slot", [0, REVOKED, 7])
def test_a_revoked_robot_that_comes_back_under_a_new_name_is_nobody(slot: int) -> None:
    def returns(cluster: Cluster, thief: Thief) -> Script[None]:
        yield from thief.say(AddressClaimed(fleet_name("somebody else", 9).pack()))
        for _ in range(5):
            yield from thief.say(Member(slot, 9, cluster.setting.config_hash))
            yield cluster.host.now_us() + 100 * MS
        yield from thief.lie()

    assert play(slot, 200, returns, revoked=True) <= 1, "one that a robot has really ended"
