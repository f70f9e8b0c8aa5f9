"""The mission learns of every command that raises the implement, so no ground counts that is left."""

from collections.abc import Callable
from functools import partial

from agent.interface.config import ACTUATOR_TTL_US, CONTROL_PERIOD_US, MS, S
from agent.interface.effects import HALT, Drive, Effect
from agent.interface.lifecycle import State
from agent.interface.observation import Observation
from agent.peer.inputs import Heard
from agent.peer.peer import Peer
from protocol.frames.network_frames import AddressClaimed
from protocol.name import fleet_name
from tests.agent.lone_peer import Eager, held_by, peer_in, turn
from tests.agent.peer.test_sense_freshness import Robot

OTHER = 200  # an address


class Attentive(Eager):
    """Counts how often it is told that the implement is up."""

    raised = 0

    def on_implement_raised(self) -> None:
        self.raised += 1


def at_work() -> tuple[Peer, Attentive, int]:
    """A robot that works with its implement down, its mission, and the time."""
    mission = Attentive()
    peer = peer_in(State.IDLE, None, mission=mission)
    for now_us in range(0, 2 * S, 10 * MS):
        turn(peer, now_us)
    peer.claims.current, peer.lifecycle.machine.state = 0, State.WORKING
    now_us = 2 * S
    while not _commands_down(turn(peer, now_us)):
        now_us += 10 * MS
    for _ in range(2):
        now_us += CONTROL_PERIOD_US
        assert _commands_down(turn(peer, now_us))
    mission.raised = 0
    return peer, mission, now_us


def _commands_down(effects: list[Effect]) -> bool:
    return any(isinstance(effect, Drive) and effect.tool_on for effect in effects)


def test_an_implement_that_stays_down_is_not_said_to_be_up() -> None:
    peer, mission, now_us = at_work()
    assert _commands_down(turn(peer, now_us + CONTROL_PERIOD_US)) and not mission.raised


def test_l5_a_halt_between_two_control_periods_raises_the_implement() -> None:
    """Found by `headland chaos`, profile bus, seeds 1400659 and 1401837: another machine claimed our
    NAME and another one its address within one period. The bar was up for 40 ms, the unit counted,
    and a strip of 10 cm was left."""
    peer, mission, now_us = at_work()
    peer.step(Heard(OTHER, AddressClaimed(fleet_name("total", 1).pack())), now_us + 5 * MS)
    ours = AddressClaimed(peer.identity.name.pack())
    assert HALT in peer.step(Heard(OTHER, ours), now_us + 10 * MS)
    peer.step(Heard(OTHER, AddressClaimed(fleet_name("total", 2).pack())), now_us + 20 * MS)
    assert not held_by(peer), "it is over before the next period"
    assert _commands_down(turn(peer, now_us + CONTROL_PERIOD_US)) and mission.raised == 1


def test_an_implement_that_was_up_against_the_command_is_said_to_be_up() -> None:
    """A command came late at a ROS 2 robot, which raised its implement and drove on: 0.26 % of a field
    counted as worked, and was not."""
    mission, robot = Attentive(), Robot()
    robot.peer = peer_in(State.WORKING, None, mission=mission)
    robot.spoilt = lambda seen: seen._replace(implement_down=True)
    robot.periods(80)
    mission.raised = 0
    robot.periods(5)
    assert not mission.raised
    robot.spoilt = lambda seen: seen._replace(implement_down=False)
    robot.periods(3)
    assert mission.raised >= 1
    robot.spoilt = lambda seen: seen._replace(implement_down=True)
    robot.periods(3)
    before = mission.raised
    robot.periods(5)
    assert mission.raised == before


def lowered(down: Callable[[int], bool]) -> int:
    """How often the mission is told that the implement is up, in 300 ms after the command to lower it.

    `down`: whether it is sensed down, by the number of the control period after the command."""
    mission, robot = Attentive(), Robot()
    robot.peer = peer_in(State.WORKING, None, mission=mission)
    robot.spoilt = lambda seen: seen._replace(implement_down=False)
    while not robot.told.tool_on:
        robot.period()
    mission.raised = 0
    for period in range(1, 7):
        robot.spoilt = partial(Observation._replace, implement_down=down(period))
        robot.period()
        assert robot.told.tool_on
    return mission.raised


def test_an_implement_that_rises_again_soon_after_it_was_down_is_said_to_be_up() -> None:
    """A robot goes on after a stop, and a command comes late within 300 ms: that time is for an implement
    that goes down."""
    assert lowered(lambda period: True) == 0
    assert lowered(lambda period: period != 4) == 1


def test_the_command_to_lower_an_implement_may_be_on_its_way_for_as_long_as_it_lives() -> None:
    """A body that moves is past the place at which the command was sent. For a slow implement there is
    more time."""
    assert lowered(lambda period: period > 1) == 1
    assert lowered(lambda period: False) == ACTUATOR_TTL_US // CONTROL_PERIOD_US
