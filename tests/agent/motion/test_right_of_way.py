"""Two robots' shares of avoiding each other make one at least, whatever is lost between them."""

from random import Random

import pytest

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.lifecycle import State
from agent.motion.right_of_way import HALF, LESS, MORE, RightOfWay


def test_half_each_then_uneven_then_half() -> None:
    ours, theirs = RightOfWay(), RightOfWay()

    def at(t_s: float, a: State, b: State, age_us: int = 0) -> tuple[float, float]:
        now_us = round(t_s * S)
        return ours.share(1, a, b, age_us, now_us), theirs.share(0, b, a, age_us, now_us)

    assert at(0.0, State.WORKING, State.IDLE) == (HALF, HALF)
    assert at(1.0, State.WORKING, State.IDLE) == (HALF, MORE)
    assert at(3.0, State.WORKING, State.IDLE) == (LESS, MORE)
    assert at(3.1, State.WORKING, State.IDLE, age_us=S) == (HALF, MORE)
    assert at(3.2, State.WORKING, State.WORKING) == (HALF, MORE)
    assert at(6.0, State.WORKING, State.WORKING) == (HALF, HALF)
    assert at(9.0, State.IDLE, State.IDLE) == (HALF, HALF)


@pytest.mark.parametrize("seed", range(20))
def test_the_shares_make_one_at_least(seed: int) -> None:
    rng = Random(f"{seed}/right of way")
    sides = RightOfWay(), RightOfWay()
    states = [State.IDLE, State.IDLE]
    heard = [State.IDLE, State.IDLE]  # of each by the other
    heard_at_us = [0, 0]
    uneven = 0
    for tick in range(4000):
        now_us = tick * CONTROL_PERIOD_US
        for k in range(2):
            if rng.random() < 0.008:
                states[k] = rng.choice((State.IDLE, State.WORKING))
            if rng.random() > 0.3:
                heard[k], heard_at_us[k] = states[k], now_us
        shares = [
            sides[k].share(1 - k, states[k], heard[1 - k], now_us - heard_at_us[1 - k], now_us)
            for k in range(2)
        ]
        assert sum(shares) >= 1.0, (seed, tick, shares)
        uneven += min(shares) < HALF
    assert uneven > 100
