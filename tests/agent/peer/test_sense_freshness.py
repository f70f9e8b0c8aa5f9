"""Item 3: senses that are old, absent or frozen stop a robot, and it says so in its beats."""

from collections.abc import Callable, Iterable
from math import hypot, inf, isfinite, nan, pi, radians
from random import Random
from typing import NamedTuple

import numpy as np
import pytest

from agent.avoidance.orca_kernel import FENCE_S
from agent.interface.config import ACTUATOR_TTL_US, CONTROL_PERIOD_US, GONE_QUIET_US, MS, S
from agent.interface.effects import HALT, Drive, Effect, Send
from agent.interface.lifecycle import State
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.motion.holonomic_motion import FENCE_M, HolonomicMotion
from agent.peer.inputs import BusState, Heard, Hold, Sensed, Start, Timer
from agent.peer.place_jumps import AGE_MAX_US
from agent.peer.sense_freshness import (
    FROZEN_M,
    STEADY_US,
    Senses,
    frozen_for_s,
    frozen_way_m,
)
from agent.runtime.peer_factory import make_peer
from agent.safety.stop_cause import StopCause
from protocol.controller_health import Health
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import NOWHERE_M, PLACE_UNKNOWN_M_S, POSE, Pose
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.operator_frames import OperatorReport
from protocol.frames.safety_frames import Command, OperatorCommand
from protocol.name import tool_name
from tests.agent.lone_peer import held_by, introduce, introduce_tools, peer_in

SPEED_M_S, ACCELERATION_M_S2 = 2.5, 1.5
OPERATOR = 250
SENSES = {StopCause.SENSES_OLD, StopCause.PLACE_FROZEN, StopCause.PLACE_LOST}


class Robot:
    """A peer and a body with inertia, which drives east; what it senses can be spoilt."""

    def __init__(self, acceleration_m_s2: float = ACCELERATION_M_S2) -> None:
        """`acceleration_m_s2`: what its limits say; it gains `ACCELERATION_M_S2`."""
        self.peer = peer_in(State.WORKING, None, acceleration_m_s2=acceleration_m_s2)
        self.now_us, self.x_m, self.v_m_s, self.told = 0, 0.0, 0.0, HALT
        self.sensed: Observation | None = None
        self.blind = self.frozen = False
        self.spoilt: Callable[[Observation], Observation] = lambda sensed: sensed
        self.said: list[Pose] = []

    def period(self) -> None:
        step_m_s = ACCELERATION_M_S2 * CONTROL_PERIOD_US / S
        self.v_m_s += min(max(self.told.vx_m_s - self.v_m_s, -step_m_s), step_m_s)
        self.x_m += self.v_m_s * CONTROL_PERIOD_US / S
        self.now_us += CONTROL_PERIOD_US
        if self.frozen and self.sensed is not None:
            self.sensed = self.sensed._replace(sensed_at_us=self.now_us)
        elif not self.blind:
            self.sensed = Observation(
                self.x_m, 0.0, 0.0, self.v_m_s, 0.0, (inf,) * 72, sensed_at_us=self.now_us
            )
        self.peer.step(
            BusState(Health.ACTIVE, True, self.now_us), self.now_us
        )  # a frame leaves each time
        self.peer.step(Sensed(self.sensed and self.spoilt(self.sensed)), self.now_us)
        effects = self.peer.step(Timer(), self.now_us)
        self.told = next((e for e in effects if isinstance(e, Drive)), self.told)
        self.said += poses(effects)

    def periods(self, count: int) -> "Robot":
        for _ in range(count):
            self.period()
        return self

    @property
    def held(self) -> set[StopCause]:
        return held_by(self.peer) & SENSES


def poses(effects: Iterable[Effect]) -> list[Pose]:
    return [e.message for e in effects if isinstance(e, Send) and isinstance(e.message, Pose)]


def driving() -> Robot:
    robot = Robot().periods(80)
    assert robot.v_m_s == pytest.approx(2.0) and not robot.held
    return robot


def test_item_3_old_senses_stop_a_robot_two_periods_later() -> None:
    robot = driving()
    robot.blind, lost_us = True, robot.now_us
    while robot.told != HALT:
        robot.period()
    assert robot.now_us - lost_us <= AGE_MAX_US + CONTROL_PERIOD_US
    assert robot.held == {StopCause.SENSES_OLD} and AGE_MAX_US <= ACTUATOR_TTL_US
    before_m = robot.x_m
    robot.periods(100)
    assert robot.v_m_s == 0.0 and robot.x_m - before_m < 2.0
    assert robot.said[-1].speed_m_s == PLACE_UNKNOWN_M_S, "its beat does not pass for a place"


def test_item_3_it_drives_on_when_they_were_in_time_for_a_second() -> None:
    robot = driving()
    robot.blind = True
    robot.periods(40)
    robot.blind, back_us = False, robot.now_us
    while robot.told == HALT:
        robot.period()
    assert STEADY_US <= robot.now_us - back_us <= STEADY_US + 2 * CONTROL_PERIOD_US
    assert robot.periods(5).said[-1].placed and not robot.held


@pytest.mark.parametrize("wrong_us", [-1, 10 * S])
def test_item_3_a_time_of_the_future_or_of_never_is_no_time(wrong_us: int) -> None:
    robot = driving()
    robot.blind = True
    assert robot.sensed is not None
    robot.sensed = robot.sensed._replace(sensed_at_us=wrong_us)
    assert robot.periods(1).told == HALT and robot.held == {StopCause.SENSES_OLD}
    robot.sensed = Observation(0.0, 0.0, 0.0, 0.0, 0.0)
    assert robot.periods(1).told == HALT


def test_item_3_a_robot_that_has_never_sensed_anything_says_no_place() -> None:
    peer = peer_in(State.IDLE, None)
    peer.senses.here = None
    pose = peer.named.voice.pose(peer.context(0))
    assert pose.x_m == NOWHERE_M and not pose.placed
    assert POSE.unpack(POSE.pack(pose)) == pose


def test_item_3_a_frozen_place_stops_a_robot_that_drives() -> None:
    robot = driving()
    robot.frozen, from_m = True, robot.x_m
    while robot.told != HALT:
        robot.period()
    assert robot.held == {StopCause.PLACE_FROZEN}
    assert robot.x_m - from_m <= SPEED_M_S * 0.2
    robot.periods(100)
    assert robot.v_m_s == 0.0 and robot.x_m - from_m < 2.5
    assert not robot.said[-1].placed


def test_item_3_a_frozen_place_stops_a_robot_that_begins_to_drive() -> None:
    robot = Robot()
    robot.periods(1)
    robot.frozen = True
    robot.periods(100)
    assert robot.held == {StopCause.PLACE_FROZEN}
    assert FROZEN_M < robot.x_m < 0.6, "and it does not try again by itself"


def test_a_machine_that_does_not_carry_out_an_order_has_no_frozen_place() -> None:
    """A VDA 5050 vehicle ended one order and had no newer one yet. It was told to drive all the time, and
    stood at the same place to the millimetre. Its robot took that place for a frozen one, gave no more
    orders, and stood with its parcel until the trial ended."""
    robot = Robot().periods(1)
    robot.frozen, robot.spoilt = True, lambda sensed: sensed._replace(under_way=False)
    assert not robot.periods(100).held
    robot.spoilt, from_m = (lambda sensed: sensed), robot.x_m
    for _ in range(10):
        robot.period()
    assert robot.held == {StopCause.PLACE_FROZEN}, "it is noticed as soon as an order is under way"
    assert robot.x_m - from_m < 2.5


def test_a_brake_between_two_periods_is_no_frozen_place() -> None:
    robot = driving()
    effects = robot.peer.step(Hold(), robot.now_us)
    assert HALT in effects, "the command of this period is void at once"
    robot.told, robot.v_m_s = HALT, 0.0
    assert not robot.periods(5).held


def test_item_3_a_place_that_changes_ends_it_and_so_does_an_operators_start() -> None:
    robot = driving()
    robot.frozen = True
    robot.periods(60)
    robot.frozen = False
    assert robot.periods(2).held == set()
    robot.periods(60).frozen = True
    robot.periods(60)
    for _ in range(3):
        at_m = robot.x_m
        robot.peer.step(Start(), robot.now_us)
        robot.periods(60)
        assert robot.held == {StopCause.PLACE_FROZEN}, "it looks again, and stands again"
        assert FROZEN_M < robot.x_m - at_m < 0.6


@pytest.mark.parametrize("says", [True, False], ids=["with", "without"])
@pytest.mark.parametrize(("every", "share"), [(2, 1.0), (4, 1.0), (4, 0.3)])
def test_a_place_that_falls_back_again_and_again_stops_a_robot(
    every: int, share: float, says: bool
) -> None:
    """A driver counted wheels between fixes, and its receiver hung: the place sawed by 0.26 m. The robot
    drove 4.3 m and left the field. It says a velocity, or none."""
    robot = driving()
    at_m, off_m, period = robot.x_m, 0.0, 0

    def hung(seen: Observation) -> Observation:
        nonlocal off_m, period
        period += 1
        if period % every == 0:
            off_m += share * (at_m - (seen.x_m + off_m))
        vx_m_s = seen.vx_m_s if says else 0.0
        return seen._replace(x_m=seen.x_m + off_m, vx_m_s=vx_m_s, position_accuracy_m=0.02)

    robot.spoilt = hung
    while robot.told != HALT:
        robot.period()
    assert robot.held == {StopCause.PLACE_FROZEN} and robot.x_m - at_m < 1.7
    assert robot.periods(100).held == {StopCause.PLACE_FROZEN} and robot.v_m_s == 0.0
    robot.spoilt = lambda seen: seen
    while robot.told == HALT:
        robot.period()
    assert not robot.periods(5).held, "the true place is one that the wheels can have driven to"


def test_a_hung_place_is_right_again_before_that_is_noticed() -> None:
    robot = driving()
    at_m = robot.x_m
    robot.spoilt = lambda seen: seen._replace(x_m=at_m + (seen.x_m - at_m) % 0.25)
    while robot.x_m - at_m < 0.5:
        robot.period()
    robot.spoilt = lambda seen: seen
    assert not robot.periods(5).held


def test_a_place_that_fell_back_once_does_not_stop_a_robot() -> None:
    robot = driving()
    robot.spoilt = lambda seen: seen._replace(x_m=seen.x_m - 0.29)
    assert not robot.periods(40).held and robot.v_m_s == pytest.approx(2.0)


@pytest.mark.parametrize("slow_m_s2", [0.05, 0.3, 1.5])
def test_item_3_a_robot_that_begins_slowly_is_not_frozen(slow_m_s2: float) -> None:
    robot = Robot(slow_m_s2)
    step_m_s = slow_m_s2 * CONTROL_PERIOD_US / S
    for _ in range(200):
        robot.v_m_s = min(robot.v_m_s + step_m_s * 0.7, robot.told.vx_m_s)
        robot.told = robot.told._replace(vx_m_s=robot.v_m_s)
        robot.period()
        assert not robot.held


@pytest.mark.parametrize(("to_m_s", "fro_m_s", "held"), [(0.02, -0.02, False), (0.02, 0.02, True)])
def test_commands_to_and_fro_do_not_tell_that_the_place_is_frozen(
    to_m_s: float, fro_m_s: float, held: bool
) -> None:
    """A carrier that waited before a broken-down one was told to creep to and fro by a millimetre. After
    30 s the sum of these ways passed for travel that its place had not followed."""
    robot = Robot()
    for period in range(1_000):
        robot.told = HALT
        robot.period()
        creep_m_s = to_m_s if period % 2 else fro_m_s
        robot.peer.senses.drove(robot.told._replace(vx_m_s=creep_m_s, vy_m_s=0.0))
    assert (StopCause.PLACE_FROZEN in robot.held) is held


def test_item_3_a_beat_without_a_place_leaves_the_last_one_and_makes_it_uncertain() -> None:
    """The others keep its way clear as that of a silent one, and count it as alive."""
    peer = peer_in(State.WORKING, None)
    introduce(peer, 130, 1)
    peer.step(Heard(130, Pose(5.0, 0.0, 0.0, 2.0, State.WORKING, False, 255)), 50 * MS)
    now_us = 50 * MS
    while now_us < 5 * S:
        now_us += 50 * MS
        blind = Pose(5.1, 0.0, 0.0, PLACE_UNKNOWN_M_S, State.IDLE, False, 0)
        peer.step(Heard(130, POSE.unpack(POSE.pack(blind))), now_us)
        peer.membership.tick(now_us)
    assert 1 in peer.membership.live
    pose, heard_at_us = peer.membership.neighbours[1]
    assert (pose.x_m, pose.speed_m_s, pose.state) == (5.0, 2.0, State.IDLE)
    assert now_us - heard_at_us > GONE_QUIET_US
    here = Observation(0.0, 0.0, 0.0, 0.0, 0.0, sensed_at_us=now_us)
    assert isinstance(peer.motion, HolonomicMotion)
    peer.motion.coasting.observe(peer.membership.neighbours, here, now_us)
    places = peer.motion.coasting.places(1)
    assert places is not None and max(hypot(x_m - 5.0, y_m) for x_m, y_m in places) > 1.5


def test_a_pose_is_given_up_with_the_first_beat_without_a_place() -> None:
    """Found by `headland chaos`, profile body, seeds 940081, 940087, 940129, 940166: for a second the
    place of a braking robot was extrapolated as if it drove on, and a robot that passed touched it."""
    peer = peer_in(State.WORKING, None)
    introduce(peer, 130, 1)
    peer.step(Heard(130, Pose(5.0, 0.0, 0.0, 2.0, State.WORKING, False, 255)), 50 * MS)
    blind = Pose(5.1, 0.0, 0.0, PLACE_UNKNOWN_M_S, State.IDLE, False, 0)
    peer.step(Heard(130, POSE.unpack(POSE.pack(blind))), 200 * MS)
    here = Observation(0.0, 0.0, 0.0, 0.0, 0.0, sensed_at_us=200 * MS)
    assert isinstance(peer.motion, HolonomicMotion)
    peer.motion.coasting.observe(peer.membership.neighbours, here, 200 * MS)
    assert peer.motion.coasting.places(1) is not None
    peer.step(Heard(130, Pose(5.6, 0.0, 0.0, 0.0, State.IDLE, False, 0)), 300 * MS)
    peer.motion.coasting.observe(peer.membership.neighbours, here, 300 * MS)
    assert peer.motion.coasting.places(1) is None


def test_item_3_a_peer_without_a_drive_is_not_held_by_its_senses() -> None:
    peer = peer_in(State.WORKING, None)
    bare = make_peer(peer.identity, Random(1), 0)
    for now_us in range(0, 2 * S, 50 * MS):
        bare.step(Timer(), now_us)
    assert not held_by(bare) & SENSES


SPOILT: dict[str, Callable[[Observation], Observation]] = {
    "jumped": lambda o: o._replace(y_m=o.y_m + 2.0),
    "inaccurate": lambda o: o._replace(position_accuracy_m=0.5),
    "accuracy is not a number": lambda o: o._replace(position_accuracy_m=nan),
    "place is not a number": lambda o: o._replace(x_m=nan),
    "heading turned round": lambda o: o._replace(heading_rad=o.heading_rad + pi),
    "heading inaccurate": lambda o: o._replace(heading_accuracy_rad=radians(20.0)),
}


@pytest.mark.parametrize("fault", SPOILT)
def test_a_lost_place_stops_a_robot_at_once_and_it_drives_on_by_itself(fault: str) -> None:
    robot = driving()
    robot.spoilt = SPOILT[fault]
    robot.period()
    assert robot.told == HALT and robot.held == {StopCause.PLACE_LOST}
    robot.periods(100)
    assert robot.held == {StopCause.PLACE_LOST}, "a place that stays wrong is not believed"
    assert robot.said[-1].speed_m_s == PLACE_UNKNOWN_M_S
    robot.spoilt, back_us = lambda o: o, robot.now_us
    while robot.told == HALT:
        robot.period()
    assert STEADY_US <= robot.now_us - back_us <= STEADY_US + 2 * CONTROL_PERIOD_US
    assert not robot.held


def test_a_place_that_jumped_is_believed_after_a_start() -> None:
    robot = driving()
    robot.spoilt = SPOILT["jumped"]
    robot.periods(100)
    assert robot.held == {StopCause.PLACE_LOST}
    robot.peer.step(Start(), robot.now_us)
    assert not robot.held and not robot.periods(20).held


def test_a_robot_that_stands_after_a_jump_has_no_reach() -> None:
    """Found by chaos, `senses` 20500156: it stood for 1.5 s, and was believed to have gained speed all
    that time. A second jump was within what it could have driven, and it drove by it."""
    robot = driving()
    robot.spoilt = SPOILT["jumped"]
    robot.periods(60)
    robot.spoilt = lambda o: o
    robot.periods(10)
    robot.spoilt = lambda o: o._replace(y_m=o.y_m + 1.0)
    for _ in range(60):
        robot.period()
        assert robot.told == HALT and robot.held == {StopCause.PLACE_LOST}


def test_a_robot_is_no_faster_than_it_can_have_become() -> None:
    """Found by chaos, `senses` 20500481: its place jumped when it had just been told to drive at full
    speed. It was believed to be that fast, and so a second jump within the way to standstill."""
    robot = driving()
    robot.blind = True
    robot.periods(60)
    robot.blind = False
    while robot.told == HALT:
        robot.period()
    assert robot.v_m_s == 0.0 and robot.told.vx_m_s == pytest.approx(2.0)
    robot.spoilt = lambda o: o._replace(y_m=o.y_m + 10.0)
    robot.periods(60)
    robot.spoilt = lambda o: o._replace(x_m=o.x_m + 1.5)
    for _ in range(60):
        robot.period()
        assert robot.told == HALT and robot.held == {StopCause.PLACE_LOST}


def test_a_body_that_is_told_to_stand_gets_no_speed_from_a_place_that_drifts() -> None:
    """Found by chaos, `senses` 40500025: its place drifted for 4 s while it stood. Its speed at the end
    counted as a way that nobody had seen, so a jump of 1 m right after that was believed."""
    robot = driving()
    drifts_from_us = robot.now_us

    def drifting(o: Observation) -> Observation:
        off_m = (robot.now_us - drifts_from_us) / S
        return o._replace(y_m=o.y_m + off_m, position_accuracy_m=max(off_m, 0.01))

    robot.spoilt = drifting
    robot.periods(80)
    robot.spoilt = lambda o: o
    while robot.told == HALT:
        robot.period()
    robot.period()
    robot.spoilt = lambda o: o._replace(y_m=o.y_m + 1.0)
    robot.period()
    assert robot.told == HALT and robot.held == {StopCause.PLACE_LOST}


@pytest.mark.parametrize("begins_at_period", range(0, 80, 5))
def test_a_place_that_was_frozen_is_believed_where_the_body_can_have_stopped(
    begins_at_period: int,
) -> None:
    """Before it is noticed, the body drives on: further than the frozen place tells of."""
    robot = Robot().periods(begins_at_period)
    robot.frozen = True
    robot.periods(60)
    assert robot.held == {StopCause.PLACE_FROZEN}
    robot.frozen = False
    robot.periods(2)
    assert not robot.held


@pytest.mark.parametrize("named", [False, True])
@pytest.mark.parametrize("periods", [3, 6, 12, 60])
def test_a_start_while_the_place_is_frozen_forgets_no_way(periods: int, named: bool) -> None:
    """Found by chaos, `all` 20000681 and `stop` 20300781: an operator started the fleet while a place was
    frozen. What the robot had driven until then became a jump, and it stood for ever."""
    robot = driving()
    robot.frozen = True
    robot.periods(periods)
    assert robot.held == {StopCause.PLACE_FROZEN}
    robot.peer.step(Start(named), robot.now_us)
    assert not robot.held
    robot.periods(2).frozen = False
    robot.periods(2)
    assert not robot.held and robot.told != HALT


@pytest.mark.parametrize("named", [False, True])
@pytest.mark.parametrize("later_for_periods", [0, 1, 10, 30])
def test_a_start_just_after_a_place_froze_moves_no_robot(
    later_for_periods: int, named: bool
) -> None:
    """Found by chaos, `all` 112001178: the person who gave the start had not seen the robot stand. Its
    body still drove, and was looked at as one that begins to drive."""
    robot = driving()
    robot.frozen = True
    while not robot.held:
        robot.period()
    robot.periods(later_for_periods)
    robot.peer.step(Start(named), robot.now_us)
    for _ in range(60):
        robot.period()
        assert robot.held == {StopCause.PLACE_FROZEN} and robot.told == HALT
    robot.frozen = False
    assert not robot.periods(2).held, "it goes on by itself when the place follows"


def test_a_place_that_comes_back_after_a_gap_must_be_where_the_body_can_have_stopped() -> None:
    for moved_m, held in ((0.0, set[StopCause]()), (20.0, {StopCause.PLACE_LOST})):
        robot = driving()
        robot.blind = True
        robot.periods(100)
        robot.blind = False
        robot.x_m += moved_m  # towed, or a receiver that comes back with a wrong place
        robot.periods(40)
        assert robot.held == held


@pytest.mark.parametrize("by_us", [300 * MS, 1 * S, 60 * S])
@pytest.mark.parametrize("jumps", [False, True])
def test_i24_what_a_robot_drives_while_its_clock_goes_back_is_no_jump_of_its_place(
    by_us: int, jumps: bool
) -> None:
    """Found by `headland chaos`, profile all, seeds 4000001 and 5000025: it acts only when its clock
    shows again what it had shown, and its body has braked by then. A place far away is still a jump.
    """
    robot = driving()
    claim = AddressClaimed(tool_name(200).pack())
    robot.peer.step(Heard(200, claim), robot.now_us + 10 * MS - by_us)
    step_m_s, coasting_us = ACCELERATION_M_S2 * CONTROL_PERIOD_US / S, 0
    while robot.v_m_s > 0.0 and coasting_us < by_us:
        coasting_us += CONTROL_PERIOD_US
        if coasting_us > ACTUATOR_TTL_US:
            robot.v_m_s = max(robot.v_m_s - step_m_s, 0.0)
        robot.x_m += robot.v_m_s * CONTROL_PERIOD_US / S
    if jumps:
        robot.spoilt = SPOILT["jumped"]
    robot.period()
    assert robot.held == ({StopCause.PLACE_LOST} if jumps else set())
    robot.periods(2)
    assert robot.held == ({StopCause.PLACE_LOST} if jumps else set())


@pytest.mark.parametrize("wave_m", [0.0, 0.05, 0.14])
def test_noise_within_the_accuracy_is_no_jump(wave_m: float) -> None:
    robot, rng = driving(), np.random.default_rng(5)
    robot.spoilt = lambda o: o._replace(
        x_m=o.x_m + rng.uniform(-wave_m, wave_m), position_accuracy_m=wave_m
    )
    for _ in range(400):
        robot.period()
        assert not robot.held


@pytest.mark.parametrize(("accuracy_m", "held"), [(0.05, False), (0.08, True), (nan, True)])
def test_a_mission_may_need_a_better_place_than_the_clearances_do(
    accuracy_m: float, held: bool
) -> None:
    safety = peer_in(State.WORKING, None).safety
    senses = Senses(safety, None, drives=True, accuracy_max_m=0.075)
    seen = Observation(0.0, 0.0, 0.0, 0.0, 0.0, sensed_at_us=S, position_accuracy_m=accuracy_m)
    senses.listens_direct[Sensed](Sensed(seen), S)
    senses.look(S)
    assert safety.holds(StopCause.PLACE_LOST) == held


@pytest.mark.parametrize("drift_m_s", [0.0, 0.05, -0.1])
def test_a_frozen_place_that_drifts_slowly_is_frozen(drift_m_s: float) -> None:
    """Found by the profile senses, seed 20293: a hung filter whose place still crept."""
    robot = driving()
    hung_x_m, hung_at_us = robot.x_m, robot.now_us
    robot.spoilt = lambda o: o._replace(x_m=hung_x_m + drift_m_s * (robot.now_us - hung_at_us) / S)
    while robot.told != HALT:
        robot.period()
    assert robot.held == {StopCause.PLACE_FROZEN}
    assert robot.x_m - hung_x_m <= SPEED_M_S * 0.2


def test_a_jump_is_noticed_by_a_place_that_is_too_inaccurate_to_work_by() -> None:
    """Found by `headland chaos`, profile senses, seed 107000097: a place drifted, so that it was too
    inaccurate for the field, and jumped by a metre meanwhile. When its accuracy was back the jump passed
    for what the robot had driven, and the true place was a jump for ever (L5)."""
    robot = driving()
    robot.peer.senses.accuracy_max_m = 0.08
    robot.spoilt = lambda seen: seen._replace(position_accuracy_m=0.1)
    robot.periods(10)
    assert robot.held == {StopCause.PLACE_LOST}

    def jumped(seen: Observation) -> Observation:
        return seen._replace(x_m=seen.x_m + 0.85, y_m=0.5)

    robot.spoilt = lambda seen: jumped(seen)._replace(position_accuracy_m=0.1)
    robot.periods(20)
    robot.spoilt = jumped
    robot.periods(60)
    assert robot.held == {StopCause.PLACE_LOST} and robot.v_m_s == 0.0
    robot.spoilt = lambda seen: seen
    robot.periods(STEADY_US // CONTROL_PERIOD_US + 20)
    assert not robot.held and robot.v_m_s > 0.5


def test_a_jump_after_wheels_that_did_not_obey_is_a_jump() -> None:
    """Found by `headland chaos`, profile traffic, seed 106000207: a robot that stood was told to drive in
    vain for half a second, and its place then jumped by 3.0 m. It believed that, because what it had been
    told counted twice: since its place last changed, and since its place last fell back. It worked 7 m
    beside its row (L5)."""
    robot = Robot().periods(10)
    assert robot.told != HALT
    stands_m, fell_at_us = robot.x_m, robot.now_us + 2 * CONTROL_PERIOD_US

    def stands(seen: Observation) -> Observation:
        fell_m = 0.02 if robot.now_us > fell_at_us else 0.0
        return seen._replace(x_m=stands_m - fell_m, vx_m_s=0.0)

    robot.spoilt = stands
    while robot.told != HALT:
        robot.period()
    assert robot.held == {StopCause.PLACE_FROZEN}
    robot.periods(100)
    robot.spoilt = lambda seen: stands(seen)._replace(y_m=3.0)
    robot.periods(1)
    assert robot.held == {StopCause.PLACE_LOST}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("noise_m", [0.0, 0.004, 0.01, 0.02])
def test_a_body_that_is_stuck_is_noticed_beside_the_noise_of_its_receiver(
    noise_m: float, seed: int
) -> None:
    """The noise moves the place in every period, which is no movement of the body."""
    robot, rng = driving(), Random(seed)
    robot.spoilt = lambda o: o._replace(
        x_m=o.x_m + rng.gauss(0.0, noise_m),
        y_m=rng.gauss(0.0, noise_m),
        position_accuracy_m=max(noise_m, 0.004),
    )
    robot.periods(100)
    assert not robot.held, "noise alone holds no robot"
    stuck_x_m = robot.x_m
    for most_us in (2 * S, 4 * S):  # from full speed, and from standstill after an operator's start
        told_for_us = 0  # in two tries
        for _ in range(600):
            robot.period()
            robot.x_m, robot.v_m_s = stuck_x_m, 0.0
            told_for_us += CONTROL_PERIOD_US if robot.told != HALT else 0
        assert told_for_us <= most_us and robot.held == {StopCause.PLACE_FROZEN}
        robot.peer.step(Start(), robot.now_us)
    robot.periods(200)
    assert not robot.held and robot.x_m - stuck_x_m > 5.0, "it is free, and drives on"


@pytest.mark.parametrize("off_degrees", [180.0, 120.0, -90.0])
def test_a_body_with_exchanged_antennas_does_not_drive_away(off_degrees: float) -> None:
    """It says that it points east and drives where it really points. It drove until it left the field."""
    robot, off_rad, y_m = Robot(), radians(off_degrees), 0.0
    told_for_us, farthest_m = 0, 0.0

    def turned(seen: Observation) -> Observation:
        vx_m_s, vy_m_s = robot.v_m_s * np.cos(off_rad), robot.v_m_s * np.sin(off_rad)
        return seen._replace(y_m=y_m, vx_m_s=vx_m_s, vy_m_s=vy_m_s)

    robot.spoilt = turned
    for _ in range(600):
        before_m = robot.x_m
        robot.period()
        step_m = robot.x_m - before_m
        robot.x_m, y_m = before_m + step_m * np.cos(off_rad), y_m + step_m * np.sin(off_rad)
        farthest_m = max(farthest_m, hypot(robot.x_m, y_m))
        told_for_us += CONTROL_PERIOD_US if robot.told != HALT else 0
    assert robot.held == {StopCause.PLACE_FROZEN}
    assert told_for_us <= 4 * S and farthest_m < 6.0, "two tries, with the ways of braking"


@pytest.mark.parametrize("share", [-1.0, 0.0])
def test_a_robot_that_was_pushed_or_kept_back_once_goes_on_by_itself(share: float) -> None:
    robot = driving()
    began_x_m = robot.x_m
    for _ in range(30):
        before_m = robot.x_m
        robot.period()
        robot.x_m = before_m + share * abs(robot.x_m - before_m) + 0.006 * (robot.now_us // MS % 2)
    assert robot.x_m - began_x_m < 0.5
    robot.periods(200)
    assert not robot.held and robot.x_m - began_x_m > 5.0


@pytest.mark.parametrize("aside_m_s", [-1.0, 0.6, 1.0])
def test_a_robot_that_people_push_on_while_it_stands_goes_on_after_a_start(
    aside_m_s: float,
) -> None:
    """Found by `headland chaos`, profile corners, seed 96000065: a robot was pushed back until it noticed
    that its place led nowhere, and then aside. That passed for a jump, and it stood for good."""
    robot = driving()
    y_m = 0.0
    robot.spoilt = lambda seen: seen._replace(y_m=y_m)
    while not robot.held:
        before_m = robot.x_m
        robot.period()
        robot.x_m = before_m - 0.05 * (robot.now_us % (500 * MS) < 250 * MS)
    for _ in range(60):
        robot.period()
        y_m += aside_m_s * CONTROL_PERIOD_US / S
    robot.periods(100).peer.step(Start(named=False), robot.now_us)
    began_x_m = robot.x_m
    assert not robot.periods(100).held and robot.x_m - began_x_m > 3.0


LATE_FOR_S, STEP_US = 0.02, 5 * MS  # of a receiver; of the integrator below


class FrozenDrive(NamedTuple):
    """What an integrator says of a body whose place froze."""

    way_m: float  # from then until it stands
    told_for_s: float  # from then until it was last told to move
    fastest_m_s: float
    slowest_m_s: float  # until it was last told to move


def frozen_drive(
    from_m_s: float, told_m_s: float, turn_rad_s: float, phase_us: int, limit_m_s2: float
) -> FrozenDrive:
    """A body is told one speed and turn while its place is frozen; its senses alone decide.

    Fixes come each period, `phase_us` after the control, and `LATE_FOR_S` late. The wheels do what the
    limits of the body allow."""
    safety = peer_in(State.WORKING, None).safety
    motion = HolonomicMotion(0, BodyLimits(0.8, SPEED_M_S, limit_m_s2), np.empty((0, 4)))
    senses = Senses(safety, motion, drives=True)
    freezes_at_us = 2 * S + phase_us + 1 * MS  # a moment after a fix: the next one comes latest
    x_m, heading_rad, v_m_s, told = 0.0, 0.0, from_m_s, told_m_s
    way_m = told_until_us = 0.0
    fastest_m_s, slowest_m_s = 0.0, inf
    fixes: list[Observation] = []
    hung: Observation | None = None
    for now_us in range(0, 20 * S, STEP_US):
        frozen = now_us >= freezes_at_us
        goal_m_s = told if frozen else from_m_s  # it drives steadily before
        most_m_s = limit_m_s2 * STEP_US / S
        v_m_s += min(max(goal_m_s - v_m_s, -most_m_s), most_m_s)
        x_m += v_m_s * STEP_US / S
        heading_rad += (turn_rad_s if told else 0.0) * STEP_US / S
        if frozen:
            way_m += v_m_s * STEP_US / S
            fastest_m_s = max(fastest_m_s, v_m_s)
        fix = Observation(x_m, 0.0, heading_rad, v_m_s, 0.0, sensed_at_us=now_us)
        if frozen:
            hung = hung or fix
            fix = hung._replace(sensed_at_us=now_us)
        if now_us % CONTROL_PERIOD_US == phase_us:
            fixes.append(fix)
        if now_us % CONTROL_PERIOD_US == 0:
            arrived = [f for f in fixes if f.sensed_at_us + LATE_FOR_S * S <= now_us]
            if not arrived:
                continue
            senses.listens_direct[Sensed](Sensed(arrived[-1]), now_us)
            senses.look(now_us)
            if safety.holds(StopCause.PLACE_FROZEN):
                told = 0.0
            elif frozen:
                told_until_us, slowest_m_s = now_us - freezes_at_us, min(slowest_m_s, v_m_s)
            drive_m_s = told if frozen else from_m_s
            senses.drove(HALT._replace(vx_m_s=drive_m_s, turn_rad_s=turn_rad_s if told else 0.0))
        if frozen and told == v_m_s == 0.0:
            break
    period_s = CONTROL_PERIOD_US / S  # a command is in force until the next one
    return FrozenDrive(
        way_m, told_until_us / S + period_s, fastest_m_s, min(slowest_m_s, v_m_s or inf)
    )


@pytest.mark.parametrize("phase_us", [0, 15 * MS, 35 * MS])
@pytest.mark.parametrize("told_m_s", [0.05, 0.13, 0.3, 0.4, 0.7, 1.5, 2.5])
@pytest.mark.parametrize("from_m_s", [0.0, 0.13, 0.5, 1.5, 2.5])
@pytest.mark.parametrize("limit_m_s2", [0.5, 1.5])
def test_the_way_without_a_place_that_froze_is_limited_at_every_speed(
    from_m_s: float, told_m_s: float, phase_us: int, limit_m_s2: float
) -> None:
    """Found by `headland bench robot`: a machine that braked for a turn was told to move for 0.788 s. It
    was slow. The way counts, and what the time is at its speed follows."""
    found = frozen_drive(from_m_s, told_m_s, 0.0, phase_us, limit_m_s2)
    limits = BodyLimits(0.8, SPEED_M_S, limit_m_s2)
    assert 0.0 < found.way_m <= frozen_way_m(found.fastest_m_s, limits, LATE_FOR_S)
    if from_m_s >= told_m_s:  # at the speed that it is told, or faster
        assert found.told_for_s <= frozen_for_s(told_m_s, LATE_FOR_S)


@pytest.mark.parametrize("limit_m_s2", [0.3, 0.5, 1.5, 3.0])
def test_the_way_without_a_place_that_froze_ends_before_the_fence(limit_m_s2: float) -> None:
    """The plan is towards a fence no faster than half of the acceleration can brake, nor than the
    distance to it over `FENCE_S`, from `FENCE_M` before it."""
    for speed_m_s in np.linspace(0.0, SPEED_M_S, 101):
        room_m = FENCE_M + max(speed_m_s**2 / limit_m_s2, FENCE_S * speed_m_s)
        limits = BodyLimits(0.8, SPEED_M_S, limit_m_s2)
        assert frozen_way_m(speed_m_s, limits, LATE_FOR_S) <= room_m + 1e-9


@pytest.mark.parametrize("turn_rad_s", [0.3, -1.0, 3.0])
def test_a_frozen_place_stops_a_robot_that_turns_on_the_spot(turn_rad_s: float) -> None:
    """It has no way to miss: before, it turned for ever."""
    found = frozen_drive(0.0, 0.0, turn_rad_s, 0, 1.5)
    assert found.told_for_s <= 2 * radians(20.0) / abs(turn_rad_s) + 0.4


def test_small_turns_to_and_fro_and_a_heading_that_follows_are_not_frozen() -> None:
    safety = peer_in(State.WORKING, None).safety
    senses = Senses(safety, None, drives=True)
    heading_rad = 0.0
    for period in range(1, 1_000):
        now_us = period * CONTROL_PERIOD_US
        turn_rad_s = 1.0 if period < 500 or period % 2 else -1.0
        heading_rad += 0.2 * turn_rad_s * CONTROL_PERIOD_US / S if period < 500 else 0.0
        seen = Observation(0.0, 0.0, heading_rad, 0.0, 0.0, sensed_at_us=now_us)
        senses.listens_direct[Sensed](Sensed(seen), now_us)
        senses.look(now_us)
        senses.drove(HALT._replace(turn_rad_s=turn_rad_s))
        assert not safety.holds(StopCause.PLACE_FROZEN)


def test_a_place_that_froze_while_it_turned_is_believed_when_the_heading_changes() -> None:
    safety = peer_in(State.WORKING, None).safety
    senses = Senses(safety, None, drives=True)
    held = []
    for period in range(1, 60):
        now_us = period * CONTROL_PERIOD_US
        heading_rad = 1.0 if period >= 50 else 0.0  # the true one; it stands by then
        seen = Observation(0.0, 0.0, heading_rad, 0.0, 0.0, sensed_at_us=now_us)
        senses.listens_direct[Sensed](Sensed(seen), now_us)
        senses.look(now_us)
        held.append(safety.holds(StopCause.PLACE_FROZEN))
        senses.drove(HALT if held[-1] else HALT._replace(turn_rad_s=1.0))
    assert held[40] and not held[-1] and not safety.holds(StopCause.PLACE_LOST)


@pytest.mark.parametrize(
    "velocity",
    [(nan, 0.0), (0.0, nan), (inf, 0.0), (-inf, inf), (1e300, 1e300), (PLACE_UNKNOWN_M_S, 0.0)],
)
def test_a_velocity_that_is_none_stops_a_robot_and_does_not_end_it(
    velocity: tuple[float, float],
) -> None:
    """One sentence of a receiver with "nan" for a speed ended the program; with "inf" it drove on."""
    robot = driving()
    robot.spoilt = lambda seen: seen._replace(vx_m_s=velocity[0], vy_m_s=velocity[1])
    assert robot.periods(1).told == HALT and robot.held == {StopCause.PLACE_LOST}
    assert not robot.periods(40).said[-1].placed
    robot.spoilt = lambda seen: seen
    robot.periods(STEADY_US // CONTROL_PERIOD_US + 40)
    assert not robot.held and robot.v_m_s > 1.0


@pytest.mark.parametrize("distance_m", [nan, -inf, -0.1])
def test_a_scan_with_a_distance_that_is_none_is_no_scan(distance_m: float) -> None:
    robot = driving()
    robot.spoilt = lambda seen: seen._replace(ranges_m=(distance_m, 1.0, *seen.ranges_m[2:]))
    robot.periods(10)
    assert robot.peer.here is not None and robot.peer.here.ranges_m == ()


@pytest.mark.parametrize(
    ("said", "taken"), [(nan, 0.0), (-inf, 0.0), (inf, 1.0), (1.5, 1.0), (0.5, 0.5)]
)
def test_a_charge_or_a_health_that_is_none_is_an_empty_or_a_failed_one(
    said: float, taken: float
) -> None:
    robot = driving()
    robot.spoilt = lambda seen: seen._replace(battery=said, health=said)
    here = robot.periods(5).peer.here
    assert here is not None and (here.battery, here.health) == (taken, taken)


def test_an_accuracy_below_nothing_is_none() -> None:
    robot = driving()
    robot.spoilt = lambda seen: seen._replace(position_accuracy_m=-5.0)
    assert robot.periods(1).told == HALT and robot.held == {StopCause.PLACE_LOST}


def test_the_gate_passes_no_command_that_is_no_number() -> None:
    safety = driving().peer.safety
    for wrong in (nan, inf, -inf):
        for wanted in (Drive(wrong, 0.0), Drive(0.0, wrong), Drive(1.0, 0.0, wrong)):
            assert safety.gate(wanted, 0) == HALT
    assert safety.gate(Drive(1.0, 0.0, 0.5), 0) == Drive(1.0, 0.0, 0.5)


@pytest.mark.parametrize("wrong", [nan, inf, 1e300])
def test_no_part_meets_a_place_that_frames_cannot_carry(wrong: float) -> None:
    robot = driving()
    last = robot.peer.here
    assert last is not None
    robot.spoilt = lambda o: o._replace(x_m=wrong)
    robot.periods(3)
    assert robot.held == {StopCause.PLACE_LOST}
    here = robot.peer.here
    assert here is not None and isfinite(here.x_m) and abs(here.x_m - last.x_m) < 1.0
    order = OperatorCommand(Command.STOP, 0, OPERATOR, 0)
    introduce_tools(robot.peer, OPERATOR)
    for _ in range(2):
        said = robot.peer.step(Heard(OPERATOR, order), robot.now_us)
    assert any(isinstance(e, Send) and isinstance(e.message, OperatorReport) for e in said)
    encoded = [encode(e.message, 128) for e in said if isinstance(e, Send)]
    assert encoded


def test_a_first_place_that_frames_cannot_carry_is_no_place() -> None:
    safety = peer_in(State.WORKING, None).safety
    senses = Senses(safety, None, drives=True)
    for now_us in range(CONTROL_PERIOD_US, 4 * CONTROL_PERIOD_US, CONTROL_PERIOD_US):
        nowhere = Observation(nan, 0.0, 0.0, 0.0, 0.0, sensed_at_us=now_us)
        senses.listens_direct[Sensed](Sensed(nowhere), now_us)
        senses.look(now_us)
    assert safety.holds(StopCause.PLACE_LOST) and senses.here is None and not senses.current


def test_a_robot_goes_home_to_the_first_place_that_it_believed() -> None:
    robot = Robot()
    robot.spoilt = lambda o: o._replace(x_m=o.x_m + 0.25, position_accuracy_m=9.0)
    robot.periods(3)
    assert robot.peer.named.directive.home is None
    robot.spoilt = lambda o: o
    robot.periods(40)
    home = robot.peer.named.directive.home
    assert home is not None and home[0] < 0.25
