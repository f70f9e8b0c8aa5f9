"""Steps without contact, without the physics engine: the result is equal to the last bit.

If no two shapes overlap at the end of a step, Chipmunk's step is this: each body moves on by its
velocity, then forces change the velocity (`cpBodyUpdatePosition`, `cpBodyUpdateVelocity`). A call
of the engine costs ten times as much as this, so the engine is called only if something is near,
and while it remembers a touch. A test compares both, bit for bit. There is one difference to an
engine that is always called. If three or more bodies touch at the same time, the engine processes
touches in an order that depends on all earlier ones, so the last bits of the positions of pushed
bodies may differ.
"""

from math import sqrt

from numba import njit

from sim.world.contacts import (
    LOOK_M,
    NEAREST_ROBOT,
    NEAREST_WALL,
    STANDING_M_S,
    to_obstacle,
    to_walls,
)
from sim.world.drive_trains import (
    COMMANDED_US,
    HEADING,
    RADIUS,
    STEP_S,
    STEP_US,
    TURN,
    VX,
    VY,
    X,
    Y,
    roll,
)
from sim.world.walls import FREE, SHAPE

# The engine handles smaller gaps. The margin is larger than the differences by rounding.
NEAR_M = 0.01
TRACK_US = 100_000  # positions are kept this often
# Why `glide` returned, in the last bits of its result: the end time or a moment to record;
# implements switched; something is near; a guarded robot moves.
CODES = 8
DONE, SWITCHED, NEAR, GUARDED = range(4)
# Columns of limits: no command to move after the first, no motion after the second.
SILENT_US, STILL_US = range(2)


@njit(cache=True, error_model="numpy")
def _is_near(motion, floats, ints, obstacles, nearest, near_m):  # type: ignore[no-untyped-def]
    """Whether anything is within `near_m` at the end of the coming step; if not, record the
    gaps."""
    count = motion.shape[0]
    for i in range(count):
        x, y = motion[i, X] + motion[i, VX] * STEP_S, motion[i, Y] + motion[i, VY] * STEP_S
        radius = motion[i, RADIUS]
        for j in range(i + 1, count):
            px = motion[j, X] + motion[j, VX] * STEP_S - x
            py = motion[j, Y] + motion[j, VY] * STEP_S - y
            both = motion[j, RADIUS] + radius
            reach = both + max(nearest[NEAREST_ROBOT], near_m)
            square = px * px + py * py
            if square >= reach * reach:
                continue
            gap = sqrt(square) - both
            if gap <= near_m:
                return True
            nearest[NEAREST_ROBOT] = min(nearest[NEAREST_ROBOT], gap)
        gap = to_walls(floats, ints, x, y, radius + LOOK_M) - radius
        for k in range(obstacles.shape[0]):
            if obstacles[k, SHAPE] != FREE:
                gap = min(gap, to_obstacle(obstacles[k], x, y) - radius)
        if gap <= near_m:
            return True
        nearest[NEAREST_WALL] = min(nearest[NEAREST_WALL], gap)
    return False


@njit(cache=True, error_model="numpy")
def _move(motion, push, inertia):  # type: ignore[no-untyped-def]
    """Move positions by the old velocities, then update velocities, in Chipmunk's order."""
    for i in range(motion.shape[0]):
        m = motion[i]
        m[X] += m[VX] * STEP_S
        m[Y] += m[VY] * STEP_S
        m[HEADING] += m[TURN] * STEP_S
        for k in range(3):
            m[VX + k] += push[i, k] * inertia[i, k] * (1.0 / inertia[i, k]) * STEP_S


@njit(cache=True, error_model="numpy")
def guarded(rows, motion, limits, moved_at_us, now_us):  # type: ignore[no-untyped-def]
    """After a step: record which robots move, and return whether one broke its guard's limits.

    `rows` (robots, columns of `drive_trains`), `motion` (robots, 7), `limits` (robots, 2), the
    microseconds from which it may get no command, and from which it must stand, `moved_at_us`
    (robots,), when each moved last.
    """
    found = False
    begun_at_us = now_us - STEP_US  # commands in force during the step were those at its beginning
    for i in range(motion.shape[0]):
        if motion[i, VX] ** 2 + motion[i, VY] ** 2 > STANDING_M_S**2:
            moved_at_us[i] = now_us
            found |= now_us >= limits[i, STILL_US]
        found |= rows[i, COMMANDED_US] == begun_at_us and begun_at_us >= limits[i, SILENT_US]
    return found


@njit(cache=True, error_model="numpy")
def glide(  # type: ignore[no-untyped-def]
    rows, motion, keys, push, inertia, floats, ints, obstacles, moved_at_us, nearest, limits,
    now_us, end_at_us, rolled, near_m,
):  # fmt: skip
    """Make steps from `now_us`, none beyond `end_at_us`, until something must be handled.

    `rolled`: the wheels have turned for the first one. `near_m` is the gap below which the physics
    engine takes over. Each robot has one row of `rows`, `motion` (robots, 7), `keys`, `push` and
    `inertia` (robots, 3), `limits` and `moved_at_us`; `nearest` (2,) is updated as in
    `contacts.watch`. `floats`, `ints` and `obstacles` are those of `walls`. Returns the new time,
    times `CODES`, and why.
    """
    while True:
        if not rolled:
            if now_us + STEP_US > end_at_us:
                return now_us * CODES + DONE
            if roll(rows, motion, keys, now_us, push):
                return now_us * CODES + SWITCHED
        rolled = False
        if _is_near(motion, floats, ints, obstacles, nearest, near_m):
            return now_us * CODES + NEAR
        _move(motion, push, inertia)
        now_us += STEP_US
        if guarded(rows, motion, limits, moved_at_us, now_us):
            return now_us * CODES + GUARDED
        if now_us % TRACK_US == 0:
            return now_us * CODES + DONE
