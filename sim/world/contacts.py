"""Contacts and smallest gaps, from true positions: the judge of contacts.

It shares no code with the physics engine, which must not be judged by itself.
"""

from math import inf, sqrt

from numba import njit

from sim.world.drive_trains import RADIUS, X, Y
from sim.world.walls import AT_X, AT_Y, BOX, COS, FIRST, FREE, HALF_X, HALF_Y, HEAD, SHAPE, SIN

TOUCH_M = 0.02  # deeper than this is a contact; bodies of robots are measured to a centimetre


TOUCHES_MAX = 1024  # overlaps at one instant; a hundred robots in one heap have about 300
LOOK_M = 0.5  # gaps to fences and obstacles are computed up to this; larger ones do not matter
THING = "box"  # how a contact with a box, a person or a vehicle is told, with its number
FENCE, OBSTACLE = -1, -2  # the second body: a robot's index; the fence; OBSTACLE - k: obstacle k
NEAREST_ROBOT, NEAREST_WALL = 0, 1
STANDING_M_S = 1e-3  # a slower robot counts as standing


@njit(cache=True, error_model="numpy")
def _to_segment(floats, k, x, y):  # type: ignore[no-untyped-def]
    ax, ay, dx, dy = floats[k]
    px, py = x - ax, y - ay
    t = min(max((px * dx + py * dy) / (dx * dx + dy * dy), 0.0), 1.0)
    px, py = px - t * dx, py - t * dy
    return sqrt(px * px + py * py)


@njit(cache=True, error_model="numpy")
def to_walls(floats, ints, x, y, reach):  # type: ignore[no-untyped-def]
    """Metres from the point `x`, `y` to the nearest segment; inf if there is none within `reach`
    metres.

    `floats` and `ints` (n,) are the segments and their grid, as `walls` lays them out.
    """
    if ints[0] == 0:
        return inf
    columns, rows = ints[1], ints[2]
    west, south, side, _ = floats[0]
    items = HEAD + columns * rows + 1
    nearest = inf
    for r in range(max(int((y - reach - south) / side), 0),
                   min(int((y + reach - south) / side), rows - 1) + 1):  # fmt: skip
        for c in range(max(int((x - reach - west) / side), 0),
                       min(int((x + reach - west) / side), columns - 1) + 1):  # fmt: skip
            bucket = HEAD + r * columns + c
            for n in range(items + ints[bucket], items + ints[bucket + 1]):
                nearest = min(nearest, _to_segment(floats, ints[n], x, y))
    return nearest


@njit(cache=True, error_model="numpy")
def to_obstacle(row, x, y):  # type: ignore[no-untyped-def]
    """Metres from the point `x`, `y` to a box or a disc: negative inside a disc, 0 inside a box.
    `row`: one row of `walls`."""
    px, py = x - row[AT_X], y - row[AT_Y]
    if row[SHAPE] != BOX:
        return sqrt(px * px + py * py) - row[HALF_X]
    u = max(abs(row[COS] * px + row[SIN] * py) - row[HALF_X], 0.0)
    v = max(abs(row[COS] * py - row[SIN] * px) - row[HALF_Y], 0.0)
    return sqrt(u * u + v * v)


@njit(cache=True, error_model="numpy")
def watch(motion, floats, ints, obstacles, nearest, touches, near_m):  # type: ignore[no-untyped-def]
    """Write overlaps to `touches`, one row for each: first, second, depth in metres.

    Returns twice their number, plus 1 if a gap is not larger than `near_m`. `nearest` (2,):
    smallest gap seen so far between robots, and from a robot to anything else. `motion` (robots,
    7), `obstacles` (n, 7): one row each.
    """
    count = motion.shape[0]
    found, near = 0, 0
    for i in range(count):
        x, y, radius = motion[i, X], motion[i, Y], motion[i, RADIUS]
        for j in range(i + 1, count):
            px, py, both = motion[j, X] - x, motion[j, Y] - y, motion[j, RADIUS] + radius
            reach = both + max(nearest[NEAREST_ROBOT], near_m)
            square = px * px + py * py
            if square >= reach * reach:
                continue
            gap = sqrt(square) - both
            near |= gap <= near_m
            nearest[NEAREST_ROBOT] = min(nearest[NEAREST_ROBOT], gap)
            if gap < 0.0 and found < TOUCHES_MAX:
                touches[found, 0], touches[found, 1], touches[found, 2] = i, j, -gap
                found += 1
        gap = to_walls(floats, ints, x, y, radius + LOOK_M) - radius
        near |= gap <= near_m
        nearest[NEAREST_WALL] = min(nearest[NEAREST_WALL], gap)
        if gap < 0.0 and found < TOUCHES_MAX:
            touches[found, 0], touches[found, 1], touches[found, 2] = i, FENCE, -gap
            found += 1
        for k in range(obstacles.shape[0]):
            if obstacles[k, SHAPE] == FREE:
                continue
            gap = to_obstacle(obstacles[k], x, y) - radius
            near |= gap <= near_m
            nearest[NEAREST_WALL] = min(nearest[NEAREST_WALL], gap)
            if gap < 0.0 and found < TOUCHES_MAX:
                touches[found, 0], touches[found, 1], touches[found, 2] = i, OBSTACLE - k, -gap
                found += 1
    return 2 * found + near


@njit(cache=True, error_model="numpy")
def _is_inside(x, y, floats):  # type: ignore[no-untyped-def]
    """Whether a line from there to the east crosses the fences an odd number of times."""
    inside = False
    for k in range(FIRST, floats.shape[0]):
        ax, ay, dx, dy = floats[k]
        if (ay > y) != (ay + dy > y) and ax + dx * (y - ay) / dy > x:
            inside = not inside
    return inside


@njit(cache=True, error_model="numpy")
def crossings(motion, floats, odd):  # type: ignore[no-untyped-def]
    """Write into `odd` (robots,) 1 for each robot of `motion` (robots, 7) that is inside the
    fences, else 0."""
    for i in range(motion.shape[0]):
        odd[i] = 1 if _is_inside(motion[i, X], motion[i, Y], floats) else 0


@njit(cache=True, error_model="numpy")
def has_crossed(motion, floats, odd):  # type: ignore[no-untyped-def]
    """Whether any robot of `motion` (robots, 7) is on another side of the fences than `odd`
    (robots,) has it."""
    for i in range(motion.shape[0]):
        if (odd[i] != 0) != _is_inside(motion[i, X], motion[i, Y], floats):
            return True
    return False
