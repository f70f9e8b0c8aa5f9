"""Never be where you cannot stop: a half-plane against each near robot that is never traded.

ORCA assumes that others keep their velocity, or give way as we do. A robot that halts for a stop or
for a round of agreement does neither. So our speed towards any near robot is limited so that we
stop before its body. This holds even if it brakes at the limit of its tyres from where it was *last
heard*, or if it approaches and needs its own stopping distance from the gap between us. If all
robots keep to it, none collide when one, some or all of them halt at any instant, whatever beacons
were lost, because a robot that drives away stops beyond its last received position.

Both robots brake by at least `braking`, and know that of each other, because they are of one fleet.
Standing is always permitted, so these half-planes never contradict each other.

Wheels have one grip for braking and for swerving. So the stopping distances are those of whole
speeds, ours and the other's, not of the parts of them towards each other. Where a swerve is wanted that
the wheels cannot reach in one period, and what they do reach is too fast, the robot brakes straight.
From where it may be, that is always in time.

Units: metres, m/s, m/s² and seconds. `lines` (half-planes, 4) are described in
`agent.avoidance.linear_program`.
"""

from math import sqrt

import numpy as np

from agent.avoidance.k_nearest import Number, Real
from agent.avoidance.linear_program import DX, DY, PX, PY, Lines, violation
from agent.kernels.kernel import njit

f32 = np.float32
REACTION_S = 0.1  # two control periods, until a decision is executed and the wheels follow
HARDEST_M_S2 = 7.0  # tyre grip limits braking to this: 0.7 g, rubber on dry ground
SLACK_M = 0.1  # part of the margin between two bodies that a stop may use up
SAID_M_S = 0.025  # rounding error of the speed in a beat
# Of a change of velocity in one period: that much faster than told may be noise. With half of it each
# command of a robot that brakes is slower than the last one, however wheels slip.
NOISE = 0.5
# Of a change of velocity in one period that keeps a braking robot off fences. 0.94 of it is left for
# braking, and 0.5 m/s² across takes it out of its drift before the 0.2 m to a fence are used up.
ACROSS = 0.35


@njit(cache=True, error_model="numpy")
def before_agent(
    px: float,
    py: float,
    ux: float,
    uy: float,
    radius: float,
    age: float,
    braking: float,
    own: float,
    speed: float,
    lines: Lines,
    k: Number,
) -> int:
    """Write row k of `lines` against a body at (px, py) from here; returns how many were written.

    The body moved with (ux, uy) when it was heard, `age` seconds ago. `radius` is the sum of both
    radii and the margin. `own` is the greatest speed that we may have after the next period.
    Nothing is written where even `speed` is safe.
    """
    distance = sqrt(px * px + py * py)
    if distance < 1e-9:
        return 0
    px, py, room = px / distance, py / distance, distance - radius + SLACK_M
    away = ux * px + uy * py
    if away > 0.0:
        room += max(away - SAID_M_S, 0.0) ** 2 / (2.0 * HARDEST_M_S2) - away * age
    else:
        coming = sqrt(ux * ux + uy * uy)
        room -= -away * (REACTION_S + coming / (2.0 * braking))
    limit = 0.0
    if room > 0.0:
        limit = room / (REACTION_S + own / (2.0 * braking))
    if limit >= speed:
        return 0
    lines[k, PX], lines[k, PY] = f32(px * limit), f32(py * limit)
    lines[k, DX], lines[k, DY] = f32(-py), f32(px)
    return 1


@njit(cache=True, error_model="numpy", inlined=True)
def within_grip(
    wx: Real,
    wy: Real,
    vx: Real,
    vy: Real,
    told: Real,
    change: Real,
    lines: Lines,
    first: int,
    end: int,
) -> tuple[Real, Real]:
    """The velocity (wx, wy), or that of braking straight from (vx, vy).

    `told`: the speed that wheels without slip have by the commands so far. `change`: how far the
    velocity can change in one period. The robot brakes if the velocity that it reaches on the way to
    (wx, wy) violates one of the half-planes from `first` to `end` - 1. Those before `first` are of
    fences: a small part of the change keeps a braking robot off them.
    """
    cx, cy = wx - vx, wy - vy
    asked = sqrt(cx * cx + cy * cy)
    if asked <= change:
        return wx, wy
    rx, ry = f32(vx + cx * change / asked), f32(vy + cy * change / asked)
    for k in range(first, end):
        if violation(lines, k, rx, ry) > f32(0.0):
            return _braked(vx, vy, told, change, lines, first)
    return wx, wy


@njit(cache=True, error_model="numpy", inlined=True)
def _braked(
    vx: Real, vy: Real, told: Real, change: Real, lines: Lines, fences: int
) -> tuple[Real, Real]:
    """The velocity after braking for one period, off the fences of the first `fences` half-planes.

    Wheels that slip may move a body faster than it was told. It brakes from what it was told then:
    commands that follow what slip adds would speed it up.
    """
    speed: Real = max(sqrt(vx * vx + vy * vy), 1e-9)
    slips = f32(speed - told) if speed - told > NOISE * change else f32(0.0)
    left = f32(max(1.0 - (change + slips) / speed, 0.0))
    bx, by = vx * left, vy * left
    most, ax, ay = change * ACROSS, 0.0, 0.0
    for k in range(fences):
        closes = min(violation(lines, k, f32(bx + ax), f32(by + ay)), most)
        if closes > 0.0:
            ax -= closes * lines[k, DY]
            ay += closes * lines[k, DX]
            most -= closes
    if ax == 0.0 and ay == 0.0:
        return bx, by
    along = sqrt(change * change - ax * ax - ay * ay)
    left = f32(max(1.0 - (along + slips) / speed, 0.0))
    return f32(vx * left + ax), f32(vy * left + ay)
