"""Never be where you cannot stop: a half-plane against each robot near, that is never traded.

ORCA believes that others go on as they go, or give way as we do. A robot that halts for a stop or for
a round of agreement does neither. So towards whoever is near we go at most so fast that we stop
before its body, even if it brakes with all that its tyres hold from where it was *last heard* on, or
comes on and needs its own stopping distance of what is between us. If all keep to it nobody touches
anybody when one, some or all of them halt at any instant, whatever beats were lost: where a robot that
drives away was heard is behind where it can stop.

Both brake by at least `braking`, and know it of each other: they are of one fleet. Standing is always
permitted, so these half-planes never contradict each other.
"""

from math import sqrt

import numpy as np
from numba import njit

from agent.linear_program import DX, DY, PX, PY

f32 = np.float32
REACTION_S = 0.1  # two control periods: what was decided is in force, and the wheels follow
HARDEST_M_S2 = 7.0  # nobody brakes harder than tyres hold: 0.7 g, rubber on dry ground
SLACK_M = 0.1  # of the margin between two bodies: they may stand nearer than ORCA leads them
SAID_M_S = 0.025  # a beat rounds the speed by so much


@njit(cache=True, error_model="numpy")
def before_agent(px, py, ux, uy, radius, age, braking, speed, lines, k):  # type: ignore[no-untyped-def]
    """Half-plane k against a body at (px, py) from here that moves with (ux, uy) and was heard `age`
    seconds ago; `radius`: of both, and the margin. How many were written: none where `speed` is safe.
    """
    distance = sqrt(px * px + py * py)
    if distance < 1e-9:
        return 0
    px, py, room = px / distance, py / distance, distance - radius + SLACK_M
    away = ux * px + uy * py
    if away > 0.0:
        room += max(away - SAID_M_S, 0.0) ** 2 / (2.0 * HARDEST_M_S2) - away * age
    else:
        room -= -away * REACTION_S + away * away / (2.0 * braking)
    limit = 0.0
    if room > 0.0:
        limit = braking * (sqrt(REACTION_S * REACTION_S + 2.0 * room / braking) - REACTION_S)
    if limit >= speed:
        return 0
    lines[k, PX], lines[k, PY] = f32(px * limit), f32(py * limit)
    lines[k, DX], lines[k, DY] = f32(-py), f32(px)
    return 1
