"""Replicas under any order of operations, deliveries, merges and restarts: equal to one that keeps all.

S10 (joins commute, associate, repeat without harm), S11 (nothing comes back), S9 (nothing decreases).
"""

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from crdt import FieldAllocationCRDT, Progress
from crdt.stops import StopDot, StopSet
from tests.examples import examples

REPLICAS = 3
replicas = st.integers(0, REPLICAS - 1)
sections = st.integers(0, 3)
UNITS = dict.fromkeys(range(4), 70)


class Replicas(RuleBasedStateMachine):
    """What each wrote is kept in one list; anybody may hear any of it at any time, again and again."""

    def __init__(self) -> None:
        super().__init__()
        self.claims = [FieldAllocationCRDT() for _ in range(REPLICAS)]
        self.progress = [Progress(UNITS) for _ in range(REPLICAS)]
        self.stops = [StopSet() for _ in range(REPLICAS)]
        self.registers: list[tuple[int, int]] = []  # every register that was ever written
        self.blocks: list[tuple[int, int, int]] = []
        self.pressed: list[StopDot] = []
        self.cleared: list[StopDot] = []
        self.known = [dict[int, int]() for _ in range(REPLICAS)]

    @rule(who=replicas, section=sections, what=st.sampled_from(("claim", "start", "done", "release",
                                                                "takeover")))  # fmt: skip
    def write(self, who: int, section: int, what: str) -> None:
        key = getattr(self.claims[who], what)(section, who)
        if key is not None:
            self.registers.append((section, key))

    @rule(who=replicas, section=sections, unit=st.integers(0, 69))
    def cover(self, who: int, section: int, unit: int) -> None:
        block, bits = self.progress[who].cover(section, unit)
        self.blocks.append((section, block, bits))

    @rule(who=replicas)
    def press(self, who: int) -> None:
        dot = StopDot(who, 1, len(self.pressed))
        self.stops[who].press(dot)
        self.pressed.append(dot)

    @rule(who=replicas, which=st.integers(0, 1 << 16))
    def clear(self, who: int, which: int) -> None:
        if self.pressed:
            dot = self.pressed[which % len(self.pressed)]
            self.stops[who].clear(dot)
            self.cleared.append(dot)

    @rule(who=replicas, which=st.integers(0, 1 << 16))
    def hear(self, who: int, which: int) -> None:
        if self.registers:
            self.claims[who].apply(*self.registers[which % len(self.registers)])
        if self.blocks:
            self.progress[who].apply(*self.blocks[which % len(self.blocks)])
        if self.pressed:
            self.stops[who].press(self.pressed[which % len(self.pressed)])

    @rule(who=replicas, other=replicas)
    def merge(self, who: int, other: int) -> None:
        self.claims[who].merge(self.claims[other])
        self.progress[who].merge(self.progress[other])
        self.stops[who].merge(self.stops[other])

    @rule(who=replicas)
    def restart(self, who: int) -> None:
        """From its own bytes."""
        self.claims[who] = FieldAllocationCRDT.deserialize(self.claims[who].serialize())
        self.progress[who] = Progress.deserialize(self.progress[who].serialize(), UNITS)
        self.stops[who] = StopSet.deserialize(self.stops[who].serialize())

    @invariant()
    def only_grows(self) -> None:
        for known, replica in zip(self.known, self.claims, strict=True):
            entries = replica.entries()
            assert all(entries[section] >= key for section, key in known.items())
            known.update(entries)

    @invariant()
    def digests_are_those_of_the_state(self) -> None:
        for replica in self.claims:
            fresh = FieldAllocationCRDT()
            for section, key in sorted(replica.entries().items(), reverse=True):
                fresh.apply(section, key)
            assert fresh.digest == replica.digest

    def teardown(self) -> None:
        """All hear all: equal, and what a list of all operations says."""
        for who in range(REPLICAS):
            for other in range(REPLICAS):
                self.merge(who, other)
        for who in range(REPLICAS):
            self.merge(who, REPLICAS - 1)
        truth = dict[int, int]()
        for section, key in self.registers:
            truth[section] = max(key, truth.get(section, 0))
        bits = dict[tuple[int, int], int]()
        for section, block, new in self.blocks:
            bits[section, block] = bits.get((section, block), 0) | new
        for who in range(REPLICAS):
            assert dict(self.claims[who].entries()) == truth
            assert {(s, b): v for s, b, v in self.progress[who].entries()} == bits
            assert self.stops[who].active == set(self.pressed) - set(self.cleared)


TestReplicas = Replicas.TestCase
TestReplicas.settings = settings(max_examples=examples(60), stateful_step_count=40, deadline=None)
