"""Implements that meet are counted, from tracks."""

from sim.gliding import TRACK_US
from sim.implement_contacts import implement_contacts
from sim.truth import TrackPoint

WIDTH_M, RADIUS_M = 4.0, 0.8


def drive(x_m: float, y_m: float, vx_m_s: float, vy_m_s: float) -> list[TrackPoint]:
    """Ten seconds straight on."""
    return [(k * TRACK_US, x_m + vx_m_s * k / 10, y_m + vy_m_s * k / 10, True) for k in range(100)]


def met(*tracks: list[TrackPoint]) -> int:
    return implement_contacts(dict(enumerate(tracks)), WIDTH_M, RADIUS_M)


def test_m21_bars_that_pass_each_other_two_metres_apart_are_one_contact() -> None:
    assert met(drive(0.0, 0.0, 2.0, 0.0), drive(20.0, 2.0, -2.0, 0.0)) == 1


def test_m21_a_bar_through_a_body_is_a_contact() -> None:
    assert met(drive(0.0, 0.0, 2.0, 0.0), drive(10.0, 2.5, 0.0, 0.0)) == 1


def test_m21_neighbours_on_their_swaths_are_none() -> None:
    assert met(drive(0.0, 0.0, 2.0, 0.0), drive(20.0, 4.9, -2.0, 0.0)) == 0
    assert met(drive(0.0, 0.0, 2.0, 0.0)) == 0
