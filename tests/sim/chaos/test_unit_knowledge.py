"""Which robots know that a unit is worked, judged from outside."""

from crdt.progress import BLOCK_UNITS
from sim.chaos.unit_knowledge import UnitKnowledge, units_of

FIRST, SECOND = (2, 3), (2, 4)
EXCHANGED_US = 12_000_000


def knowledge() -> UnitKnowledge:
    """Robot 0 has told two units, and robot 1 was up."""
    made = UnitKnowledge(EXCHANGED_US)
    made.told({0: [FIRST, SECOND], 1: []}, 5)
    return made


def test_the_first_time_counts() -> None:
    made = knowledge()
    made.told({0: [], 1: [], 2: [FIRST]}, 9)
    assert made.known_at_us == {FIRST: 5, SECOND: 5}


def test_a_unit_is_known_while_one_robot_knows_it() -> None:
    made = knowledge()
    made.forgets(0, but={FIRST})
    assert set(made.known_at_us) == {FIRST, SECOND}
    made.forgets(1)
    assert set(made.known_at_us) == {FIRST}


def test_robots_learn_what_one_of_them_knows_and_nothing_else() -> None:
    made = knowledge()
    made.forgets(0)
    made.exchanged([0, 1], 6)
    made.forgets(1)
    assert set(made.known_at_us) == {FIRST, SECOND}
    made.forgets(0)
    made.exchanged([0, 1], 7)
    assert not made.known_at_us


def test_what_is_told_behind_a_cut_is_known_to_its_teller_alone() -> None:
    """A robot told units behind a cut and lost its disk, and the others passed for robots that know
    them."""
    made = UnitKnowledge(EXCHANGED_US)
    exchanged_at_us = made.parts(0, 100)
    made.told({0: [FIRST], 1: []}, 50)
    made.exchanged([0, 1], exchanged_at_us - 1)
    made.forgets(0)
    assert not made.known_at_us
    made.told({0: [], 1: [SECOND]}, 60)
    made.exchanged([0, 1], exchanged_at_us)
    made.forgets(1)
    assert set(made.known_at_us) == {SECOND}


def test_robots_are_apart_until_they_have_exchanged_what_they_know() -> None:
    made = knowledge()
    assert made.parts(100, 200) == 200 + EXCHANGED_US
    assert [made.is_apart(at_us) for at_us in (99, 100, 199 + EXCHANGED_US, 200 + EXCHANGED_US)] == [
        False, True, True, False,
    ]  # fmt: skip
    made.parts(10**9, 0)  # of a trouble without a known end
    assert made.is_apart(10**9 + EXCHANGED_US - 1)


def test_units_of_blocks() -> None:
    assert list(units_of({(7, 1): 0b101})) == [(7, BLOCK_UNITS), (7, BLOCK_UNITS + 2)]
