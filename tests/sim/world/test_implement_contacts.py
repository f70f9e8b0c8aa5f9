"""Implements that are down are bodies: what meets them is a contact, and robots keep off them."""

import pytest

from agent.interface.lifecycle import State
from agent.interface.observation import Observation
from agent.motion.deadlock_yield import NearbyRobot
from agent.motion.implement_clearance import Implement
from sim.fleet.outcome import FieldOutcome
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from sim.world.contact_free_steps import TRACK_US
from sim.world.ground_truth import Track, TrackPoint
from sim.world.implement_contacts import Met, implement_contacts, things_under_bars
from sim.world.walls import BOX, DISC

WIDTH_M, OVERLAP_M, RADIUS_M = 4.0, 0.2, 0.8


def drive(
    x_m: float, y_m: float, vx_m_s: float, vy_m_s: float, down: bool = True
) -> list[TrackPoint]:
    """Ten seconds straight on."""
    return [(k * TRACK_US, x_m + vx_m_s * k / 10, y_m + vy_m_s * k / 10, down) for k in range(100)]


def met(*tracks: list[TrackPoint]) -> list[Met]:
    found = implement_contacts(dict(enumerate(tracks)), WIDTH_M, OVERLAP_M, RADIUS_M)
    thinned = dict[int, Track]()
    for slot, track in enumerate(tracks):
        thinned[slot] = Track(0.01)
        for point in track:
            thinned[slot].add(*point)
    of_thinned = implement_contacts(thinned, WIDTH_M, OVERLAP_M, RADIUS_M)
    assert [m[:4] for m in found] == [m[:4] for m in of_thinned], "a launch keeps fewer points"
    return found


def test_m21_bars_that_pass_each_other_three_metres_apart_are_one_contact() -> None:
    (one,) = met(drive(0.0, 0.0, 2.5, 0.0), drive(20.0, 3.0, -2.5, 0.0))
    assert not one.body and (one.first, one.second) == (0, 1)


def test_m21_a_bar_through_a_body_is_a_contact_while_it_is_down() -> None:
    there = drive(10.0, 2.5, 0.0, 0.0, down=False)
    (one,) = met(drive(0.0, 0.0, 2.0, 0.0), there)
    assert one.body and one.t_us == pytest.approx(4_680_000, abs=100_000)
    assert not met(drive(0.0, 0.0, 2.0, 0.0, down=False), there), "up, it is folded"


def test_m21_neighbours_on_their_swaths_are_none() -> None:
    beside_m = WIDTH_M - OVERLAP_M  # each may be off its line by half of the overlap
    assert not met(drive(0.0, 0.08, 2.0, 0.0), drive(20.0, beside_m - 0.08, -2.0, 0.0))
    assert not met(drive(0.0, 0.0, 2.0, 0.0))


def test_m21_an_implement_goes_up_before_it_comes_into_a_body() -> None:
    implement = Implement(WIDTH_M / 2 - OVERLAP_M, RADIUS_M)
    here = Observation(0.0, 0.0, 0.0, 2.5, 0.0)
    for dx_m, dy_m, up in (
        (1.0, 2.4, True),
        (-1.0, -2.4, True),
        (3.0, 2.4, False),
        (0.0, 3.6, False),
    ):
        other = NearbyRobot(1, dx_m, dy_m, State.IDLE)
        assert implement.must_be_up(here, (2.5, 0.0), [other]) is up, (dx_m, dy_m)
    assert not Implement(0.0, RADIUS_M).must_be_up(
        here, (2.5, 0.0), [NearbyRobot(1, 1.0, 0.0, State.IDLE)]
    )


def test_m21_of_two_bars_that_meet_the_higher_slot_raises_its_own() -> None:
    implement = Implement(1.8, RADIUS_M)
    here = Observation(0.0, 0.0, 0.0, 2.5, 0.0)
    for dx_m, dy_m, ux, uy, crosses in (
        (2.0, 1.5, 0.0, 1.0, True),  # it drives across our way
        (0.0, 3.8, 1.0, 0.0, False),  # our neighbour on the next swath
        (0.0, 3.8, -1.0, 0.0, False),
        (1.2, 3.0, 0.7, -0.7, True),  # it turns towards us
        (2.0, 1.5, 0.0, 0.0, False),  # it stands, so nobody knows how its bar lies
    ):
        other = NearbyRobot(1, dx_m, dy_m, State.WORKING, ux, uy, True)
        assert implement.must_be_up(here, (2.5, 0.0), [other], 2) is crosses, (dx_m, dy_m)
        assert not implement.must_be_up(here, (2.5, 0.0), [other], 0)
        folded = other._replace(at_work=False)
        assert not implement.must_be_up(here, (2.5, 0.0), [folded], 2)


PERSON = (DISC, 10.0, 1.7, 0.25, 0.25, 1.0, 0.0)  # beside the way of a robot with a bar of 4 m


@pytest.mark.parametrize(
    ("thing", "down", "is_under"),
    [
        (PERSON, True, True),
        (PERSON, False, False),  # up, it is folded
        ((DISC, 10.0, 2.3, 0.25, 0.25, 1.0, 0.0), True, False),  # beyond the end of the bar
        ((DISC, 10.0, 2.24, 0.25, 0.25, 1.0, 0.0), True, False),  # it touches it
        ((DISC, 10.0, 2.22, 0.25, 0.25, 1.0, 0.0), True, True),
        ((BOX, 10.0, 2.3, 0.5, 0.5, 1.0, 0.0), True, True),
        ((BOX, 10.0, 2.6, 0.5, 0.5, 1.0, 0.0), True, False),
        ((BOX, 10.0, 2.6, 0.5, 0.5, 0.8**0.5, 0.2**0.5), True, True),  # with a corner towards it
    ],
)
def test_a_bar_over_a_thing_is_one_contact(
    thing: tuple[float, ...], down: bool, is_under: bool
) -> None:
    tracks = {0: drive(0.0, 0.0, 2.0, 0.0, down)}
    found = things_under_bars(tracks, [(0, [thing])], WIDTH_M)
    assert len(found) == is_under
    assert all(over.stood and over.t_us == pytest.approx(4_800_000, abs=200_000) for over in found)


def test_what_comes_under_a_bar_by_itself_did_not_stand() -> None:
    tracks = {0: drive(0.0, 0.0, 2.0, 0.0)}
    comes = [(k * TRACK_US, [(DISC, 10.0, 7.0 - k / 10, 0.25, 0.25, 1.0, 0.0)]) for k in range(100)]
    (over,) = things_under_bars(tracks, comes, WIDTH_M)
    assert not over.stood
    stands = {0: drive(0.0, 0.0, 0.0, 0.0)}
    assert not things_under_bars(stands, [(0, [(DISC, 0.0, 1.7, 0.25, 0.25, 1.0, 0.0)])], WIDTH_M)
    gone = [(0, [PERSON]), (2_000_000, [])]
    assert not things_under_bars(tracks, gone, WIDTH_M)


def test_each_thing_under_a_bar_is_a_contact_of_its_own() -> None:
    """A thing that is excused hid another one that the bar was over within the same second."""
    beside = (DISC, 11.0, -1.5, 0.25, 0.25, 1.0, 0.0)
    tracks = {0: drive(0.0, 0.0, 2.0, 0.0)}
    found = things_under_bars(tracks, [(0, [PERSON, beside])], WIDTH_M)
    assert [over.thing for over in found] == [PERSON, beside]


def test_what_comes_by_itself_and_then_stands_is_drawn_over() -> None:
    """A robot drove on, slowly, over a person that had stepped under its bar a second ago."""
    long = (BOX, 13.0, 1.7, 3.0, 0.25, 1.0, 0.0)
    tracks = {0: drive(0.0, 0.0, 2.0, 0.0)}
    found = things_under_bars(tracks, [(0, []), (5_500_000, [long])], WIDTH_M)
    assert [over.stood for over in found] == [False, True]
    assert found[1].t_us == pytest.approx(6_500_000, abs=100_000)


@pytest.mark.parametrize("speed_m_s", [0.5, 0.15, 0.05])
def test_a_robot_that_creeps_draws_its_bar_too(speed_m_s: float) -> None:
    """A step of less than 2 cm counted as none, so that no bar of a robot below 0.2 m/s was judged."""
    tracks = {0: drive(9.55 - 5.0 * speed_m_s, 0.0, speed_m_s, 0.0)}
    found = things_under_bars(tracks, [(0, [PERSON])], WIDTH_M)
    assert [over.stood for over in found] == [True]


def test_a_bar_of_a_robot_that_creeps_meets_a_body() -> None:
    (one,) = met(drive(9.0, 0.0, 0.15, 0.0), drive(11.0, 2.0, 0.0, 0.0, down=False))
    assert one.body


def test_what_comes_to_a_bar_that_stands_is_not_under_it() -> None:
    stops = [
        (t_us, min(x_m, 10.0), y_m, down) for t_us, x_m, y_m, down in drive(0.0, 0.0, 2.0, 0.0)
    ]
    assert not things_under_bars({0: stops}, [(0, []), (6_000_000, [PERSON])], WIDTH_M)
    goes_on = {0: drive(0.0, 0.0, 1.5, 0.0)}
    assert things_under_bars(goes_on, [(0, []), (6_000_000, [PERSON])], WIDTH_M)


def played(robots: int, seed: int) -> FieldOutcome:
    print("seed", seed)
    return FieldRun(
        FieldSetup(load("small").changed(robots, seed).with_engine("contact_free"))
    ).run()


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("robots", "seed"), [(3, 1), (3, 2), (6, 1), (6, 3)])
def test_m21_flawless_runs_have_no_contact_of_an_implement(robots: int, seed: int) -> None:
    outcome = played(robots, seed)
    assert outcome.success and outcome.implement_contacts == 0, outcome


@pytest.mark.slow
def test_m21_what_implements_meet_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """With robots that know nothing of implements, as they were."""
    monkeypatch.setattr(Implement, "must_be_up", lambda *_: False)
    monkeypatch.setattr(Implement, "combined_m", lambda _, apart_m, bodies_m: bodies_m)
    outcome = played(6, 1)
    assert outcome.implement_contacts > 0
