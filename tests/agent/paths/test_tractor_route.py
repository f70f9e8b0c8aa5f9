"""Ways that turn: they end where asked, stay on free ground, and never turn tighter than they may."""

from math import hypot, pi, remainder
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.paths.hybrid_a_star import CHECK_M
from agent.paths.tractor_route import Piece, TurnRoute, VehiclePose, sampled

CELL_M, RADIUS_M = 0.25, 1.8
WIDTH_M, HEIGHT_M, BORDER_M = 40.0, 30.0, 1.0
SAG_M = CHECK_M**2 / 8 / RADIUS_M  # of an arc, between two points that the search looks at


def paddock() -> NDArray[np.bool_]:
    blocked = np.ones((int(HEIGHT_M / CELL_M), int(WIDTH_M / CELL_M)), dtype=bool)
    border = int(BORDER_M / CELL_M)
    blocked[border:-border, border:-border] = False
    return blocked


def turns(blocked: NDArray[np.bool_] | None = None) -> TurnRoute:
    return TurnRoute(paddock() if blocked is None else blocked, 0.0, 0.0, CELL_M, RADIUS_M)


def check(
    route: TurnRoute, start: VehiclePose, goal: VehiclePose, pieces: list[Piece] | None
) -> NDArray[Any]:
    assert pieces
    way = sampled(start, pieces)
    assert hypot(way[-1, 0] - goal.x_m, way[-1, 1] - goal.y_m) < 1e-3
    assert abs(remainder(way[-1, 2] - goal.heading_rad, 2 * pi)) < 1e-3
    assert all(abs(piece.curvature_1_m) <= 1.0 / RADIUS_M + 1e-9 for piece in pieces)
    for x, y in way[:, :2]:
        beside = [(x + dx, y + dy) for dx in (-SAG_M, 0.0, SAG_M) for dy in (-SAG_M, 0.0, SAG_M)]
        assert any(map(route.is_free, beside)), (x, y)
    steps = np.hypot(np.diff(way[:, 0]), np.diff(way[:, 1]))
    assert steps.max() < 0.11
    return way


def poses(margin_m: float) -> st.SearchStrategy[VehiclePose]:
    edge_m = BORDER_M + margin_m
    return st.builds(
        VehiclePose,
        st.floats(edge_m, WIDTH_M - edge_m),
        st.floats(edge_m, HEIGHT_M - edge_m),
        st.floats(-pi, pi),
    )


@given(poses(0.5), poses(1.2))
# A corner in which no long piece is free.
@example(VehiclePose(38.75, 1.5, 1.0), VehiclePose(3.0, 3.0, 0.0))
@settings(max_examples=25, deadline=None)
def test_any_pose_leads_to_any_other(start: VehiclePose, goal: VehiclePose) -> None:
    """Nose to the fence, too; the goal has the room that stretches have. Deeper in a corner there are
    poses that a turning circle does not come out of by pieces that are worth driving."""
    route = turns()
    pieces = route.way(start, goal)
    assert pieces is not None
    if pieces:
        check(route, start, goal, pieces)
    else:
        assert hypot(start.x_m - goal.x_m, start.y_m - goal.y_m) < 1e-3


@pytest.mark.parametrize("apart_m", [1.9, 2.8, 3.8, 7.6])
@pytest.mark.parametrize("headland_m", [1.0, 2.0, 3.0, 6.0])
def test_row_ends(apart_m: float, headland_m: float) -> None:
    """From one row into the next: a half circle, a bulb, or back and forth where it is narrow."""
    route = turns()
    east_m = WIDTH_M - BORDER_M - headland_m
    start, goal = VehiclePose(east_m, 12.0, 0.0), VehiclePose(east_m, 12.0 + apart_m, pi)
    pieces = route.way(start, goal)
    way = check(route, start, goal, pieces)
    if headland_m >= 6.0:
        assert (way[:, 4] > 0.0).all(), "with room enough nobody backs up"
    if headland_m >= 3.0 and apart_m == 3.8:
        assert sum(abs(p.length_m) for p in pieces or []) < 12.0


def test_out_of_a_dead_end_it_backs() -> None:
    blocked = paddock()
    row, column = int(10 / CELL_M), int(20 / CELL_M)
    blocked[row : row + 2, column:] = blocked[row + 10 : row + 12, column:] = True
    route = turns(blocked)
    start = VehiclePose(35.0, 11.5, 0.0)
    goal = VehiclePose(10.0, 11.5, pi)
    pieces = route.way(start, goal)
    way = check(route, start, goal, pieces)
    assert (way[:, 4] < 0.0).any()


@pytest.mark.parametrize("from_rad", [0.5, 2.0, -2.0])
def test_i26_a_goal_with_a_fence_behind_it_is_reached_straight_back(from_rad: float) -> None:
    """A way that ended in an arc there led beside the goal, and the first unit was missed."""
    route = turns()
    goal = VehiclePose(BORDER_M + 0.3, 15.0, 0.0)
    start = VehiclePose(9.0, 13.0, from_rad)
    pieces = route.way(start, goal)
    way = check(route, start, goal, pieces)
    assert pieces is not None and pieces[-1].curvature_1_m == 0.0
    assert pieces[-1].length_m <= -0.5 and way[-1, 4] == -1.0


HEMMED_IN = VehiclePose(20.125, 15.125, pi / 4)  # the middle of a cell


def with_a_free_cell() -> NDArray[np.bool_]:
    """Ground whose only free cell beside an aslant fence is a cell away from other free ones."""
    blocked = paddock()
    rows, columns = np.indices(blocked.shape)
    blocked[rows + columns > 60 + 80 - 3] = True
    blocked[60, 80] = False
    return blocked


def test_a_body_in_a_free_cell_without_a_free_one_beside_it_gets_out() -> None:
    """A fleet never finished: an idle robot stood at the end of a row, where it was in the way."""
    route = turns(with_a_free_cell())
    goal = VehiclePose(12.0, 12.0, pi)
    assert route.is_free((HEMMED_IN.x_m, HEMMED_IN.y_m))
    assert not any(route.piece_is_free(HEMMED_IN, Piece(0.0, way_m)) for way_m in (0.6, -0.6))
    assert route.way(HEMMED_IN, goal)
    assert route.way(goal, HEMMED_IN)
    opened = route.opened_at(HEMMED_IN)
    assert opened.piece_is_free(HEMMED_IN, Piece(0.0, -3.0))
    assert not opened.piece_is_free(HEMMED_IN, Piece(0.0, 3.0))
    assert route.opened_at(goal) is route


def test_no_way_is_said_to_be_none() -> None:
    blocked = paddock()
    blocked[:, 80:82] = True
    assert turns(blocked).way(VehiclePose(5.0, 15.0, 0.0), VehiclePose(35.0, 15.0, 0.0)) is None


def test_bodies_are_gone_round() -> None:
    route = turns()
    start, goal = VehiclePose(5.0, 15.0, 0.0), VehiclePose(35.0, 15.0, 0.0)
    way = check(route, start, goal, route.way(start, goal, [(20.0, 15.0)], 2.0))
    assert np.hypot(way[:, 0] - 20.0, way[:, 1] - 15.0).min() > 1.7
    assert len(route.way(start, goal) or []) <= 4, "and are forgotten with the question"


def test_a_way_that_bends_begins_with_a_run_out_where_there_is_room() -> None:
    start, goal = VehiclePose(20.0, 10.0, pi / 2), VehiclePose(16.2, 10.0, -pi / 2)
    route = turns()
    bends, straight = route.way(start, goal), route.way(start, goal, run_out_m=0.5)
    assert bends and bends[0].curvature_1_m > 0.0
    assert straight and straight[0] == Piece(0.0, 0.5)
    check(route, start, goal, straight)
    nose_to_fence = VehiclePose(20.0, HEIGHT_M - BORDER_M - 0.3, pi / 2)
    assert route.way(nose_to_fence, goal, run_out_m=0.5) == route.way(nose_to_fence, goal)
