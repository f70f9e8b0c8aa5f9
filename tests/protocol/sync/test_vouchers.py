"""What a revoked member said is taken out of replicas, and nothing that others said is lost."""

from random import Random

from hypothesis import given
from hypothesis import strategies as st

from crdt import FieldAllocationCRDT, Phase, Progress
from crdt.claim_register import pack
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress
from protocol.sync.replica import Replica
from protocol.sync.vouchers import RISES_MAX, UNKNOWN, Revocation, Vouchers

US, THIEF = 0, 3
DONE, CLAIMED, STARTED = int(Phase.DONE), int(Phase.CLAIMED), int(Phase.STARTED)
SECTIONS, UNITS = 4, 40
NOBODY_ELSE: frozenset[int] = frozenset()
Said = TaskClaim | StateSyncResponse | WorkProgress


def replica(units: int = UNITS, slot: int = US) -> Replica:
    made = Replica(FieldAllocationCRDT(), Progress(dict.fromkeys(range(SECTIONS), units)))
    made.vouchers = Vouchers(slot)
    return made


def void(compromised_at_us: int | None = None, live: frozenset[int] = NOBODY_ELSE) -> Revocation:
    return Revocation(THIEF, compromised_at_us, live)


def test_a_forged_end_is_taken_out_and_the_honest_claim_before_it_returns() -> None:
    ours = replica()
    ours.on_message(TaskClaim(0, 0, STARTED, 0, 5, 1), 1, 10)
    digest = ours.digest
    ours.on_message(StateSyncResponse(0, 0, DONE, 0, 9, 1), THIEF, 20)  # in the name of robot 1
    assert ours.allocation.done_count() == 1
    assert ours.void(void()) == ([0], [])
    assert ours.allocation.owner_of(0) == 1 and ours.allocation.phase_of(0) is Phase.STARTED
    assert ours.digest == digest and ours.allocation.done_count() == 0


def test_a_lie_that_was_told_twenty_times_is_taken_out_too() -> None:
    """A greater lie pushed the first one out of the kept ones, and it counted as honest."""
    ours = replica()
    ours.on_message(TaskClaim(0, 0, STARTED, 0, 5, 1), 1, 10)
    for lamport in range(100, 80, -1):  # an earlier Lamport time is the greater key
        ours.on_message(StateSyncResponse(0, 0, DONE, 0, lamport, 1), THIEF, 20)
    ours.void(void())
    assert ours.allocation.phase_of(0) is Phase.STARTED


def test_many_lies_push_out_nothing_that_was_said_before_the_stated_point() -> None:
    ours = replica()
    ours.on_message(TaskClaim(0, 0, STARTED, 0, 900, THIEF), THIEF, 10)
    for lamport in range(800, 700, -1):
        ours.on_message(TaskClaim(0, 0, STARTED, 0, lamport, THIEF), THIEF, 30)
    ours.void(void(compromised_at_us=20))
    assert ours.allocation.key(0) == pack(0, STARTED, 0, 900, THIEF)


def test_units_of_honest_members_are_remembered_for_the_next_revocation() -> None:
    told = Vouchers(US)
    for bits, sender, at_us in ((1, THIEF, 10), (2, 1, 2**40), (4, 2, 30), (1 << 39, THIEF, 40)):
        told.units(7, bits, sender, at_us)
    assert told.blocks_without(Revocation(THIEF, None, NOBODY_ELSE)) == {7: 1 | 1 << 39}
    assert told.blocks_without(Revocation(1, 2**40 + 1, NOBODY_ELSE)) == {}
    assert told.blocks_without(Revocation(1, 2**40, NOBODY_ELSE)) == {7: 2}
    assert told.blocks_without(Revocation(2, None, NOBODY_ELSE)) == {7: 4}
    assert told.blocks_without(Revocation(2, None, NOBODY_ELSE)) == {}


def test_what_it_said_before_the_stated_point_remains() -> None:
    ours = replica(2)
    ours.on_message(WorkProgress(0, 0, 0b11), THIEF, 10)
    ours.on_message(TaskClaim(0, 0, DONE, 0, 5, THIEF), THIEF, 10)
    ours.on_message(WorkProgress(2, 0, 0b1), THIEF, 10)
    ours.on_message(TaskClaim(1, 0, DONE, 0, 6, THIEF), THIEF, 30)
    ours.on_message(WorkProgress(2, 0, 0b11), THIEF, 30)
    assert ours.void(void(compromised_at_us=20)) == ([1], [2 << 8])
    assert ours.allocation.phase_of(0) is Phase.DONE and ours.allocation.key(1) is None
    assert ours.progress.bits(2, 0) == 0b1


def test_a_claim_of_the_revoked_member_goes_whoever_relayed_it() -> None:
    ours = replica()
    ours.on_message(StateSyncResponse(2, 0, DONE, 0, 5, THIEF), 1, 10)
    assert ours.void(void()) == ([2], []) and len(ours.allocation) == 0


def test_a_section_that_was_ended_because_of_void_units_is_free_again() -> None:
    ours = replica(2)
    ours.on_message(WorkProgress(0, 0, 0b10), THIEF, 10)
    ours.on_message(WorkProgress(0, 0, 0b01), 1, 11)
    ours.on_message(TaskClaim(0, 0, DONE, 0, 5, 1), 1, 12)
    assert ours.void(void()) == ([0], [0])
    assert ours.allocation.phase_of(0) is Phase.FREE and ours.progress.bits(0, 0) == 0b01


def test_a_section_that_was_ended_because_of_units_that_we_missed_is_free_too() -> None:
    ours = replica(2)
    ours.on_message(TaskClaim(0, 0, DONE, 0, 5, 1), 1, 12)  # the thief's units were lost here
    ours.void(void(live=frozenset({1})))
    assert ours.allocation.phase_of(0) is Phase.FREE


def test_the_end_of_a_section_comes_back_with_its_units() -> None:
    """All robots drop what they heard of others, and tell again what they did."""
    ours, others = replica(2), frozenset({1})
    ours.on_message(WorkProgress(0, 0, 0b11), 1, 11)
    ours.on_message(TaskClaim(0, 0, DONE, 0, 5, 1), 1, 12)
    digest = ours.digest
    assert ours.void(void(live=others)) == ([0], [0])
    assert ours.allocation.phase_of(0) is Phase.FREE
    ours.on_message(WorkProgress(0, 0, 0b11), 1, 20)
    assert ours.take_returned() == {0} and ours.allocation.phase_of(0) is Phase.DONE
    assert ours.digest == digest
    assert ours.void(void(live=others)) == ([0], [0]), "and its sender is known again"


def test_our_own_units_stay_although_the_thief_told_them_first() -> None:
    ours = replica()
    ours.on_message(WorkProgress(0, 0, 0b111), THIEF, 10)
    ours.changed_here(0, 0, 0b001, 20)
    ours.void(void())
    assert ours.progress.bits(0, 0) == 0b001


def test_a_robot_tells_nothing_in_its_own_name_that_it_has_not_said() -> None:
    """It would turn a lie into its own word, which no revocation takes out."""
    ours = replica(slot=1)
    heard = ours.on_message(StateSyncResponse(0, 0, STARTED, 0, 9, 1), THIEF, 20)
    assert not ours.may_tell(heard.entry)
    key = ours.allocation.release(0, 1)
    assert key is not None
    ours.changed_here(0, None, 0, 30)
    assert ours.may_tell(heard.entry)


def test_a_lie_in_our_name_that_we_alone_heard_does_not_stay_here_alone() -> None:
    """It was said before the stated point, so it stayed; and it was never told, so replicas differed."""
    ours = replica()
    assert ours.vouchers is not None
    key = ours.allocation.claim(1, US)
    assert key is not None
    ours.changed_here(1, None, 0, 5)
    ours.on_message(
        StateSyncResponse(1, *ours.allocation.entry(1)), 1, 8
    )  # our word, told back to us
    digest = ours.digest
    for section, phase in ((0, DONE), (1, DONE), (2, STARTED)):
        ours.on_message(StateSyncResponse(section, 3, phase, 0, 9, US), THIEF, 10)
    ours.void(void(compromised_at_us=20))
    assert ours.digest == digest and ours.allocation.key(1) == key
    ours.on_message(
        StateSyncResponse(2, 3, STARTED, 0, 9, US), 1, 30
    )  # from a robot that believes it
    assert ours.allocation.phase_of(2) is Phase.STARTED, "so that both have the same"


def test_a_robot_that_lost_its_memory_keeps_what_was_said_in_its_name() -> None:
    ours = replica()
    assert ours.vouchers is not None
    ours.vouchers.forgot = True
    ours.on_message(StateSyncResponse(0, 0, STARTED, 0, 9, US), 1, 10)
    ours.void(void(compromised_at_us=20))
    assert ours.allocation.phase_of(0) is Phase.STARTED


def test_a_robot_that_lost_its_memory_tells_what_it_is_told_in_its_own_name() -> None:
    """Found by `headland chaos --profile protocol+forger --seeds 13510048`: the robot that had told it
    restarted and forgot it, and the other one never told it to anybody."""
    ours = replica(slot=1)
    assert ours.vouchers is not None
    ours.vouchers.forgot = True
    heard = ours.on_message(StateSyncResponse(0, 0, DONE, 0, 9, 1), US, 20)
    assert ours.may_tell(heard.entry)


def test_what_nobody_known_told_before_a_restart_is_taken_out() -> None:
    ours = replica()
    assert ours.vouchers is not None
    ours.progress.apply(0, 0, 0b11)
    ours.vouchers.cover(0, 0b01)
    ours.vouchers.units(0, 0b10, UNKNOWN, 0)
    ours.void(void(compromised_at_us=1))
    assert ours.progress.bits(0, 0) == 0b01


def test_memory_of_one_section_is_bounded() -> None:
    vouchers = Vouchers(US)
    for lamport in range(5000, 0, -1):
        vouchers.register(0, pack(0, DONE, 0, lamport, 1), THIEF, 1)
        vouchers.register(0, pack(0, CLAIMED, 0, lamport, 1), 1, 1)
    said = vouchers.forget(0)
    assert {member: len(values) for member, values in said.items()} == {
        THIEF: RISES_MAX,
        1: RISES_MAX,
    }


CLAIMS = st.builds(
    TaskClaim, st.integers(0, 3), st.integers(0, 2), st.sampled_from([CLAIMED, STARTED, DONE]),
    st.integers(0, 3), st.integers(0, 20), st.integers(1, 2),
)  # fmt: skip
BLOCKS = st.builds(WorkProgress, st.integers(0, 3), st.just(0), st.integers(1, (1 << 40) - 1))


@given(st.lists(st.tuples(CLAIMS | BLOCKS, st.booleans()), max_size=30))
def test_after_it_the_replica_never_has_more_than_without_the_thief(
    said: list[tuple[TaskClaim | WorkProgress, bool]],
) -> None:
    """And its sums are those of its entries: digests of equal replicas stay equal."""
    ours, without = replica(), replica()
    for now_us, (message, forged) in enumerate(said):
        ours.on_message(message, THIEF if forged else 1 + message[0] % 2, now_us)
        if not forged:
            without.on_message(message, 1 + message[0] % 2, now_us)
    ours.void(void())
    for section in ours.allocation.sections():
        assert (ours.allocation.key(section) or 0) <= (without.allocation.key(section) or 0)
        assert without.progress.bits(section, 0) | ours.progress.bits(section, 0) == (
            without.progress.bits(section, 0)
        )
    again = Replica(FieldAllocationCRDT(), Progress(dict.fromkeys(range(4), 40)))
    for section, key in ours.allocation.entries().items():
        again.allocation.apply(section, key)
    for section, block, bits in ours.progress.entries():
        again.progress.apply(section, block, bits)
    assert again.digest == ours.digest
    assert again.allocation.done_count() == ours.allocation.done_count()


@given(st.lists(st.tuples(CLAIMS, st.sampled_from([1, 2, THIEF])), max_size=30), st.randoms())
def test_what_remains_is_the_greatest_that_owners_said_in_any_order(
    said: list[tuple[TaskClaim, int]], rng: Random
) -> None:
    """A slow model: per section, the maximum over all claims that their owner told."""
    said = [(claim, who if who == THIEF else claim.owner) for claim, who in said]
    model: dict[int, int] = {}
    for claim, who in said:
        if who == claim.owner:
            key = pack(claim.epoch, claim.phase, claim.bid, claim.lamport, claim.owner)
            model[claim.section] = max(model.get(claim.section, 0), key)
    for _ in range(2):
        ours = Replica(FieldAllocationCRDT(), Progress())
        ours.vouchers = Vouchers(US)
        for claim, who in said:
            ours.on_message(claim, who, 1)
        ours.void(void(live=frozenset({1, 2})))
        assert dict(ours.allocation.entries()) == model
        rng.shuffle(said)


class LossyFleet:
    """Robots that lose frames, repeat to each other what they hold, and do work that is their own.

    The slow model is a set of facts: what each honest robot did and said itself."""

    def __init__(self, rng: Random) -> None:
        self.rng = rng
        self.robots = {slot: replica(4, slot) for slot in range(3)}
        self.done: set[tuple[int, int]] = set()  # section and unit that a robot covered
        self.words: set[tuple[int, int]] = set()  # section and register that its owner wrote
        self.now_us = 0

    def say(self, message: Said, sender: int) -> None:
        self.now_us += 1
        for slot, robot in self.robots.items():
            if slot != sender and self.rng.random() < 0.6:
                robot.on_message(message, sender, self.now_us)

    def lie(self) -> None:
        section = self.rng.randrange(SECTIONS)
        if self.rng.random() < 0.5:
            self.say(WorkProgress(section, 0, self.rng.randrange(1, 16)), THIEF)
        else:
            phase, owner = self.rng.choice((STARTED, DONE)), self.rng.randrange(4)
            lamport = self.rng.randrange(1, 1000)
            epoch = self.rng.randrange(3)
            self.say(StateSyncResponse(section, epoch, phase, 0, lamport, owner), THIEF)

    def work(self) -> None:
        slot, section = self.rng.randrange(3), self.rng.randrange(SECTIONS)
        robot, unit = self.robots[slot], self.rng.randrange(4)
        block, bits = robot.progress.cover(section, unit)
        robot.changed_here(section, block, 1 << unit, self.now_us)
        self.done.add((section, unit))
        self.say(WorkProgress(section, block, bits), slot)
        allocation = robot.allocation
        if robot.progress.complete(section):
            key = allocation.done(section, slot)
        else:
            key = allocation.claim(section, slot) or allocation.takeover(section, slot)
        if key is not None:
            robot.changed_here(section, None, 0, self.now_us)
            self.words.add((section, key))
            self.say(TaskClaim(section, *allocation.entry(section)), slot)

    def repeat(self) -> None:
        slot = self.rng.randrange(3)
        entries = [e for e in self.robots[slot].entries() if self.robots[slot].may_tell(e)]
        if entries:
            self.say(self.robots[slot].message_of(self.rng.choice(entries)), slot)

    def agree(self) -> None:
        """Anti-entropy without losses, until nothing changes."""
        for _ in range(4):
            for slot, robot in self.robots.items():
                for entry in [e for e in robot.entries() if robot.may_tell(e)]:
                    for other, theirs in self.robots.items():
                        if other != slot:
                            theirs.on_message(robot.message_of(entry), slot, self.now_us)


@given(st.integers(0, 1 << 32))
def test_robots_that_lost_frames_keep_no_lie_and_lose_no_work(seed: int) -> None:
    """An honest robot repeated to others what it had from the thief, and they kept it."""
    rng = Random(seed)
    fleet = LossyFleet(rng)
    for _ in range(40):
        rng.choice((fleet.lie, fleet.work, fleet.repeat))()
    for slot, robot in fleet.robots.items():
        robot.void(Revocation(THIEF, None, frozenset({0, 1, 2}) - {slot}))
    fleet.agree()
    for robot in fleet.robots.values():
        known = {
            (section, unit)
            for section in range(SECTIONS)
            for unit in range(4)
            if robot.progress.has(section, unit)
        }
        assert known == fleet.done
        for section in range(SECTIONS):
            if robot.allocation.phase_of(section) is Phase.DONE:
                assert all((section, unit) in fleet.done for unit in range(4))
            key = robot.allocation.key(section)
            assert key is None or (section, key) in fleet.words
    first, *rest = fleet.robots.values()
    assert all(other.digest == first.digest for other in rest)
