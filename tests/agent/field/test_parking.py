"""Where a robot without work stands: in nobody's way, and not in a corner."""

from math import hypot

from shapely.geometry import LineString, Polygon
from shapely.geometry import Point as Spot

from agent.field.field_division import divide
from agent.field.parking import LOOK_US, STUCK_US, Parking
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView
from agent.interface.observation import Neighbour, Observation
from crdt import FieldAllocationCRDT, Progress
from protocol.frames.fleet_frames import Pose

RADIUS_M = 0.8
YARD = Polygon([(-20, -14), (20, -14), (20, 14), (-20, 14)])
FIELD = divide("yard", YARD, (0.0, 0.0), (-20.0, -14.0), 4.0, 0.2, 40.0, 5.0)
UNITS = {section.id: section.units for section in FIELD.sections}


def view(
    at: tuple[float, float], open_sections: set[int], others: dict[int, tuple[float, float, State]]
) -> FleetView:
    progress = Progress(UNITS)
    for section in FIELD.sections:
        if section.id not in open_sections:
            for unit in range(section.units):
                progress.cover(section.id, unit)
    neighbours = {
        slot: Neighbour(Pose(x, y, 0.0, 0.0, state, False, 0), 0)
        for slot, (x, y, state) in others.items()
    }
    return FleetView(
        0, 0, Observation(*at, 0.0, 0.0, 0.0), FieldAllocationCRDT(), progress,
        frozenset((0, *others)), {}, neighbours,
    )  # fmt: skip


def open_gap_m(at: tuple[float, float], open_sections: set[int]) -> float:
    lines = [line for s in open_sections for line in FIELD.section(s).unit_lines]
    return float(min(LineString(line).distance(Spot(at)) for line in lines))


def test_who_stands_on_an_open_line_leaves_it_also_from_a_corner() -> None:
    for section in FIELD.sections:
        for corner in ((-18.9, -12.9), (18.9, 12.9), section.swaths[0][0]):
            parking = Parking(FIELD, RADIUS_M)
            seen = view(corner, {section.id}, {})
            parking.observe(seen)
            if open_gap_m(corner, {section.id}) >= parking.room_m:
                assert parking.spot is None, "it is in nobody's way"
            else:
                assert parking.spot is not None
                assert open_gap_m(parking.spot, {section.id}) >= 2 * RADIUS_M
                assert YARD.buffer(-RADIUS_M).contains(Spot(parking.spot))


def test_two_that_rest_do_not_take_one_place() -> None:
    start = FIELD.sections[0].swaths[0][0]
    parking = Parking(FIELD, RADIUS_M)
    parking.observe(view(start, {0}, {}))
    taken = parking.spot
    assert taken is not None
    other = Parking(FIELD, RADIUS_M)
    other.observe(view(start, {0}, {1: (*taken, State.IDLE)}))
    assert other.spot is not None
    assert hypot(other.spot[0] - taken[0], other.spot[1] - taken[1]) >= 2 * RADIUS_M


def test_without_open_work_nobody_moves() -> None:
    parking = Parking(FIELD, RADIUS_M)
    parking.observe(view((-18.9, -12.9), set(), {}))
    assert parking.spot is None


def test_who_rests_leaves_where_one_that_works_does_not_get_on() -> None:
    """Found by `headland chaos`, profile stop, seed 6045: a robot rested, far from every open line, where
    another had no way out of a corner but past it."""
    corner, rests, open_sections = (-19.38, -13.46), (-18.6, -11.89), {8}
    parking = Parking(FIELD, RADIUS_M)
    seen = view(rests, open_sections, {2: (*corner, State.WORKING)})
    for now_us in range(0, STUCK_US, LOOK_US):
        parking.observe(seen._replace(now_us=now_us))
        assert parking.spot is None, "it may only be passing"
    parking.observe(seen._replace(now_us=STUCK_US))
    assert parking.spot is not None
    assert hypot(parking.spot[0] - corner[0], parking.spot[1] - corner[1]) > 5.0
    moved = view(rests, open_sections, {2: (corner[0] + 4.5, corner[1], State.WORKING)})
    other = Parking(FIELD, RADIUS_M)
    for now_us, look in ((0, seen), (LOOK_US, moved), (STUCK_US, moved)):
        other.observe(look._replace(now_us=now_us))
    assert other.spot is None, "it gets on"


def test_a_line_that_was_worked_meanwhile_is_open_no_longer() -> None:
    """Points on the lines are kept until a unit of their section is covered."""
    parking, at = Parking(FIELD, RADIUS_M), FIELD.sections[0].swaths[0][0]
    seen = view(at, {FIELD.sections[0].id}, {})
    parking.observe(seen)
    assert parking.spot is not None
    for section in FIELD.sections:
        for unit in range(section.units):
            seen.progress.cover(section.id, unit)
    parking.forget()
    parking.observe(seen._replace(now_us=LOOK_US))
    assert parking.spot is None, "nothing is left to work, so it may stay where it is"


def test_it_parks_where_no_bar_reaches() -> None:
    """It stood 4.2 m from a corner: a bar of 8 m that swung round the corner had to go up each time."""
    at, open_sections = (-14.0, 4.0), {FIELD.sections[-1].id}
    gap_m = open_gap_m(at, open_sections)
    narrow, wide = Parking(FIELD, RADIUS_M), Parking(FIELD, RADIUS_M, bar_m=gap_m + 1.0)
    assert narrow.room_m < gap_m and wide.room_m == gap_m + 1.0
    seen = view(at, open_sections, {})
    narrow.observe(seen)
    assert narrow.spot is None
    wide.observe(seen)
    assert wide.spot is not None and open_gap_m(wide.spot, open_sections) >= gap_m + 1.0
