"""Never be where you cannot stop: a half-plane against each robot near, that is never traded.

ORCA assumes that others keep their velocity, or give way as we do. A robot that halts for a stop or
for a round of agreement does neither. So our speed towards any near robot is limited so that we stop
before its body. This holds even if it brakes at the limit of its tyres from where it was *last heard*,
or if it approaches and needs its own stopping distance from the gap between us. If all robots keep to
it, none collide when one, some or all of them halt at any instant, whatever beats were lost, because a
robot that drives away stops beyond its last received position.

Both brake by at least `braking`, and know it of each other: they are of one fleet. Standing is always
permitted, so these half-planes never contradict each other.

Wheels have one grip for braking and for swerving. So the room towards a body is what braking straight
takes of it at the speed that we may have, not at the part of it towards the body; and where a swerve is
asked for that the wheels do not reach in a period, and what they reach is too fast, we brake straight,
which from where we may be is always in time.
"""

from math import sqrt

import numpy as np
from numba import njit

from agent.avoidance.linear_program import DX, DY, PX, PY, violation

f32 = np.float32
REACTION_S = 0.1  # two control periods: what was decided is in force, and the wheels follow
HARDEST_M_S2 = 7.0  # tyre grip limits braking to this: 0.7 g, rubber on dry ground
SLACK_M = 0.1  # of the margin between two bodies: they may stand nearer than ORCA leads them
SAID_M_S = 0.025  # rounding error of the speed in a beat


@njit(cache=True, error_model="numpy")
def before_agent(px, py, ux, uy, radius, age, braking, own, speed, lines, k):  # type: ignore[no-untyped-def]
    """Half-plane k against a body at (px, py) from here that moves with (ux, uy) and was heard `age`
    seconds ago; `radius`: of both, and the margin; `own`: our speed after the next period at most. How
    many were written: none where `speed` is safe.
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
        limit = room / (REACTION_S + own / (2.0 * braking))
    if limit >= speed:
        return 0
    lines[k, PX], lines[k, PY] = f32(px * limit), f32(py * limit)
    lines[k, DX], lines[k, DY] = f32(-py), f32(px)
    return 1


@njit(cache=True, error_model="numpy")
def within_grip(wx, wy, vx, vy, change, lines, first, end):  # type: ignore[no-untyped-def]
    """(wx, wy), or braking straight from (vx, vy), where what a `change` of velocity reaches on the way
    to it breaks one of the half-planes from `first` on."""
    cx, cy = wx - vx, wy - vy
    asked = sqrt(cx * cx + cy * cy)
    if asked <= change:
        return wx, wy
    rx, ry = f32(vx + cx * change / asked), f32(vy + cy * change / asked)
    for k in range(first, end):
        if violation(lines, k, rx, ry) > f32(0.0):
            left = f32(max(1.0 - change / max(sqrt(vx * vx + vy * vy), 1e-9), 0.0))
            return vx * left, vy * left
    return wx, wy
