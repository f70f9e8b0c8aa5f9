"""Moves a steered body out of another robot's way: one arc or straight, forward or backward."""

from collections.abc import Iterable
from math import copysign, cos, hypot, sin

from agent.interface.geometry import Point
from agent.motion.tractor_tracker import AT_WORK, SteeredWheels, SteeringLimits, TractorTracker
from agent.paths.dubins import step
from agent.paths.tractor_route import Piece, TurnRoute, VehiclePose, sampled

# Of the arcs and straights that are tried. The short ones are for corners, where no other is free.
LENGTHS_M = (0.6, 1.2, 3.0, 5.0, 8.0)
ENOUGH_M = 9.0  # a larger distance from the other robot is no better
STEP_M = 0.5  # between places where the piece is checked for collisions
SPARE_M = 0.35  # between hulls
# Wheels take 0.9 s to turn, and longer where they were turned the other way. A tractor that still moves
# goes straight on meanwhile: one backed into a fence so. A piece that is free then, too, is preferred.
LATE_M = 0.5


class EscapeManoeuvre:
    """One robot's way out of another robot's way: found once, then driven to its end."""

    def __init__(
        self, turns: TurnRoute, radius_m: float, limits: SteeringLimits,
        wheels: SteeredWheels | None = None,
    ) -> None:  # fmt: skip
        """`turns`: knows which arcs stay on free ground. `radius_m`: of every body. `limits`,
        `wheels`: of our chassis, see `TractorTracker`.
        """
        self.turns, self.radius_m, self.limits, self.wheels = turns, radius_m, limits, wheels
        self.follow: TractorTracker | None = None

    def go(
        self, here: VehiclePose, away_from: Iterable[Point], everybody: Iterable[Point]
    ) -> tuple[float, float] | None:
        """Speed (negative: backward) and turn rate of the escape, metres and radians a second.

        None if none is needed any more, or if none exists. `here`: our pose. `away_from`: robots
        that need the room, (x, y) metres. `everybody`: all robots near by.
        """
        if self.follow is None:
            others = list(away_from)
            pieces = self.find(here, others, list(everybody)) if others else None
            if pieces is None:
                return None
            way = sampled(here, [pieces])
            self.follow = TractorTracker(way, self.limits, 0.0, AT_WORK, self.wheels)
        self.follow.locate(*here)
        if self.follow.arrived or self.follow.lost:
            self.follow = None
            return None
        return self.follow.command()

    def find(
        self, here: VehiclePose, away_from: list[Point], everybody: list[Point]
    ) -> Piece | None:
        """The piece that ends furthest from the robots that need the room, without a collision.

        None if no piece brings us further away, within a metre. Forward is preferred to backward by
        half a metre. From a cell without a free one next to it, where a swath may end beside a fence,
        a piece leads to a free cell.
        """
        best = self._best(here, away_from, everybody, LATE_M)
        best = best or self._best(here, away_from, everybody, 0.0)
        return best[1] if best is not None and best[0] > _gap(here[:2], away_from) - 1.0 else None

    def _best(
        self, here: VehiclePose, away_from: list[Point], everybody: list[Point], late_m: float
    ) -> tuple[float, Piece] | None:
        """The best piece with its score, of those that are free even if they begin `late_m` late."""
        bend, turns = 1.0 / self.turns.radius_m, self.turns.opened_at(here)
        best: tuple[float, Piece] | None = None
        for length_m in LENGTHS_M:
            for gear in (1.0, -1.0):
                for curvature in (0.0, bend, -bend, bend / 2, -bend / 2):
                    piece = Piece(curvature, gear * length_m)
                    end = step(*here, *piece)
                    if not turns.piece_is_free(here, piece) or not self.turns.is_free(end[:2]):
                        continue
                    late = VehiclePose(*step(*here, 0.0, gear * late_m))
                    if late_m and not turns.piece_is_free(late, piece):
                        continue
                    if not self._clear(here, piece, everybody):
                        continue
                    score = min(_gap(end[:2], away_from), ENOUGH_M) - 0.2 * length_m
                    score -= 0.5 if gear < 0.0 else 0.0
                    if best is None or score > best[0] + 1e-9:
                        best = (score, piece)
        return best

    def _clear(self, here: VehiclePose, piece: Piece, everybody: list[Point]) -> bool:
        steps = max(1, int(abs(piece.length_m) / STEP_M))
        gear = copysign(1.0, piece.length_m)
        for other in everybody:
            dx_m, dy_m = other[0] - here.x_m, other[1] - here.y_m
            gap_m, most_m = hypot(dx_m, dy_m), 2 * self.radius_m + SPARE_M
            closing = gear * (dx_m * cos(here.heading_rad) + dy_m * sin(here.heading_rad))
            if gap_m < most_m + 0.02 and closing > 0.0:
                return False  # avoidance would not let it begin
            least_m = min(most_m, gap_m - 0.02)
            for k in range(1, steps + 1):
                x, y, _ = step(*here, piece.curvature_1_m, piece.length_m * k / steps)
                if hypot(x - other[0], y - other[1]) < least_m:
                    return False
        return True


def _gap(at: Point, others: list[Point]) -> float:
    return min((hypot(at[0] - x, at[1] - y) for x, y in others), default=ENOUGH_M)
