"""Where silent members stand: all robots come to know the same, also those that were away."""

from math import inf, pi
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.interface.config import MS, S
from agent.interface.mission import FleetView
from agent.interface.observation import Neighbour, Observation
from agent.motion.stopping_zone import seen_through
from agent.navigation.silent_robots import DEAD_US, SURE_M, SilentRobots
from crdt import FieldAllocationCRDT, Progress
from protocol.frames.agreement_frames import FALLEN, SilentPosition
from protocol.frames.fleet_frames import NOWHERE_M, Pose

BEAT_US = 50 * MS
HERE = Observation(0.0, 0.0, 0.0, 0.0, 0.0)


def view(
    slot: int, now_us: int, live: set[int], silent: dict[int, int], poses: dict[int, Neighbour],
    here: Observation = HERE,
) -> FleetView:  # fmt: skip
    return FleetView(
        slot, now_us, here, FieldAllocationCRDT(0), Progress({}), frozenset(live), silent, poses
    )


def beat(x_m: float, y_m: float, heard_at_us: int) -> Neighbour:
    return Neighbour(Pose(x_m, y_m, 0.0, 0.0, 1, False, 255), heard_at_us)


DAY_US = 24 * 3600 * S


@pytest.mark.parametrize("days", [1, 7, 12, 13, 100])
def test_after_days_the_latest_place_of_a_silent_member_counts(days: int) -> None:
    """Found: the clock of stamps stopped after twelve days. The easternmost place won from then on."""
    bodies, booted, begin_us = SilentRobots(0, 0), SilentRobots(1, days * DAY_US), days * DAY_US
    ends_at_us = begin_us + 20 * S
    for now_us, x_m in ((begin_us, 8.0), (begin_us + 3600 * S, 2.0), (begin_us + 7200 * S, 5.0)):
        ends_at_us = now_us + 20 * S
        known = {2: beat(x_m, 4.0, now_us)}
        bodies.observe(view(0, now_us, {0, 1, 2}, {}, known))
        bodies.observe(view(0, ends_at_us, {0, 1}, {2: now_us}, known))
        assert abs(bodies.dead[2][0] - x_m) < 1e-6
    for word in bodies.outgoing(True, ends_at_us + S):
        booted.on_message(FALLEN.unpack(FALLEN.pack(word)), ends_at_us + S)
    booted.observe(view(1, ends_at_us + S, {0, 1}, {}, {}))
    assert booted.dead == bodies.dead


def test_a_member_that_lies_for_weeks_is_known_until_it_is_seen_to_have_gone() -> None:
    bodies = [SilentRobots(0, 0), SilentRobots(1, 7 * S)]
    lies, silent = {2: beat(1.0, 0.3, 10 * S)}, {2: 10 * S}
    now_us = 0
    for hour in range(1, 24 * 40):
        now_us = hour * 3600 * S
        for own in bodies:
            own.observe(view(own.slot, now_us, {0, 1}, silent, lies))
            for word in own.outgoing(False, now_us):
                bodies[1 - own.slot].on_message(FALLEN.unpack(FALLEN.pack(word)), now_us)
        assert bodies[0].dead == bodies[1].dead and 2 in bodies[0].dead
    free = HERE._replace(ranges_m=(inf,) * 36)
    bodies[0].observe(view(0, now_us + S, {0, 1}, silent, lies, free))
    (word,) = bodies[0].outgoing(True, now_us + S)
    bodies[1].on_message(FALLEN.unpack(FALLEN.pack(word)), now_us + S)
    bodies[1].observe(view(1, now_us + S, {0, 1}, silent, lies))
    assert bodies[0].dead == bodies[1].dead == {}


def test_a_place_of_days_ago_is_forgotten_if_its_member_is_received() -> None:
    bodies = SilentRobots(0, 0)
    bodies.observe(view(0, 20 * S, {0}, {2: 10 * S}, {2: beat(3.0, 4.0, 10 * S)}))
    bodies.observe(view(0, DAY_US, {0, 2}, {}, {}))
    assert 2 in bodies.known, "it is told to robots that were away"
    bodies.observe(view(0, 4 * DAY_US, {0, 2}, {}, {}))
    assert not bodies.known and not list(bodies.outgoing(True, 4 * DAY_US))


def test_who_has_restarted_is_told_where_a_silent_member_stands() -> None:
    knows, restarted = SilentRobots(0, 0), SilentRobots(1, 20 * S)
    now_us = 10 * S + DEAD_US + 1
    knows.observe(view(0, now_us, {0, 1}, {2: 10 * S}, {2: beat(3.2, 4.1, 10 * S)}))
    assert knows.dead == {2: (3.2, 4.1)} or abs(knows.dead[2][0] - 3.2) < 1e-6
    for word in knows.outgoing(False, now_us + 10 * S):
        restarted.on_message(word, now_us + 10 * S)
    restarted.observe(view(1, now_us + 10 * S, {0, 1}, {}, {}))
    assert restarted.dead == knows.dead  # the same numbers: joint plans are made round them


def test_a_member_that_is_heard_again_is_no_body() -> None:
    bodies = SilentRobots(0, 0)
    bodies.observe(view(0, 20 * S, {0}, {2: 10 * S}, {2: beat(3.0, 4.0, 10 * S)}))
    assert 2 in bodies.dead
    bodies.observe(view(0, 21 * S, {0, 2}, {}, {2: beat(3.0, 4.0, 21 * S)}))
    assert bodies.dead == {}


@given(st.integers(0, 1 << 30))
def test_all_come_to_know_the_latest_word_whatever_is_lost(seed: int) -> None:
    rng = Random(seed)
    fleet = [SilentRobots(slot, rng.randrange(S)) for slot in range(4)]
    for own in fleet:  # each has heard another last beat, before or behind a split
        heard_at_us = rng.randrange(1 * S, 30 * S)
        poses = {9: beat(rng.uniform(0, 50), rng.uniform(0, 50), heard_at_us)}
        own.observe(view(own.slot, 40 * S, {0, 1, 2, 3}, {9: heard_at_us}, poses))
    now_us = 40 * S
    for _ in range(1200):
        now_us += BEAT_US
        for own in fleet:
            for word in own.outgoing(True, now_us):
                heard = FALLEN.unpack(FALLEN.pack(word))
                for other in fleet:
                    if other is not own and rng.random() < 0.7:
                        other.on_message(heard, now_us)
    assert len({own.known[9] for own in fleet}) == 1
    latest = max(own.known[9].stamp for own in fleet)
    assert all(own.known[9].stamp == latest for own in fleet)


def test_a_place_that_is_seen_to_be_free_is_told_to_be() -> None:
    """A robot that drove on in a split stands elsewhere: its last place heard blocks nobody."""
    bodies = SilentRobots(0, 0)
    open_floor = HERE._replace(ranges_m=(inf,) * 36)
    known = {2: beat(1.0, 0.3, 10 * S)}
    bodies.observe(view(0, 20 * S, {0}, {2: 10 * S}, known, open_floor))
    assert bodies.dead == {}
    (word,) = bodies.outgoing(False, 20 * S)
    assert word.slot == 2 and word.x_m == NOWHERE_M
    bodies.observe(view(0, 21 * S, {0}, {2: 10 * S}, known, HERE))
    assert bodies.dead == {}  # and it stays so until it is heard again


def test_a_body_that_is_there_is_not_seen_through() -> None:
    here = HERE._replace(ranges_m=(inf,) * 36)
    assert seen_through(here, (1.5, 0.2), SURE_M)
    for k in range(36):  # one ray that ends before it is enough
        ranges = [inf] * 36
        ranges[k] = 1.2
        angle = k * 2 * pi / 36
        beside = angle < 0.3 or angle > 2 * pi - 0.15
        if beside:
            assert not seen_through(HERE._replace(ranges_m=tuple(ranges)), (1.5, 0.2), SURE_M)
    assert not seen_through(here, (2.5, 0.0), SURE_M)  # too far off to be sure


def test_a_place_beside_the_map_is_refused() -> None:
    """The last beat in the name of a silent member may be anybody's, and so may a frame about it."""
    bodies = SilentRobots(0, 0, lambda at: 0 <= at[0] < 10)
    bodies.observe(view(0, 20 * S, {0}, {2: 10 * S}, {2: beat(100.0, 4.0, 10 * S)}))
    bodies.on_message(SilentPosition(-5.0, 4.0, 3, 7), 20 * S)
    assert bodies.refused == 2
    assert not bodies.known and not list(bodies.outgoing(True, 60 * S)), "it is not told on"
    bodies.on_message(SilentPosition(5.0, 4.0, 3, 7), 20 * S)
    bodies.observe(view(0, 21 * S, {0}, {}, {}))
    assert bodies.dead == {3: (5.0, 4.0)}
    bodies.on_message(SilentPosition(100.0, 4.0, 3, 9), 21 * S)
    bodies.observe(view(0, 22 * S, {0}, {}, {}))
    assert bodies.dead == {3: (5.0, 4.0)}, "a later lie does not hide it"
    bodies.on_message(SilentPosition(NOWHERE_M, NOWHERE_M, 3, 9), 22 * S)
    bodies.observe(view(0, 23 * S, {0}, {}, {}))
    assert not bodies.dead, "that it has gone is no place beside the map"


def test_from_a_place_that_is_not_believed_no_body_is_seen_through() -> None:
    bodies = SilentRobots(0, 0)
    seen = view(
        0,
        20 * S,
        {0},
        {2: 10 * S},
        {2: beat(1.0, 0.3, 10 * S)},
        HERE._replace(ranges_m=(inf,) * 36),
    )
    bodies.observe(seen._replace(placed=False))
    assert 2 in bodies.dead
    bodies.observe(seen)
    assert bodies.dead == {}
