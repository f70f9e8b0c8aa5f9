"""What a restart must not make good: a place that had jumped, a range sensor that had died, a member
that is silent."""

from collections.abc import Callable
from random import Random

import numpy as np
import pytest

from agent.interface.config import S
from agent.interface.effects import HALT, Drive, Persist, Send
from agent.interface.identity import SilencePolicy
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.motion.holonomic_motion import HolonomicMotion
from agent.peer.inputs import BusState, Heard, Leave, Sensed, Start, Timer
from agent.peer.membership import SILENT_KEY
from agent.runtime.peer_factory import MissionParts, identity_of, make_peer
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import CREEP_M_S
from protocol.controller_health import Health
from protocol.frames.fleet_frames import Pose
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import AllImplementsStop, Command, OperatorCommand, Switch
from protocol.name import Name
from tests.agent.lone_peer import Eager, introduce, introduce_tools

OPERATOR = 250

FENCES = np.array([
    [-99.0, -99.0, 99.0, -99.0], [99.0, -99.0, 99.0, 99.0],
    [99.0, 99.0, -99.0, 99.0], [-99.0, 99.0, -99.0, -99.0],
])  # fmt: skip
Sense = Callable[[int, float, Drive], Observation]
Blind = Callable[[int, float, Drive], None]  # time, way in metres, command in force


class Machine:
    """One robot with its disk. It drives as it is told, at once."""

    def __init__(self, policy: SilencePolicy = SilencePolicy.CONTINUE) -> None:
        self.disk: dict[str, bytes] = {}
        self.policy, self.unplugged = policy, False
        self.now_us, self.sent, self.confirmed, self.way_m = 0, 0, 0, 0.0
        self.boot(first=True)

    def boot(self, first: bool = False) -> None:
        identity = identity_of("total", 0, 3, 1, self.policy, first_boot=first)
        motion = HolonomicMotion(0, BodyLimits(0.8, 2.5, 1.5), FENCES)
        self.peer = make_peer(
            identity, Random(self.now_us), self.now_us, dict(self.disk),
            MissionParts(Eager(), motion),
        )  # fmt: skip
        self.told: Drive = HALT

    def until(self, end_at_us: int, sense: Sense | Blind) -> float:
        """Run on; the metres that it drives."""
        begun_m = self.way_m
        while self.now_us < end_at_us:
            then_us = max(self.now_us + 1, self.peer.due_at_us)
            self.way_m += self.told.vx_m_s * (then_us - self.now_us) / S
            self.now_us = then_us
            if not self.unplugged:
                self.confirmed = self.sent
            self.peer.step(BusState(Health.ACTIVE, True, self.confirmed), then_us)
            if self.peer.wants_observation(then_us):
                self.perform(self.peer.step(Sensed(sense(then_us, self.way_m, self.told)), then_us))
            self.perform(self.peer.step(Timer(), then_us))
        return self.way_m - begun_m

    def perform(self, effects: object) -> None:
        for effect in effects:  # type: ignore[attr-defined]
            self.sent += isinstance(effect, Send)
            if isinstance(effect, Persist):
                self.disk[effect.key] = effect.value
            if isinstance(effect, Drive):
                self.told = effect

    @property
    def held(self) -> set[StopCause]:
        return {cause for cause, _ in self.peer.safety.causes}


def off_by(jump_m: float, rays: tuple[float, ...] = ()) -> Sense:
    """A receiver that is wrong by so much."""
    return lambda now_us, way_m, told: Observation(
        way_m - 90.0 + jump_m, 0.0, 0.0, told.vx_m_s, 0.0, rays, sensed_at_us=now_us
    )


def changing(now_us: int, way_m: float, told: Drive) -> Observation:
    """Rays that see a far wall."""
    rays = (60.0 - way_m / 2,) * 36
    return off_by(0.0, rays)(now_us, way_m, told)


def test_a_place_that_had_jumped_is_not_believed_after_a_restart() -> None:
    machine = Machine()
    assert machine.until(3 * S, off_by(0.0)) > 1.0
    machine.until(6 * S, off_by(30.0))
    assert StopCause.PLACE_LOST in machine.held
    machine.boot()
    assert machine.until(12 * S, off_by(30.0)) == 0.0
    assert StopCause.PLACE_LOST in machine.held


@pytest.mark.parametrize("restarts", [1, 2])
def test_a_person_at_the_robot_says_that_its_place_is_right(restarts: int) -> None:
    machine = Machine()
    machine.until(3 * S, off_by(0.0))
    machine.until(6 * S, off_by(30.0))
    for _ in range(restarts):
        machine.boot()
        machine.until(machine.now_us + 3 * S, off_by(0.0))
    machine.perform(machine.peer.step(Start(named=False), machine.now_us))
    assert machine.until(machine.now_us + 2 * S, off_by(0.0)) == 0.0, "a start of the whole fleet"
    machine.perform(machine.peer.step(Start(named=True), machine.now_us))
    assert machine.until(machine.now_us + 3 * S, off_by(0.0)) > 1.0
    machine.boot()
    assert machine.until(machine.now_us + 3 * S, off_by(0.0)) > 1.0, "and it is remembered"


def test_a_jump_that_is_over_is_no_doubt_after_a_restart() -> None:
    machine = Machine()
    machine.until(3 * S, off_by(0.0))
    machine.until(5 * S, off_by(30.0))
    assert machine.until(9 * S, off_by(0.0)) > 1.0, "it goes on by itself"
    machine.boot()
    assert machine.until(13 * S, off_by(0.0)) > 1.0


def hung_at(at_m: float, saws_m: float = 0.0) -> Sense:
    """A receiver that repeats one place with new times; `saws_m`: wheels are counted in between."""

    def sense(now_us: int, way_m: float, told: Drive) -> Observation:
        on_m = (way_m - at_m) % saws_m if saws_m else 0.0
        return Observation(
            at_m - 90.0 + on_m, 0.0, 0.0, told.vx_m_s, 0.0, (), sensed_at_us=now_us,
            position_accuracy_m=0.02,
        )  # fmt: skip

    return sense


@pytest.mark.parametrize("saws_m", [0.0, 0.25])
def test_a_place_that_is_frozen_moves_no_robot_after_each_restart(saws_m: float) -> None:
    """Each restart drove a metre on the same frozen place. A supervisor restarts for ever."""
    machine = Machine()
    machine.until(3 * S, off_by(0.0))
    hung = hung_at(machine.way_m, saws_m)
    machine.until(8 * S, hung)
    assert machine.held == {StopCause.PLACE_FROZEN}
    for _ in range(3):
        machine.boot()
        assert machine.until(machine.now_us + 5 * S, hung) == 0.0
        assert StopCause.PLACE_FROZEN in machine.held
    assert machine.until(machine.now_us + 5 * S, off_by(0.0)) > 1.0, "the true place is another one"
    machine.boot()
    assert machine.until(machine.now_us + 3 * S, off_by(0.0)) > 1.0, "and it is remembered"


def test_a_robot_whose_place_was_frozen_is_started_after_a_restart() -> None:
    machine = Machine()
    machine.until(3 * S, off_by(0.0))
    machine.until(8 * S, hung_at(machine.way_m))
    machine.boot()
    machine.perform(machine.peer.step(Start(named=False), machine.now_us))
    assert machine.until(machine.now_us + 3 * S, off_by(0.0)) > 1.0
    machine.boot()
    assert machine.until(machine.now_us + 3 * S, off_by(0.0)) > 1.0


@pytest.mark.parametrize("command", [Command.GO_HOME, Command.CONTINUE])
def test_a_robot_that_was_sent_home_does_not_go_to_work_after_a_restart(command: Command) -> None:
    """Somebody who works at a robot that was sent home may switch it off and on."""
    machine = Machine()
    introduce_tools(machine.peer, OPERATOR)
    machine.until(3 * S, off_by(0.0))
    for sent in (Command.GO_HOME, command):
        order = Heard(OPERATOR, OperatorCommand(sent, 0, OPERATOR, 0))
        machine.perform(machine.peer.step(order, machine.now_us))
        machine.until(machine.now_us + 1 * S, off_by(0.0))
    for _ in range(2):
        machine.boot()
        drove_m = machine.until(machine.now_us + 3 * S, off_by(0.0))
        assert (drove_m == 0.0) == (command is Command.GO_HOME)
    machine.perform(machine.peer.step(Start(named=False), machine.now_us))
    assert machine.until(machine.now_us + 3 * S, off_by(0.0)) > 1.0
    machine.boot()
    assert machine.until(machine.now_us + 3 * S, off_by(0.0)) > 1.0, "and it is remembered"


def test_a_scanner_that_died_is_missed_after_a_restart() -> None:
    machine = Machine()
    assert machine.until(3 * S, changing) > 1.0
    machine.until(6 * S, off_by(0.0))
    assert StopCause.SCAN_LOST in machine.held
    machine.boot()
    assert machine.until(12 * S, off_by(0.0)) == 0.0
    assert StopCause.SCAN_LOST in machine.held
    assert machine.until(16 * S, changing) > 1.0, "it works again"


def test_a_robot_that_never_had_a_scanner_drives_after_a_restart() -> None:
    machine = Machine()
    machine.until(3 * S, off_by(0.0))
    machine.boot()
    assert machine.until(6 * S, off_by(0.0)) > 1.0


def test_a_second_restart_before_the_first_place_does_not_forget_that_the_place_was_frozen() -> (
    None
):
    """The first of them wrote that nothing was wrong, since it had sensed nothing."""
    machine = Machine()
    machine.until(3 * S, off_by(0.0))
    hung = hung_at(machine.way_m)
    machine.until(8 * S, hung)
    assert StopCause.PLACE_FROZEN in machine.held
    for _ in range(2):
        machine.boot()
        machine.until(machine.now_us + 1 * S, lambda *_: None)
    machine.boot()
    assert machine.until(machine.now_us + 5 * S, hung) == 0.0
    assert StopCause.PLACE_FROZEN in machine.held


@pytest.mark.parametrize("phase_ms", range(0, 1000, 50))
def test_a_robot_that_boots_beside_a_pressed_stop_button_does_not_drive(phase_ms: int) -> None:
    """A button says its stop once a second. The robot drove 0.7 m before the first frame."""
    machine, button, at_us = Machine(), 38, 0
    name = Name(5, manufacturer=100, function=140, device_class=0).pack()

    def press(end_at_us: int) -> float:
        nonlocal at_us
        way_m = 0.0
        while machine.now_us < end_at_us:
            if at_us <= machine.now_us:
                heard = Heard(button, AllImplementsStop(1, Switch.STOP))
                machine.perform(machine.peer.step(heard, machine.now_us))
                at_us += 1 * S
            way_m += machine.until(min(end_at_us, at_us), off_by(0.0))
        return way_m

    machine.peer.step(Heard(button, AddressClaimed(name)), 0)
    press(3 * S + phase_ms * 1000)
    machine.boot()
    machine.peer.step(Heard(button, AddressClaimed(name)), machine.now_us)
    assert press(machine.now_us + 3 * S) == 0.0
    machine.until(at_us + 3 * S, off_by(0.0))
    assert machine.until(machine.now_us + 2 * S, off_by(0.0)) > 1.0, "the button is gone"


def test_a_robot_that_was_unplugged_listens_before_it_drives() -> None:
    """A button that was pressed meanwhile says so within a second."""
    machine = Machine()
    machine.until(3 * S, off_by(0.0))
    machine.unplugged = True
    machine.until(5 * S, off_by(0.0))
    assert StopCause.UNHEARD in machine.held
    machine.unplugged = False
    assert machine.until(6 * S, off_by(0.0)) == 0.0
    assert machine.until(8 * S, off_by(0.0)) > 1.0


def with_a_silent_member(policy: SilencePolicy) -> Machine:
    """A robot that drove beside robot 1, which has sent nothing for a second."""
    machine = Machine(policy)
    machine.until(2 * S, off_by(0.0))
    beside(machine)
    machine.until(machine.now_us + 1 * S, off_by(0.0))
    assert StopCause.MEMBER_SILENT in machine.held
    return machine


def beside(machine: Machine) -> None:
    """A second in which robot 1 is received."""
    machine.perform(introduce(machine.peer, 140, 1, machine.now_us))
    for _ in range(20):
        pose = Heard(140, Pose(50.0, 50.0, 0.0, 0.0, 1, False, 0))
        machine.perform(machine.peer.step(pose, machine.now_us))
        machine.until(machine.now_us + 50_000, off_by(0.0))


def test_a_member_that_is_silent_stays_silent_over_restarts() -> None:
    """Robots that stand until an operator names the silent one drove after a restart."""
    machine = with_a_silent_member(SilencePolicy.STOP)
    for _ in range(3):
        machine.boot()
        assert machine.until(machine.now_us + 10 * S, off_by(0.0)) == 0.0
        assert StopCause.MEMBER_SILENT in machine.held
    beside(machine)
    machine.until(machine.now_us + 100_000, off_by(0.0))
    assert machine.disk[SILENT_KEY] == b"", "it is back"


def test_a_farewell_before_a_restart_replaces_no_word_of_an_operator() -> None:
    machine = with_a_silent_member(SilencePolicy.STOP)
    machine.perform(machine.peer.step(Leave(), machine.now_us))
    machine.until(machine.now_us + 1 * S, off_by(0.0))
    assert machine.peer.membership.silent == frozenset()
    machine.boot()
    assert machine.until(machine.now_us + 5 * S, off_by(0.0)) == 0.0
    assert StopCause.MEMBER_SILENT in machine.held


def test_a_member_that_was_waived_stays_waived_over_a_restart() -> None:
    machine = with_a_silent_member(SilencePolicy.STOP)
    machine.peer.membership.waive(1, machine.now_us)
    machine.perform(machine.peer.membership.changed())
    machine.boot()
    assert machine.until(machine.now_us + 5 * S, off_by(0.0)) > 1.0


def test_a_robot_that_creeps_beside_a_silent_member_creeps_after_a_restart() -> None:
    machine = with_a_silent_member(SilencePolicy.SLOW)
    machine.boot()
    machine.until(machine.now_us + 5 * S, off_by(0.0))
    assert StopCause.CREEP in machine.held
    assert 0.0 < machine.until(machine.now_us + 5 * S, off_by(0.0)) <= 5.1 * CREEP_M_S


def test_a_robot_that_goes_on_without_silent_members_keeps_none() -> None:
    machine = with_a_silent_member(SilencePolicy.CONTINUE)
    assert SILENT_KEY not in machine.disk
