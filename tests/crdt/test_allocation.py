"""The laws of the allocation, against a slow model that keeps every operation ever made."""

from itertools import permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crdt import Claim, FieldAllocationCRDT, Phase

OPS = st.lists(
    st.tuples(
        st.integers(0, 2),  # replica
        st.sampled_from(["claim", "start", "done", "release", "takeover", "sync"]),
        st.integers(0, 2),  # section
        st.integers(0, 31),  # bid, or whom to hear
    ),
    max_size=40,
)
Operation = tuple[int, str, int, int]


class Model:
    """Every key ever written or heard, and the obvious order of what they mean."""

    def __init__(self) -> None:
        self.heard: dict[int, set[int]] = {}

    def hear(self, section: int, key: int) -> None:
        self.heard.setdefault(section, set()).add(key)

    def winner(self, section: int) -> Claim:
        def rank(claim: Claim) -> tuple[bool, int, int, int, int, int]:
            return (
                claim.phase is Phase.DONE, claim.epoch, claim.phase.value,
                -claim.bid, -claim.lamport, -claim.owner,
            )  # fmt: skip

        return max((Claim.unpack(key) for key in self.heard[section]), key=rank)


def play(operations: list[Operation]) -> tuple[list[FieldAllocationCRDT], list[Model]]:
    replicas, models = [FieldAllocationCRDT() for _ in range(3)], [Model() for _ in range(3)]
    for r, what, section, number in operations:
        replica = replicas[r]
        if what == "sync":
            replica.merge(replicas[number % 3])
            for other_section, keys in models[number % 3].heard.items():
                for heard in keys:
                    models[r].hear(other_section, heard)
            continue
        act = getattr(replica, what)
        key = act(section, r, number) if what in ("claim", "takeover") else act(section, r)
        if key is not None:
            models[r].hear(section, key)
    return replicas, models


def copy(replica: FieldAllocationCRDT) -> FieldAllocationCRDT:
    return FieldAllocationCRDT.deserialize(replica.serialize())


def joined(*replicas: FieldAllocationCRDT) -> FieldAllocationCRDT:
    result = FieldAllocationCRDT()
    for replica in replicas:
        result.merge(replica)
    return result


@given(OPS)
def test_merge_is_commutative_associative_and_idempotent(operations: list[Operation]) -> None:
    (a, b, c), _ = play(operations)
    assert joined(a, b) == joined(b, a)
    assert joined(joined(a, b), c) == joined(a, joined(b, c))
    assert joined(a, a) == a


@given(OPS)
def test_merge_is_inflationary(operations: list[Operation]) -> None:
    (a, b, _), _ = play(operations)
    before = dict(a.entries())
    a.merge(b)
    assert all(a.entries()[section] >= key for section, key in before.items())


@given(OPS)
def test_state_is_what_the_model_says(operations: list[Operation]) -> None:
    replicas, models = play(operations)
    for replica, model in zip(replicas, models, strict=True):
        for section in model.heard:
            assert replica.entry(section) == model.winner(section)


@given(OPS)
def test_a_delta_is_as_good_as_the_state(operations: list[Operation]) -> None:
    (a, b, _), _ = play(operations)
    by_state, by_delta = copy(b), copy(b)
    by_state.merge(a)
    for section, key in a.delta(0):
        by_delta.apply(section, key)
    assert by_state == by_delta


@given(OPS)
def test_the_digest_kept_up_is_the_digest_from_scratch(operations: list[Operation]) -> None:
    replicas, _ = play(operations)
    for replica in replicas:
        assert replica.digest == copy(replica).digest


@given(OPS)
def test_done_is_never_undone(operations: list[Operation]) -> None:
    (a, b, c), _ = play(operations)
    done = {s for r in (a, b, c) for s in r.sections() if r.phase_of(s) is Phase.DONE}
    everything = joined(a, b, c)
    assert all(everything.phase_of(section) is Phase.DONE for section in done)
    assert everything.done_count() == len(done)


@given(st.binary(max_size=64))
def test_deserialize_takes_or_refuses_any_bytes(data: bytes) -> None:
    try:
        replica = FieldAllocationCRDT.deserialize(data)
    except ValueError:
        return
    assert FieldAllocationCRDT.deserialize(replica.serialize()) == replica


def test_ancestor_three_claims_with_skewed_clocks_have_one_winner() -> None:
    """The rule 'happens-before, then wall clock, then name' gave three owners in six orders:
    A claims with a fast clock, B saw A and claims, C claims without having seen either."""
    a, b, c = (FieldAllocationCRDT() for _ in range(3))
    a.claim(7, 1)
    b.merge(a)
    b.takeover(7, 2)
    c.claim(7, 3)
    owners = {joined(*order).owner_of(7) for order in permutations((a, b, c))}
    assert owners == {2}, "B saw A and took over: nothing concurrent outranks that"


def test_ancestor_rule_itself_gives_three_owners_in_six_orders() -> None:
    """What we do not do: afs_fastapi merged by vector clock, else wall clock, else name. The same
    three entries, joined in six orders, end with three owners: the rule is not transitive."""
    entries = {
        "A": ({"A": 1}, 100.0),  # claimed first, by a robot whose clock is fast
        "B": ({"A": 1, "B": 1}, 10.0),  # saw A, claimed after it
        "C": ({"C": 1}, 50.0),  # saw neither
    }

    def ancestor(first: str, second: str) -> str:
        (a, a_s), (b, b_s) = entries[first], entries[second]
        if all(b.get(k, 0) >= v for k, v in a.items()):
            return second
        if all(a.get(k, 0) >= v for k, v in b.items()):
            return first
        return first if (a_s, first) > (b_s, second) else second

    winners = {ancestor(ancestor(x, y), z) for x, y, z in permutations("ABC")}
    assert winners == {"A", "B", "C"}


def test_ancestor_a_late_claim_does_not_rob_started_work() -> None:
    """In the ancestor the last claim won, even against a robot at work."""
    worker, late = FieldAllocationCRDT(), FieldAllocationCRDT()
    worker.claim(7, 1, bid=20)
    worker.start(7, 1)
    late.claim(7, 2, bid=0)
    assert joined(worker, late).owner_of(7) == joined(late, worker).owner_of(7) == 1


def test_release_by_another_changes_nothing() -> None:
    replica = FieldAllocationCRDT()
    replica.claim(7, 1)
    assert replica.release(7, 2) is None and replica.owner_of(7) == 1


def test_a_zombie_owner_is_fenced() -> None:
    """The taken-over owner comes back and starts: its epoch is behind."""
    zombie, taker = FieldAllocationCRDT(), FieldAllocationCRDT()
    zombie.claim(7, 1)
    taker.merge(zombie)
    taker.takeover(7, 2)
    zombie.start(7, 1)
    assert joined(zombie, taker).owner_of(7) == 2


def test_epochs_end_at_their_limit() -> None:
    replica = FieldAllocationCRDT()
    replica.claim(7, 1)
    for _ in range(300):
        replica.takeover(7, 2 if replica.owner_of(7) == 1 else 1)
    assert replica.entry(7).epoch == 255 and replica.done(7, 1) is not None


def test_replicas_of_different_fields_do_not_merge() -> None:
    with pytest.raises(ValueError, match="different fields"):
        FieldAllocationCRDT(1).merge(FieldAllocationCRDT(2))


def test_an_entry_is_eight_bytes() -> None:
    replica = FieldAllocationCRDT()
    for section in range(1000):
        replica.claim(section, section % 50)
    assert len(replica.serialize()) <= 8 * 1000 + 4
