"""Phases and numbers of rounds of agreement, shared by all that hold them.

Robots in each other's way (`agent/mapf/joint_plan_agreement.py`) and fleets on a grid
(`agent/coverage/plan_agreement.py`) agree in the same four phases. What they send in them, and what
a plan is, differs. Numbers of rounds are u16 on the wire and wrap around: the half of the circle
ahead of our number is later, the other half is over. A robot that has just booted does not know where
on the circle the fleet is. Until it takes part in a round, every number is later for it.
"""

from enum import Enum

from agent.interface.config import S

NUMBERS = 1 << 16
CALM_US = 2 * S  # repeat interval once all robots have probably received a message


class AgreementPhase(Enum):
    """Where one robot is in a round of agreement."""

    FREE = "no round: nothing has been agreed, or it is over"
    GATHER = "standing, saying where, hearing the others"
    AGREE = "the plan is made, the others' digests are awaited"
    GO = "driving the plan"


def after(number: int) -> int:
    """The number of the next round; it wraps around at `NUMBERS`."""
    return (number + 1) % NUMBERS


def ahead(heard: int, own: int, fresh: bool = False) -> int | None:
    """By how many rounds the number `heard` is later than our `own`; None for a round that is over.
    `fresh`: we have taken part in no round since our boot.

    >>> ahead(2, NUMBERS - 1), ahead(5, 5), ahead(4, 5), ahead(40_000, 0), ahead(40_000, 0, fresh=True)
    (3, 0, None, None, 40000)
    """
    later = (heard - own) % NUMBERS
    if fresh:
        return later or NUMBERS
    return later if later < NUMBERS // 2 else None
