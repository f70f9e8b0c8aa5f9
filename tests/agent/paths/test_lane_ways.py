"""The shortest way over lanes and regions of free cells."""

from agent.paths.lane_ways import LaneWays

# Region 1 in the west, 2 in the east; a long lane and a short one between them; a blind one behind 2.
LONG = ((10.0, 0.0), (15.0, 20.0), (20.0, 0.0))
SHORT = ((10.0, 5.0), (20.0, 5.0))
BLIND = ((30.0, 0.0), (40.0, 0.0), (40.0, 10.0))
LANES = LaneWays([LONG, SHORT, BLIND])
ENDS = {at: 1 if at[0] <= 10.0 else 2 for at in LANES.ends} | {(40.0, 10.0): 0}


def way(
    start: tuple[float, float], a: int, goal: tuple[float, float], b: int
) -> list[tuple[float, float]]:
    legs = LANES.legs(start, a, goal, b, ENDS)
    assert legs is not None
    return [start, *(at for leg in legs for at in leg.points[1:])]


def test_the_shorter_lane_is_taken() -> None:
    assert way((0.0, 0.0), 1, (25.0, 0.0), 2) == [(0.0, 0.0), *SHORT, (25.0, 0.0)]


def test_a_blind_lane_ends_at_its_end() -> None:
    assert way((0.0, 5.0), 1, (40.0, 10.0), 0) == [(0.0, 5.0), *SHORT, *BLIND]


def test_a_place_beside_a_lane_is_reached_along_it() -> None:
    assert way((40.5, 4.0), 0, (40.0, 8.0), 0) == [
        (40.5, 4.0),
        (40.0, 4.0),
        (40.0, 8.0),
        (40.0, 8.0),
    ]
    assert way((40.5, 4.0), 0, (35.0, 0.5), 0)[1:-1] == [(40.0, 4.0), (40.0, 0.0), (35.0, 0.0)]


def test_there_may_be_no_way() -> None:
    assert LANES.legs((0.0, 0.0), 1, (90.0, 0.0), 3, ENDS) is None
