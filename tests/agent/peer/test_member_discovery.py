"""Who is who: strangers are asked, and waited for, but not for ever."""

from agent.peer.member_discovery import AGAIN_US, ASKED_ENOUGH, PATIENCE_US, MemberDiscovery


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
