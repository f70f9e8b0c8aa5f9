"""Rounds of agreement, as all that hold them count and name them.

Robots in each other's way (`agent/mapf/joint_plan_agreement.py`) and crews on a grid
(`agent/coverage/plan_agreement.py`) agree in the same four phases; what they say in them, and what
a plan is, differs. Numbers of rounds are u16 on the wire and go round: the nearer half of the
circle is later, the other half is over.
"""

from enum import Enum

from agent.interface.config import S

NUMBERS = 1 << 16
CALM_US = 2 * S  # repeat interval once all robots have probably received a message


class Phase(Enum):
    FREE = "no round: nothing has been agreed, or it is over"
    GATHER = "standing, saying where, hearing the others"
    AGREE = "the plan is made, the others' digests are awaited"
    GO = "driving the plan"


def after(number: int) -> int:
    return (number + 1) % NUMBERS


def ahead(heard: int, own: int) -> int | None:
    """How many rounds the heard one is later than our own; None for one that is over.

    >>> ahead(2, NUMBERS - 1), ahead(5, 5), ahead(4, 5)
    (3, 0, None)
    """
    later = (heard - own) % NUMBERS
    return later if later < NUMBERS // 2 else None
