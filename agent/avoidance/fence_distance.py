"""How near fences are, as kernels: a call of numpy on a dozen numbers costs more than all of the numbers.

Fences are segments (n, 4): ax, ay, bx, by in metres.
"""

from math import hypot, inf

from numba import njit

LINE_2_M2 = 1e-18  # a fence shorter than its root has no length: a lone echo


@njit(cache=True, error_model="numpy")
def gap_m(x, y, fences):  # type: ignore[no-untyped-def]
    """From a point to the nearest fence; inf without fences."""
    nearest = inf
    for k in range(fences.shape[0]):
        ax, ay = fences[k, 0], fences[k, 1]
        ex, ey = fences[k, 2] - ax, fences[k, 3] - ay
        t = ((x - ax) * ex + (y - ay) * ey) / max(ex * ex + ey * ey, LINE_2_M2)
        t = min(max(t, 0.0), 1.0)
        nearest = min(nearest, hypot(ax + t * ex - x, ay + t * ey - y))
    return nearest


@njit(cache=True, error_model="numpy")
def way_gap_m(x, y, dx, dy, step_m, count, fences):  # type: ignore[no-untyped-def]
    """The smallest value over this many points of a path, starting at one step."""
    nearest = inf
    for k in range(1, count + 1):
        nearest = min(nearest, gap_m(x + dx * (k * step_m), y + dy * (k * step_m), fences))
    return nearest


@njit(cache=True, error_model="numpy")
def gather(x, y, fences, reach_m, out, gaps):  # type: ignore[no-untyped-def]
    """Copies the nearest fences within reach to `out` (flat), nearest first; returns how many.

    `gaps`: scratch, as long as the most that are copied.
    """
    count, most = 0, gaps.size
    for k in range(fences.shape[0]):
        ax, ay = fences[k, 0], fences[k, 1]
        ex, ey = fences[k, 2] - ax, fences[k, 3] - ay
        t = ((x - ax) * ex + (y - ay) * ey) / max(ex * ex + ey * ey, LINE_2_M2)
        t = min(max(t, 0.0), 1.0)
        gap = hypot(ax + t * ex - x, ay + t * ey - y)
        if gap > reach_m or (count == most and gap >= gaps[most - 1]):
            continue
        at = count if count < most else most - 1
        while at > 0 and gaps[at - 1] > gap:
            gaps[at] = gaps[at - 1]
            for n in range(4):
                out[4 * at + n] = out[4 * at - 4 + n]
            at -= 1
        gaps[at] = gap
        for n in range(4):
            out[4 * at + n] = fences[k, n]
        count = min(count + 1, most)
    return count
