"""Ways of a steered body out of another one's way that avoidance lets it begin."""

from math import cos, hypot, sin

import numpy as np

from agent.motion.tractor_escape import SPARE_M, EscapeManoeuvre
from agent.motion.tractor_tracker import SteeringLimits
from agent.paths.dubins import step
from agent.paths.tractor_route import TurnRoute, VehiclePose

RADIUS_M = 0.4
TURNS = TurnRoute(np.zeros((160, 160), dtype=bool), -20.0, -20.0, 0.25, 0.6)  # 40 x 40 m
OTHER = 0.3, -1.09  # so near that avoidance lets bodies only go away from each other


def test_an_escape_does_not_begin_towards_a_body_that_is_near() -> None:
    """Of three differential bodies in an acute corner one waited
    for good to begin an arc that would have led past the other one."""
    escape = EscapeManoeuvre(TURNS, RADIUS_M, SteeringLimits(1.5, 1.0, 3.0))
    assert hypot(*OTHER) < 2 * RADIUS_M + SPARE_M
    for heading_rad in np.linspace(-3.0, 3.0, 24):
        piece = escape.find(VehiclePose(0.0, 0.0, float(heading_rad)), [OTHER], [OTHER])
        assert piece is not None
        ahead = OTHER[0] * cos(heading_rad) + OTHER[1] * sin(heading_rad)
        assert ahead * piece.length_m <= 0.0, f"heading {heading_rad:.2f}: {piece}"


def test_an_escape_is_found_where_there_is_room_for_a_short_one_only() -> None:
    """Two differential bodies nose to tail in an acute corner stood there for good."""
    walls = np.ones((80, 80), dtype=bool)
    walls[36:45, 36:47] = False  # 2.75 m by 2.25 m about the body
    corner = TurnRoute(walls, -10.0, -10.0, 0.25, 0.6)
    escape = EscapeManoeuvre(corner, RADIUS_M, SteeringLimits(1.5, 1.0, 3.0))
    behind = -1.2, 0.0
    piece = escape.find(VehiclePose(0.0, 0.0, 0.0), [behind], [behind])
    assert piece is not None and piece.length_m > 0.0


def test_an_escape_leads_out_of_a_free_cell_without_a_free_one_beside_it() -> None:
    """At the end of a row beside an aslant fence, an idle robot stood for good before a working one."""
    walls = np.zeros((80, 80), dtype=bool)
    rows, columns = np.indices(walls.shape)
    walls[rows + columns > 80 - 3] = True
    walls[40, 40] = False
    fence = TurnRoute(walls, -10.0, -10.0, 0.25, 0.6)
    escape = EscapeManoeuvre(fence, RADIUS_M, SteeringLimits(1.5, 1.0, 3.0))
    here, other = VehiclePose(0.125, 0.125, -2.2), (1.5, -1.5)
    piece = escape.find(here, [other], [other])
    assert piece is not None and fence.is_free(step(*here, *piece)[:2])


def test_no_escape_ends_in_a_cell_that_is_only_opened_to_be_left() -> None:
    """It would end beside the fence, where the body stands again."""
    walls = np.ones((80, 80), dtype=bool)
    walls[40, 40] = False
    shut_in = TurnRoute(walls, -10.0, -10.0, 0.25, 0.6)
    escape = EscapeManoeuvre(shut_in, RADIUS_M, SteeringLimits(1.5, 1.0, 3.0))
    here, other = VehiclePose(0.125, 0.125, 0.0), (-2.0, 0.0)
    assert escape.find(here, [other], [other]) is None
