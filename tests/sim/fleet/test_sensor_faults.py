"""Faults of a position receiver, alone and together."""

from math import inf
from random import Random

import pytest

from agent.interface.effects import Drive
from agent.interface.observation import Observation
from sim.fleet.sensor_faults import Receiver, Scanner
from sim.world.drive_trains import STEP_US, Chassis
from sim.world.world import World

PERIOD_US = 50_000


def seen(world_us: int) -> Observation:
    """A robot that drives east with 1 m/s."""
    return Observation(world_us / 1e6, 0.0, 0.0, 1.0, 0.0, sensed_at_us=world_us)


def arrivals(receiver: Receiver, from_us: int, to_us: int) -> list[tuple[float, int]]:
    """Place and age of what arrives in each period."""
    found = []
    for world_us in range(from_us, to_us, PERIOD_US):
        arrived = receiver.tells(seen(world_us), world_us)
        assert arrived is not None
        found.append((arrived.x_m, world_us - arrived.sensed_at_us))
    return found


def test_a_hung_filter_repeats_the_place_with_new_times() -> None:
    receiver = Receiver()
    arrivals(receiver, 0, 1_000_000)
    receiver.frozen(1_000_000, 2_000_000)
    assert set(arrivals(receiver, 1_000_000, 2_000_000)) == {(0.95, 0)}
    assert arrivals(receiver, 2_000_000, 2_050_000) == [(2.0, 0)]


def test_a_filter_that_hangs_while_the_process_is_down_repeats_a_newer_place() -> None:
    """Found by `headland chaos`, profile all, seed 20001421: it repeated what the process had heard
    before it crashed, a place that had jumped and was right again by then. The robot believed it."""
    receiver = Receiver()
    receiver.jumped(1_000_000, (3.0, 0.0, 0.0))
    arrivals(receiver, 0, 1_000_000)
    receiver.frozen(5_000_000, 9_000_000)
    assert set(arrivals(receiver, 8_000_000, 9_000_000)) == {(8.0, 0)}


def test_what_a_hung_filter_repeats_is_delayed_by_a_full_buffer() -> None:
    """Found by `headland chaos`, profile body, seed 970092: the buffer's delay ended when the filter
    hung, so the robot drove on although its senses were still late."""
    receiver = Receiver()
    arrivals(receiver, 0, 1_000_000)
    receiver.late(4_000_000, 500_000)
    arrivals(receiver, 1_000_000, 2_000_000)
    receiver.frozen(2_000_000, 6_000_000)
    both = arrivals(receiver, 2_000_000, 4_000_000)
    assert {age_us for _, age_us in both} == {500_000}
    assert both[-1][0] == 1.95
    assert set(arrivals(receiver, 4_000_000, 6_000_000)) == {(1.95, 0)}


def test_a_place_that_jumped_is_wrong_by_as_much_and_then_right_again() -> None:
    receiver = Receiver()
    receiver.jumped(1_000_000, (3.0, -4.0, 0.5))
    arrived = receiver.tells(seen(500_000), 500_000)
    assert arrived is not None and arrived[:3] == (3.5, -4.0, 0.5)
    assert arrivals(receiver, 1_000_000, 1_050_000) == [(1.0, 0)]


def test_what_a_hung_filter_repeats_neither_drifts_nor_jumps() -> None:
    """Found by `headland chaos`, profile senses, seed 11000010: a drift that began while the filter hung
    was added to what it repeated, in each period again. The robot took that for a place that follows."""
    receiver = Receiver()
    arrivals(receiver, 0, 1_000_000)
    receiver.frozen(1_000_000, 2_000_000)
    receiver.drifting(1_500_000, 3_000_000, (0.1, 0.0))
    receiver.jumped(1_800_000, (3.0, 0.0, 0.0))
    assert set(arrivals(receiver, 1_000_000, 2_000_000)) == {(0.95, 0)}
    ((x_m, _),) = arrivals(receiver, 2_000_000, 2_050_000)
    assert x_m == pytest.approx(2.05), "it thaws where the drift is by then"


def test_a_place_that_drifts_says_how_far_it_is_wrong() -> None:
    receiver = Receiver()
    receiver.drifting(0, 2_000_000, (0.3, -0.4))
    arrived = receiver.tells(seen(1_000_000), 1_000_000)
    assert arrived is not None and arrived[:2] == pytest.approx((1.3, -0.4))
    assert arrived.position_accuracy_m == pytest.approx(0.5)
    assert arrivals(receiver, 2_000_000, 2_050_000) == [(2.0, 0)]


def test_scans_are_absent_hang_and_are_noisy() -> None:
    def scan(scanner: Scanner, t_us: int) -> tuple[float, ...]:
        return scanner.tells(seen(t_us)._replace(ranges_m=(t_us / 1e6, inf)), t_us).ranges_m

    scanner = Scanner()
    assert scan(scanner, 1_000_000) == (1.0, inf)
    scanner.stuck(3_000_000)
    scanner.dead(2_000_000)
    assert scan(scanner, 1_900_000) == ()
    assert scan(scanner, 2_500_000) == (1.0, inf) and scan(scanner, 3_000_000) == (3.0, inf)
    scanner.noisy(5_000_000, Random(1), 0.1, 0.5)
    noisy = [scan(scanner, 4_000_000)[0] for _ in range(1_000)]
    assert 400 < noisy.count(inf) < 600 and len(set(noisy)) > 400 and min(noisy) > 3.0
    assert scan(scanner, 5_000_000) == (5.0, inf)


def test_hung_fixes_let_a_place_fall_back_and_then_it_is_the_true_one() -> None:
    receiver = Receiver()
    receiver.hung_fixes(1_500_000, 200_000, 1.0)
    told = []
    for now_us in range(1_000_000, 1_700_000, 50_000):
        place = Observation(now_us / 1e6, 0.0, 0.0, 1.0, 0.0, sensed_at_us=now_us)
        seen = receiver.tells(place, now_us)
        assert seen is not None and seen.sensed_at_us == now_us
        told.append(round(seen.x_m, 3))
    saw = [1.0, 1.05, 1.1, 1.15]
    assert told == [*saw, *saw, 1.0, 1.05, 1.5, 1.55, 1.6, 1.65]


def test_wheels_that_are_deaf_get_no_command() -> None:
    receiver = Receiver()
    receiver.deaf_wheels(1_000_000)
    assert [receiver.drives(now_us) for now_us in (0, 999_999, 1_000_000)] == [False, False, True]


def test_wheels_slip_as_much_as_a_fault_says_and_then_as_before() -> None:
    def speeds(slip: float | None) -> set[float]:
        world = World([], 1)
        body = world.add_robot(0, (0.0, 0.0), 0.5, Chassis(slip=0.0))
        body.slip(slip)
        found = set()
        for t_us in range(0, 3_000_000, STEP_US):
            body.drive(Drive(1.0, 0.0), t_us)
            world.advance(t_us + STEP_US)
            if t_us > 2_000_000:
                found.add(round(body.speed_m_s, 6))
        return found

    assert speeds(None) == {1.0} and len(speeds(0.3)) > 10
