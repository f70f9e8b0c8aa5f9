"""Steps in which nothing touches anything, without the physics engine: to the last bit what it does.

Where no two shapes overlap at the end of a step, Chipmunk's step is this: each body moves on by its
velocity, then forces change the velocity (`cpBodyUpdatePosition`, `cpBodyUpdateVelocity`). Calling it for
that costs ten times as much as doing it, so it is called where something is near, and for as long as it
remembers a touch. A test compares both, bit for bit. What differs from an engine that is always called:
where three or more touch at once, it takes touches in an order that depends on all it saw before, so the
last bits of where bodies are pushed by others may be other ones.
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

NEAR_M = (
    0.01  # a gap smaller than this is the engine's; more than it and we could differ by rounding
)
TRACK_US = 100_000  # positions are kept this often
# why `glide` came back, in the last bits of what it returns: there, or at a moment to keep; implements
# were switched; something is near; somebody moves who is guarded
CODES = 8
DONE, SWITCHED, NEAR, GUARDED = range(4)
SILENT_US, STILL_US = range(2)  # columns of limits: later no command to move; later no motion


@njit(cache=True, error_model="numpy")
def _is_near(motion, floats, ints, obstacles, nearest, near_m):  # type: ignore[no-untyped-def]
    """Whether anything is within `near_m` at the end of the coming step; else gaps are noted."""
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
    """Places by the old velocities, then velocities: the order of operations is Chipmunk's."""
    for i in range(motion.shape[0]):
        m = motion[i]
        m[X] += m[VX] * STEP_S
        m[Y] += m[VY] * STEP_S
        m[HEADING] += m[TURN] * STEP_S
        for k in range(3):
            m[VX + k] += push[i, k] * inertia[i, k] * (1.0 / inertia[i, k]) * STEP_S


@njit(cache=True, error_model="numpy")
def guarded(rows, motion, limits, moved_us, now_us):  # type: ignore[no-untyped-def]
    """After a step: who moves is noted, and whether one does, or was told to, that must not."""
    found = False
    begun_us = now_us - STEP_US  # commands in force during the step were those at its beginning
    for i in range(motion.shape[0]):
        if motion[i, VX] ** 2 + motion[i, VY] ** 2 > STANDING_M_S**2:
            moved_us[i] = now_us
            found |= now_us >= limits[i, STILL_US]
        found |= rows[i, COMMANDED_US] == begun_us and begun_us >= limits[i, SILENT_US]
    return found


@njit(cache=True, error_model="numpy")
def glide(  # type: ignore[no-untyped-def]
    rows, motion, keys, push, inertia, floats, ints, obstacles, moved_us, nearest, limits,
    now_us, until_us, rolled, near_m,
):  # fmt: skip
    """Steps from `now_us` on, none beyond `until_us`, until somebody has to look.

    `rolled`: the wheels have turned for the first one. Returns the new time, times `CODES`, and why.
    """
    while True:
        if not rolled:
            if now_us + STEP_US > until_us:
                return now_us * CODES + DONE
            if roll(rows, motion, keys, now_us, push):
                return now_us * CODES + SWITCHED
        rolled = False
        if _is_near(motion, floats, ints, obstacles, nearest, near_m):
            return now_us * CODES + NEAR
        _move(motion, push, inertia)
        now_us += STEP_US
        if guarded(rows, motion, limits, moved_us, now_us):
            return now_us * CODES + GUARDED
        if now_us % TRACK_US == 0:
            return now_us * CODES + DONE
