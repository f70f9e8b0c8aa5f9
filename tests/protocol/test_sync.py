"""Anti-entropy between real `Sync` objects on the real wire model."""

from random import Random

import pytest

from crdt import FieldAllocationCRDT, Phase, Progress
from protocol.codec import decode_once, encode
from protocol.sync import Sync
from sim.wire import Wire

HEARTBEAT_US = 500_000
END_US = 60_000_000


class Peers:
    """N replicas that exchange nothing but sync frames; heartbeats are told to each directly."""

    def __init__(self, size: int, seed: int) -> None:
        self.wire, self.rng = Wire(seed), Random(seed)
        self.nodes = [self.wire.attach() for _ in range(size)]
        self.allocations = [FieldAllocationCRDT() for _ in range(size)]
        self.progress = [Progress() for _ in range(size)]
        self.syncs = [
            Sync(slot, a, p)
            for slot, (a, p) in enumerate(zip(self.allocations, self.progress, strict=True))
        ]
        self.islands = [set(range(size))]
        self.frames = 0
        self.now_us, self.next_beat_us = 0, HEARTBEAT_US
        self.see()

    def see(self) -> None:
        for slot, sync in enumerate(self.syncs):
            sync.live(frozenset(next(i for i in self.islands if slot in i)))

    def beat(self) -> None:
        for island in self.islands:
            digests = {slot: self.syncs[slot].digest for slot in island}
            for slot in island:
                for other, digest in digests.items():
                    if other != slot and self.rng.random() >= self.wire.faults.loss:
                        self.syncs[slot].heard_digest(other, digest, self.now_us)

    def run(self, until_us: int) -> None:
        while self.now_us < until_us:
            deadlines = [s.deadline_us for s in self.syncs if s.deadline_us is not None]
            wire_us = [self.wire.next_us] if self.wire.next_us is not None else []
            self.now_us = max(self.now_us, min(*deadlines, *wire_us, self.next_beat_us, until_us))
            for delivery in self.wire.advance(self.now_us):
                _, message = decode_once(delivery.frame)
                for receiver in delivery.receivers:
                    self.syncs[receiver].receive(delivery.sender, message, delivery.t_us)
            if self.now_us >= self.next_beat_us:
                self.next_beat_us += HEARTBEAT_US
                self.beat()
            for slot, sync in enumerate(self.syncs):
                for message in sync.tick(self.now_us):
                    self.frames += 1
                    self.wire.submit(self.nodes[slot], encode(message, 128 + slot), self.now_us)

    @property
    def equal(self) -> bool:
        return len({s.digest for s in self.syncs}) == 1

    def write(self, slot: int, section: int) -> None:
        """An operation that every peer of the island hears at once."""
        key = self.allocations[slot].claim(section, slot)
        assert key is not None
        block, bits = self.progress[slot].cover(section, 0)
        for other in next(i for i in self.islands if slot in i):
            if other != slot:
                self.allocations[other].apply(section, key)
                self.progress[other].apply(section, block, bits)
            self.syncs[other].changed_here(section, block)


def cut(size: int, seed: int) -> Peers:
    """A fleet that agreed on 20 sections, was cut, and worked on 10 more on each side."""
    peers = Peers(size, seed)
    for section in range(20):
        peers.write(section % size, section)
    peers.run(2_000_000)
    half = size // 2
    peers.islands = [set(range(half)), set(range(half, size))]
    peers.see()
    for k in range(10):
        peers.write(k % half, 100 + k)
        peers.write(half + k % (size - half), 200 + k)
    peers.run(4_000_000)
    return peers


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("size", [2, 6, 20])
def test_two_halves_become_equal(size: int, seed: int) -> None:
    peers = cut(size, seed)
    assert not peers.equal
    peers.islands = [set(range(size))]
    peers.see()
    before = peers.frames
    peers.run(8_000_000)
    assert peers.equal and not any(s.synchronizing for s in peers.syncs), f"seed {seed}"
    said = peers.frames - before
    assert said <= 3 * 40, f"{said} frames for 20 registers and 20 blocks; seed {seed}"


@pytest.mark.parametrize("seed", range(5))
def test_lossy_halves_become_equal_too(seed: int) -> None:
    peers = cut(6, seed)
    peers.wire.faults.loss = 0.2
    peers.islands = [set(range(6))]
    peers.see()
    peers.run(END_US)
    assert peers.equal, f"seed {seed}"


def test_a_fresh_join_is_told_everything_once() -> None:
    peers = Peers(5, 1)
    peers.islands = [{0, 1, 2, 3}, {4}]
    peers.see()
    for section in range(200):
        peers.write(section % 4, section)
    peers.run(3_000_000)
    peers.islands = [{0, 1, 2, 3, 4}]
    peers.see()
    peers.syncs[4].joined(peers.now_us, HEARTBEAT_US)
    before, begun_us = peers.frames, peers.now_us
    while not peers.equal and peers.now_us < begun_us + 10_000_000:
        peers.run(peers.now_us + 100_000)
    assert peers.equal
    assert peers.frames - before <= 420, "400 entries, and the asking"
    assert peers.allocations[4].phase_of(199) is Phase.CLAIMED


def test_peers_in_step_say_nothing() -> None:
    peers = Peers(6, 1)
    for section in range(50):
        peers.write(section % 6, section)
    peers.run(20_000_000)
    assert peers.frames == 0 and all(s.in_step for s in peers.syncs)
