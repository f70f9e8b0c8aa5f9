"""Who is who: strangers are asked, and waited for, but not for ever."""

from itertools import pairwise

from agent.interface.config import S
from agent.peer.member_discovery import (
    AGAIN_US,
    ASKED_ENOUGH,
    PATIENCE_US,
    SLOT_US,
    MemberDiscovery,
)


def test_a_stranger_is_waited_for_until_it_says_who_it_is() -> None:
    """Found by `headland chaos`, profile claims, seed 2370: a device talked over the answers, and a
    robot that had just come back chose a section in which one that it did not know was at work."""
    roll = MemberDiscovery(3)
    assert not roll.wonders
    roll.stranger(129, 0)
    assert roll.wonders
    roll.known(129)
    assert not roll.wonders


def test_a_device_that_never_answers_is_not_waited_for() -> None:
    roll, now_us, questions = MemberDiscovery(0), 0, 0
    roll.stranger(77, now_us)
    while roll.wonders:
        assert roll.due_at_us is not None
        now_us = roll.due_at_us
        questions += len(roll.tick(now_us))
    assert questions == ASKED_ENOUGH
    assert now_us < PATIENCE_US + 4 * AGAIN_US


def test_a_robot_whose_link_is_whole_again_is_asked_within_seconds() -> None:
    """Found by `headland chaos`, profile bus, seed 12000010: after 30 s of lost frames a robot was asked
    for its NAME once a minute, and its fleet stood meanwhile."""
    asks, asked_at_us = MemberDiscovery(1), list[int]()
    asks.stranger(130, 0)
    while len(asked_at_us) < 12:
        due_at_us = asks.due_at_us
        assert due_at_us is not None
        assert len(asks.tick(due_at_us)) == 1
        asked_at_us.append(due_at_us)
    pauses_us = [later - before for before, later in pairwise(asked_at_us)]
    assert max(pauses_us) <= 8 * S + SLOT_US and pauses_us == sorted(pauses_us)
