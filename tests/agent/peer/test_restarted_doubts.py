"""What a restart must not make good: a place that had jumped, and a range sensor that had died."""

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
from agent.peer.inputs import BusState, Heard, Sensed, Start, Timer
from agent.runtime.peer_factory import MissionParts, identity_of, make_peer
from agent.safety.stop_cause import StopCause
from protocol.controller_health import Health
from protocol.frames.safety_frames import Command, OperatorCommand
from tests.agent.lone_peer import Eager, introduce_tools

OPERATOR = 250

FENCES = np.array([
    [-99.0, -99.0, 99.0, -99.0], [99.0, -99.0, 99.0, 99.0],
    [99.0, 99.0, -99.0, 99.0], [-99.0, 99.0, -99.0, -99.0],
])  # fmt: skip
Sense = Callable[[int, float, Drive], Observation]
Blind = Callable[[int, float, Drive], None]  # time, way in metres, command in force


class Machine:
    """One robot with its disk. It drives as it is told, at once."""

    def __init__(self) -> None:
        self.disk: dict[str, bytes] = {}
        self.now_us, self.sent, self.way_m = 0, 0, 0.0
        self.boot(first=True)

    def boot(self, first: bool = False) -> None:
        identity = identity_of("total", 0, 3, 1, SilencePolicy.CONTINUE, first_boot=first)
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
            self.peer.step(BusState(Health.ACTIVE, True, self.sent), then_us)
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
