"""Thefts of a key: lies about all robots, lost frames and a restart before the revocation."""

import pytest

from tools.bench.stolen_key import trial


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", [1, 5, 6])
def test_no_lie_is_left_though_robots_missed_frames_and_restarted(seed: int) -> None:
    """In 11 of 12 such trials lies were left, because honest robots repeated them."""
    played = trial(seed)
    assert played.lies > 100, "the thief is believed before its revocation"
    assert not played.left and not played.broken, played


def test_a_robot_that_repeats_a_lie_has_not_said_its_own_work() -> None:
    """Found by the 1,000 thefts, seed 759, S13: a thief told a unit that a robot was just working. The
    robot repeated it, was switched off before it had told its own work, and was said to forget it."""
    assert not trial(759).broken
