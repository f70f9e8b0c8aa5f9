"""Ways through a field for a tractor: from pose to pose, never tighter than its turning circle.

A way is a list of pieces (curvature, signed length); a negative length is backing up. Where bodies
stand, the cells round them are blocked for one question only.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.interface.geometry import Point
from agent.paths.dubins import step
from agent.paths.hybrid_a_star import BACK_COST, SHIFT_M, is_free, piece_is_free, search

SAMPLE_M = 0.1
RUN_UPS_M = (1.5, 1.0, 0.5)  # lengths of the straight before the goal that are tried
RUN_OUT_COST_M = 3.0  # a run-out that makes the rest longer by more is left out
BACK_INS_M = (1.0, 0.5)  # lengths of the straight back to a goal that are tried
BACK_IN_COST_M = 4.0  # such a way is taken unless it costs more than this: a turn ends less exactly
OPENED_CELLS = 2.5  # round a start that could not be left
RUN_UP_M = 1.0  # a shorter run-up is taken only if it saves more than this


class VehiclePose(NamedTuple):
    """Where the middle of a body is, and where its nose points: counter-clockwise from x."""

    x_m: float
    y_m: float
    heading_rad: float


class Piece(NamedTuple):
    """A straight or an arc of a way; positive curvatures bend to the left."""

    curvature_1_m: float
    length_m: float  # negative: backing up


class TurnRoute:
    """Finds ways in one field. It holds nothing that changes, so all robots of a process share one."""

    def __init__(
        self, blocked: NDArray[np.bool_], origin_x_m: float, origin_y_m: float, cell_m: float,
        radius_m: float,
    ) -> None:  # fmt: skip
        """`blocked[row, column]`: where the middle of the body may not be; `radius_m` of its circle."""
        self.blocked, self.radius_m = np.ascontiguousarray(blocked), radius_m
        self.place = np.array([origin_x_m, origin_y_m, cell_m])

    def way(
        self,
        start: VehiclePose,
        goal: VehiclePose,
        bodies: Sequence[Point] = (),
        reach_m: float = 0.0,
        run_out_m: float = 0.0,
    ) -> list[Piece] | None:
        """Pieces from start to goal, with a straight run-up where there is room, or else straight back
        to it; None: no way was found.

        `run_out_m`: of the straight before a first bend ahead, where there is room. Wheels that are
        straight at the start take time to turn.

        Cells nearer than `reach_m` to one of the `bodies` count as blocked. A start from which the body
        could move neither straight on nor straight back may be left: the cells round it count as free.
        """
        blocked = self._without(bodies, reach_m)
        self._open(blocked, start)
        best = self._with_run_up(blocked, start, goal)
        if not best or best[0].length_m < 0.0 or best[0].curvature_1_m == 0.0:
            return best
        if not run_out_m or not piece_is_free(blocked, self.place, *start, 0.0, run_out_m):
            return best
        after = VehiclePose(*step(*start, 0.0, run_out_m))
        later = self._with_run_up(blocked, after, goal)
        if not later or later[0].length_m < 0.0 or cost_m(later) > cost_m(best) + RUN_OUT_COST_M:
            return best
        return [Piece(0.0, run_out_m), *later]

    def _with_run_up(
        self, blocked: NDArray[np.bool_], start: VehiclePose, goal: VehiclePose
    ) -> list[Piece] | None:
        best: list[Piece] | None = None
        for run_up_m in RUN_UPS_M:
            if not piece_is_free(blocked, self.place, *goal, 0.0, -run_up_m):
                continue
            before = VehiclePose(*step(*goal, 0.0, -run_up_m))
            pieces = self._search(blocked, start, before)
            if pieces is None:
                break
            pieces.append(Piece(0.0, run_up_m))
            if best is None or cost_m(pieces) + RUN_UP_M < cost_m(best):
                best = pieces
        if best is not None:
            return best
        self._open(blocked, goal)
        best = self._search(blocked, start, goal)
        for back_m in BACK_INS_M:  # with a fence behind the goal, straight back to it
            if best == [] or not piece_is_free(blocked, self.place, *goal, 0.0, back_m):
                continue
            pieces = self._search(blocked, start, VehiclePose(*step(*goal, 0.0, back_m)))
            if pieces is None:
                break
            pieces.append(Piece(0.0, -back_m))
            if best is None or cost_m(pieces) < cost_m(best) + BACK_IN_COST_M:
                return pieces
        return best

    def is_free(self, at: Point) -> bool:
        """Whether the middle of the body may be at a place; no other bodies are considered."""
        return bool(is_free(self.blocked, self.place, *at))

    def piece_is_free(self, at: VehiclePose, piece: Piece) -> bool:
        """Whether a piece from a pose stays on free cells; no other bodies are considered."""
        return bool(piece_is_free(self.blocked, self.place, *at, *piece))

    def opened_at(self, at: VehiclePose) -> "TurnRoute":
        """This one, or one in which a body may leave the pose, as in `way`, if it could not."""
        if self._leaves(self.blocked, at):
            return self
        blocked = self.blocked.copy()
        self._clear(blocked, at)
        x_m, y_m, cell_m = self.place.tolist()
        return TurnRoute(blocked, x_m, y_m, cell_m, self.radius_m)

    def _search(
        self, blocked: NDArray[np.bool_], start: VehiclePose, goal: VehiclePose
    ) -> list[Piece] | None:
        here, there = np.array(start), np.array(goal)
        found = search(blocked, self.place, here, there, self.radius_m, False)
        if not found.shape[0]:
            found = search(blocked, self.place, here, there, self.radius_m, True)
        if not found.shape[0]:
            return None
        return [Piece(float(k), float(s)) for k, s in found if abs(s) > 1e-6]

    def _without(self, bodies: Sequence[Point], reach_m: float) -> NDArray[np.bool_]:
        blocked = self.blocked.copy()
        for x_m, y_m in bodies:
            self._disc(blocked, x_m, y_m, reach_m, True)
        return blocked

    def _open(self, blocked: NDArray[np.bool_], at: VehiclePose) -> None:
        if not self._leaves(blocked, at):
            self._clear(blocked, at)

    def _clear(self, blocked: NDArray[np.bool_], at: VehiclePose) -> None:
        self._disc(blocked, at.x_m, at.y_m, OPENED_CELLS * self.place[2], False)

    def _leaves(self, blocked: NDArray[np.bool_], at: VehiclePose) -> bool:
        """Whether a body may leave a pose straight on or straight back. Beside a fence that is aslant to
        the grid, a free cell may have no free one next to it."""
        way_m = OPENED_CELLS * float(self.place[2])
        return any(piece_is_free(blocked, self.place, *at, 0.0, m) for m in (way_m, -way_m))

    def _disc(
        self, blocked: NDArray[np.bool_], x_m: float, y_m: float, reach_m: float, value: bool
    ) -> None:
        cell_m = self.place[2]
        column, row = (x_m - self.place[0]) / cell_m - 0.5, (y_m - self.place[1]) / cell_m - 0.5
        r = reach_m / cell_m
        top, left = max(int(row - r), 0), max(int(column - r), 0)
        part = blocked[top : int(row + r) + 2, left : int(column + r) + 2]
        i, j = np.ogrid[top : top + part.shape[0], left : left + part.shape[1]]
        part[(i - row) ** 2 + (j - column) ** 2 <= r * r] = value


def cost_m(pieces: Sequence[Piece]) -> float:
    """The metres straight ahead that would take as long as these pieces."""
    shifts = sum(1 for a, b in pairwise(pieces) if a.length_m * b.length_m < 0.0)
    return shifts * SHIFT_M + sum(
        abs(piece.length_m) * (BACK_COST if piece.length_m < 0.0 else 1.0) for piece in pieces
    )


def sampled(start: VehiclePose, pieces: Sequence[Piece]) -> NDArray[np.float64]:
    """(n, 5): x, y, heading, curvature and gear (1 or -1) every `SAMPLE_M` or less."""
    rows: list[tuple[float, float, float, float, float]] = []
    at = start
    for piece in pieces:
        gear = 1.0 if piece.length_m > 0.0 else -1.0
        steps = max(1, int(np.ceil(abs(piece.length_m) / SAMPLE_M)))
        if not rows or rows[-1][4] != gear:
            rows.append((*at, piece.curvature_1_m, gear))
        for k in range(1, steps + 1):
            pose = step(*at, piece.curvature_1_m, piece.length_m * k / steps)
            rows.append((*pose, piece.curvature_1_m, gear))
        at = VehiclePose(*step(*at, piece.curvature_1_m, piece.length_m))
    return np.array(rows).reshape(-1, 5)
