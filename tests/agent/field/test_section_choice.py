"""Which section a robot wants: its share; and what was left to others and nobody takes."""

from math import hypot

import numpy as np
from shapely.geometry import Polygon

from agent.field.field_division import divide
from agent.field.section_choice import UNTAKEN_US, SectionChooser
from agent.field.travel_times import TravelTimes
from agent.interface.config import S
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView
from agent.interface.observation import Neighbour, Observation
from agent.paths.route import Route
from crdt import FieldAllocationCRDT, Progress
from protocol.frames.codec import decode_once, encode
from protocol.frames.fleet_frames import Pose

YARD = Polygon([(-20, -14), (20, -14), (20, 14), (-20, 14)])
FIELD = divide("yard", YARD, (0.0, 0.0), (-20.0, -14.0), 4.0, 0.2, 40.0, 5.0)
LAST = 4
END = FIELD.section(LAST).ends[-1]
PLACES = {0: (END[0] + 1.3, END[1] - 3.3), 2: (END[0] + 0.2, END[1] + 3.55)}  # 3.55 and 3.56 m


def told(slot: int, x_m: float, y_m: float) -> Neighbour:
    """As others hear it: in steps of 5 cm."""
    _, pose = decode_once(encode(Pose(x_m, y_m, 0.0, 0.0, State.IDLE, False, 0), 128 + slot))
    assert isinstance(pose, Pose)
    return Neighbour(pose, 0)


def all_but_one() -> FieldAllocationCRDT:
    allocation = FieldAllocationCRDT()
    for section in FIELD.sections:
        if section.id != LAST:
            allocation.done(section.id, 0)
    return allocation


def first_wants_us(slot: int, places: dict[int, tuple[float, float]]) -> int | None:
    """When it wants the last section, while nobody takes it."""
    progress = Progress({section.id: section.units for section in FIELD.sections})
    choosing, other = SectionChooser(FIELD, 2.5), 2 - slot
    here = Observation(*places[slot], 0.0, 0.0, 0.0)
    view = FleetView(
        slot, 0, here, all_but_one(), progress, frozenset(places), {},
        {other: told(other, *places[other])},
    )  # fmt: skip
    for now_us in range(0, UNTAKEN_US + S, S):
        choice = choosing.choose(view._replace(now_us=now_us), places[slot])
        if choice is not None:
            assert choice.section == LAST
            return now_us
    return None


def test_what_each_leaves_to_the_other_is_taken_after_a_while() -> None:
    """Found by `headland chaos`, profile all, seed 6242: both idle, the section free, for good."""
    nobody = 0
    for k in range(-20, 21):
        places = {0: (PLACES[0][0], PLACES[0][1] + k * 0.005), 2: PLACES[2]}
        wants_us = [first_wants_us(slot, places) for slot in places]
        assert set(wants_us) <= {0, UNTAKEN_US}
        nobody += 0 not in wants_us
    assert 0 < nobody < 41, "what the test is about"


def test_what_is_planned_for_a_working_robot_is_left_to_it_until_it_should_have_taken_it() -> None:
    """An idle robot took such a section after 5 s, and drove to it across the field for 97 s; the
    working robot, next to it, was free 6 s later (`oxted`, 12 robots, seed 5)."""
    held = FIELD.section(LAST - 1)
    allocation = FieldAllocationCRDT()
    for section in FIELD.sections:
        if section.id not in (held.id, LAST):
            allocation.done(section.id, 0)
    allocation.claim(held.id, 2)
    progress = Progress({section.id: section.units for section in FIELD.sections})
    for unit in range(held.units // 2):
        progress.cover(held.id, unit)
    route = Route(np.zeros((220, 220), bool), -55, -55, 0.5)
    choosing = SectionChooser(FIELD, 2.5, TravelTimes(FIELD, route, 2.5, 2.0, 1.4))
    here = max(
        ((x_m, y_m) for x_m in (-50.0, 50.0) for y_m in (-50.0, 50.0)),
        key=lambda at: min(hypot(at[0] - e[0], at[1] - e[1]) for e in FIELD.section(LAST).ends),
    )
    at = held.unit_lines[held.units // 2][0]
    view = FleetView(
        0, 0, Observation(*here, 0.0, 0.0, 0.0), allocation, progress, frozenset((0, 2)), {},
        {2: told(2, *at)},
    )  # fmt: skip
    left_us = round(1e6 * held.length_m / 2 / 2.5)
    times = (now_us for now_us in range(0, 60 * S, S // 2))
    wants = (now for now in times if choosing.choose(view._replace(now_us=now), here) is not None)
    assert left_us + UNTAKEN_US <= next(wants) <= left_us + 2 * UNTAKEN_US


def test_other_sections_that_are_finished_do_not_put_off_what_nobody_takes() -> None:
    """A robot gave its last section back, and 23 idle ones left it to that robot until it took it
    again, 20 s later: each section that was finished meanwhile restarted their 5 s (`oxted`, 24
    robots, seed 1)."""
    early = [section.id for section in FIELD.sections[:LAST]]
    allocation = FieldAllocationCRDT()
    for section in FIELD.sections:
        if section.id != LAST and section.id not in early:
            allocation.done(section.id, 0)
    for number in early:
        allocation.claim(number, 4)
    progress = Progress({section.id: section.units for section in FIELD.sections})
    route = Route(np.zeros((220, 220), bool), -55, -55, 0.5)
    choosing = SectionChooser(FIELD, 2.5, TravelTimes(FIELD, route, 2.5, 2.0, 1.4))
    here = (50.0, 50.0)
    view = FleetView(
        0, 0, Observation(*here, 0.0, 0.0, 0.0), allocation, progress, frozenset((0, 2)), {},
        {2: told(2, *END)},
    )  # fmt: skip
    assert choosing.choose(view, here) is None, "it is the other robot's, which does not take it"
    for now_us in range(S, UNTAKEN_US + 3 * S, S):
        if early:
            allocation.done(early.pop(), 4)
        choice = choosing.choose(view._replace(now_us=now_us), here)
        if choice is not None:
            break
    assert choice is not None and choice.section == LAST
    assert now_us <= UNTAKEN_US + S
