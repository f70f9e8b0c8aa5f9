"""What is left of a field beside bodies that are silent or stand is worked later."""

from collections.abc import Sequence

import numpy as np
import pytest
from shapely.geometry import LineString, Point, Polygon

from agent.field.field_division import divide
from agent.field.field_map import Field, Section, _piece
from agent.field.field_mission import SILENT_FOR_US, UNDER_A_BODY, FieldMission
from agent.field.section_choice import SectionChooser
from agent.field.tractor_mission import TractorMission
from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.lifecycle import State
from agent.interface.mission import THERE_M, FleetView
from agent.interface.observation import Neighbour, Observation
from agent.motion.tractor_tracker import SteeringLimits
from agent.paths.route import Route
from agent.paths.tractor_route import TurnRoute
from crdt import FieldAllocationCRDT, Progress
from protocol.frames.fleet_frames import Pose

PERIOD_S = CONTROL_PERIOD_US / S
ROWS = ((20.0, 20.0), (50.0, 20.0)), ((50.0, 40.0), (20.0, 40.0))
FENCES = ((0.0, 0.0), (70.0, 0.0), (70.0, 60.0), (0.0, 60.0))
DEAD = 37.0, 20.0  # on the first row


def free_cells() -> np.ndarray:
    return np.zeros((320, 320), dtype=np.bool_)


def field_of(*sections: Section) -> Field:
    return Field("rows", FENCES, (), (0.0, 0.0), ROWS[0][0], 4.0, 0.2, 5.0, sections)


def two_sections() -> FieldMission:
    field = field_of(Section(0, ROWS[:1], (6,)), Section(1, ROWS[1:], (6,)))
    return FieldMission(field, Route(free_cells(), -5.0, -5.0, 0.25), 0.8, 2.5, 1.5)


def silent_at(at: tuple[float, float] = DEAD) -> dict[int, Neighbour]:
    return {1: Neighbour(Pose(*at, 0.0, 0.0, State.WORKING, False, 0), 0)}


class TestUnitsUnderASilentBody:
    """Found by a review: such units were given up for good, although their robot came back."""

    def setup_method(self) -> None:
        self.work, self.allocation = two_sections(), FieldAllocationCRDT()
        self.progress = Progress(self.work.section_units)
        self.now_us, self.fell_silent_at_us = 10 * S, 0
        self.neighbours = silent_at()

    def view(self) -> FleetView:
        here = Observation(30.0, 30.0, 0.0, 0.0, 0.0, sensed_at_us=self.now_us)
        silent = {1: self.fell_silent_at_us} if self.neighbours else {}
        return FleetView(
            0, self.now_us, here, self.allocation, self.progress, frozenset({0}), silent,
            self.neighbours,
        )  # fmt: skip

    def hold(self, section: int) -> None:
        """Our robot takes a section and works all that is not blocked."""
        self.allocation.claim(section, 0, 0)
        self.allocation.start(section, 0)
        self.work.begin(section, self.view())
        self.work._look_round(self.view())
        blocked = self.work.blockage.units(self.work.field.section(section), things_too=False)
        for unit in set(range(6)) - blocked:
            self.progress.cover(section, unit)

    @property
    def waiting(self) -> frozenset[int]:
        return self.work._waiting(self.view())

    def test_they_wait_while_other_work_is_left(self) -> None:
        self.hold(0)
        wish = self.work.work(self.view())
        assert wish.given_up and not wish.finished and self.work.given_up_why == UNDER_A_BODY
        self.allocation.release(0, 0)
        assert self.waiting == {0}
        self.now_us += SILENT_FOR_US
        assert self.waiting == {0}, "section 1 is left"
        choice = self.work.choose(self.view())
        assert choice is not None and choice.section == 1

    def test_they_are_worked_when_their_robot_is_back(self) -> None:
        self.hold(0)
        self.work.work(self.view())
        self.allocation.release(0, 0)
        self.neighbours = {}
        self.work._look_round(self.view())
        assert self.waiting == frozenset()

    def test_a_section_is_ended_without_them_when_nothing_else_is_left(self) -> None:
        self.allocation.claim(1, 0, 0)
        self.allocation.start(1, 0)
        self.allocation.done(1, 0)
        self.hold(0)
        assert self.work.work(self.view()).given_up, "silent for 10 s only"
        self.allocation.release(0, 0)
        assert self.waiting == {0}
        self.now_us += SILENT_FOR_US
        assert self.waiting == frozenset()
        self.hold(0)
        assert self.work.work(self.view()).finished

    def test_two_such_sections_do_not_wait_for_each_other(self) -> None:
        self.neighbours[2] = Neighbour(Pose(30.0, 40.0, 0.0, 0.0, State.WORKING, False, 0), 0)
        self.now_us += SILENT_FOR_US
        view = self.view()._replace(fell_silent_at_us={1: 0, 2: 0})
        self.work._look_round(view)
        for section in self.work.field.sections:
            blocked = self.work.blockage.units(section, things_too=False)
            for unit in set(range(6)) - blocked:
                self.progress.cover(section.id, unit)
        assert self.work._waiting(view) == frozenset()
        recent = view._replace(fell_silent_at_us={1: 0, 2: self.now_us - S})
        assert self.work._waiting(recent) == {0, 1}


def test_a_reserved_section_without_headway_is_left_to_others_first() -> None:
    """Found by a review: it was claimed again at once, for ever, and the other reserved ones starved."""
    yard = Polygon([(-20, -14), (20, -14), (20, 14), (-20, 14)])
    field = divide("yard", yard, (0.0, 0.0), (-20.0, -14.0), 4.0, 0.2, 40.0, 5.0)
    progress = Progress({section.id: section.units for section in field.sections})
    allocation, chooser, at = FieldAllocationCRDT(), SectionChooser(field, 2.5), (-18.0, -12.0)
    neighbours = {1: Neighbour(Pose(18.0, 12.0, 0.0, 0.0, State.IDLE, False, 0), 0)}
    here = Observation(*at, 0.0, 0.0, 0.0)
    both = frozenset({0, 1})
    view = FleetView(0, 0, here, allocation, progress, both, {}, neighbours)
    chooser.choose(view, at)
    view = view._replace(live=frozenset({0}), fell_silent_at_us={1: S})
    bad, now_us = -1, S
    while now_us < 400 * S:
        view = view._replace(now_us=now_us)
        choice = chooser.choose(view, at)
        now_us += S if choice is None else 20 * S
        if choice is None:
            continue
        section = choice.section
        take = allocation.takeover if choice.takeover else allocation.claim
        take(section, 0, choice.bid)
        allocation.start(section, 0)
        if bad < 0 and section in chooser.reserved[1]:
            bad = section
        if section == bad:
            allocation.release(section, 0)
            chooser.gave_back(section, 0, now_us)
            continue
        allocation.done(section, 0)
        for unit in range(field.section(section).units):
            progress.cover(section, unit)
    left = [section.id for section in field.sections if not progress.complete(section.id)]
    assert bad >= 0 and left == [bad]


def tractor(*rows_of: Section) -> TractorMission:
    cells = free_cells()
    route, turns = Route(cells, -5.0, -5.0, 0.25), TurnRoute(cells, -5.0, -5.0, 0.25, 2.0)
    return TractorMission(field_of(*rows_of), route, turns, 0.8, SteeringLimits(2.5, 1.5, 0.67))


def view_of(
    work: FieldMission, here: Observation, progress: Progress, now_us: int,
    neighbours: dict[int, Neighbour] | None = None,
) -> FleetView:  # fmt: skip
    silent = {1: S} if neighbours else {}
    live = frozenset({0})
    return FleetView(
        0, now_us, here, FieldAllocationCRDT(), progress, live, silent, neighbours or {}
    )


def test_a_tractor_plans_no_legs_through_a_silent_body() -> None:
    """Found by a review: the legs of its approach did, and it kept them."""
    section = Section(0, ROWS, (6, 6))
    work = tractor(section)
    progress, neighbours, now_us = Progress(work.section_units), silent_at(), 100 * S

    def view() -> FleetView:
        here = Observation(5.0, 20.0, 0.0, 0.0, 0.0, sensed_at_us=now_us)
        return view_of(work, here, progress, now_us, neighbours)

    for _ in range(3):
        work.approach(0, view())
        now_us += CONTROL_PERIOD_US
    work.begin(0, view())
    units = [unit for leg in work.legs for unit in leg.units]
    assert units and not set(units) & work.blockage.units(section, things_too=False)


def test_a_tractor_works_no_units_that_others_covered_during_its_approach() -> None:
    section = Section(0, ROWS, (6, 6))
    work = tractor(section)
    progress = Progress(work.section_units)
    view = view_of(work, Observation(5.0, 20.0, 0.0, 0.0, 0.0), progress, S)
    work.approach(0, view)
    kept = work.legs
    for unit in range(6):
        progress.cover(0, unit)
    work.begin(0, view)
    assert kept and {unit for leg in work.legs for unit in leg.units} == set(range(6, 12))


@pytest.mark.parametrize(("pushed_m", "before_m"), [(0.6, 1.2), (0.7, 1.2), (0.75, 1.0)])
def test_a_tractor_that_is_sent_to_a_place_arrives_there(pushed_m: float, before_m: float) -> None:
    """Found by a review: one that gave way to another just before stood beside it for good."""
    work = tractor(Section(0, ROWS, (6, 6)))
    progress, goal, now_us, done_m = Progress(work.section_units), (45.0, 30.0), S, 0.0
    x_m, y_m, heading_rad, vx_m_s, vy_m_s = 20.0, 30.0, 0.0, 0.0, 0.0
    while np.hypot(goal[0] - x_m, goal[1] - y_m) > THERE_M:
        assert now_us < 120 * S, "it stands beside its goal"
        here = Observation(x_m, y_m, heading_rad, vx_m_s, vy_m_s, sensed_at_us=now_us)
        wish = work.travel(goal, view_of(work, here, progress, now_us))
        vx_m_s, vy_m_s = wish.vx_m_s, wish.vy_m_s
        if goal[0] - x_m < before_m and done_m < pushed_m:
            y_m, done_m = y_m + 0.05, done_m + 0.05
        x_m, y_m = x_m + vx_m_s * PERIOD_S, y_m + vy_m_s * PERIOD_S
        heading_rad += wish.turn_rad_s * PERIOD_S
        now_us += CONTROL_PERIOD_US


def test_a_unit_beside_an_obstacle_is_free_again_when_that_has_gone() -> None:
    """Found by a review: it stayed blocked as long as any other obstacle was known."""
    work = two_sections()
    progress, now_us = Progress(work.section_units), S
    here = Observation(34.0, 20.0, 0.0, 0.0, 0.0)
    near, far = frozenset({(34.5, 22.2)}), frozenset({(5.0, 58.0)})
    view = view_of(work, here, progress, now_us)._replace(things=near, leave_out=True)
    work.begin(0, view)
    work.work(view)
    assert work._leaves_out(view)
    assert work._blocked(view, last=True)
    work.work(view._replace(things=near | far))
    assert work._blocked(view, last=True)
    work.work(view._replace(things=far))
    assert not work._blocked(view, last=True)


def test_an_idle_robot_drives_round_a_dead_one_to_its_parking_place() -> None:
    """Found by a review: it looked for bodies only while it worked."""
    work = two_sections()
    progress = Progress(work.section_units)
    for unit in range(6):
        progress.cover(1, unit)
    on_line, dead = (32.5, 20.0), (32.5, 30.0)
    here = Observation(*on_line, 0.0, 0.0, 0.0)
    view = view_of(work, here, progress, 60 * S, silent_at(dead))
    work.idle(view)
    spot = work.parking.spot
    assert spot is not None
    way = LineString([on_line, *work.remaining_path])
    assert way.distance(Point(dead)) > 1.6, "hulls would touch"
    assert LineString([on_line, spot]).distance(Point(dead)) < 1.6, "it is in the way"


def test_resumed_work_is_that_of_the_section_that_was_started() -> None:
    work, allocation = two_sections(), FieldAllocationCRDT()
    allocation.claim(0, 0, 0)
    allocation.claim(1, 0, 0)
    allocation.start(1, 0)
    view = view_of(work, Observation(5.0, 20.0, 0.0, 0.0, 0.0), Progress(work.section_units), S)
    work.work(view._replace(allocation=allocation))
    assert work.section is not None and work.section.id == 1


@pytest.mark.parametrize("count", [1, 7, 124])
def test_lines_of_units_are_the_pieces_of_their_rows(count: int) -> None:
    rows: Sequence[tuple[tuple[float, float], ...]] = (
        ((1.5, -2.25), (301.0, 77.7)),
        ((0.0, 0.0), (10.0, 0.0), (10.0, 33.3)),
    )
    section = Section(0, tuple(rows), (count, count))
    pieces = [_piece(row, unit, unit + 1, count) for row in rows for unit in range(count)]
    assert list(section.unit_lines) == pieces
