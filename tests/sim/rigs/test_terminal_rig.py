"""The fleet's screen on a terminal that we did not write from our client: shown, killed, obeyed."""

import pytest

from agent.interface.config import MS, S
from sim.rigs.terminal_rig import ScreenFleet, killed_screens

ALARM_MASK, DATA_MASK = 1001, 1000


def rows(fleet: ScreenFleet) -> list[str]:
    assert fleet.terminal.active is not None
    texts = fleet.terminal.texts[fleet.terminal.active]
    return [texts[number].decode().rstrip() for number in sorted(texts) if number >= 4100]


def test_one_robot_shows_the_fleet_and_its_pool_has_a_picture() -> None:
    fleet = ScreenFleet(3, 5)
    fleet.run(6 * S)
    terminal = fleet.terminal
    assert fleet.serving is not None and list(terminal.pools) == [terminal.active]
    assert len(terminal.pools[fleet.serving.peer.address or 0]) > 1785, "it went by ETP"
    assert rows(fleet) == ["0 IDLE", "1 IDLE", "2 IDLE"] and not terminal.errors


def test_stop_alarm_acknowledgement_and_release() -> None:
    fleet = ScreenFleet(3, 6)
    fleet.run(6 * S)
    assert fleet.press_stop() < 20.0
    fleet.run(3 * S)
    assert rows(fleet) == [f"{slot} STOP_DOT" for slot in range(3)]
    assert fleet.terminal.mask == ALARM_MASK
    fleet.terminal.press(3002, 3)
    fleet.run(1 * S)
    assert fleet.terminal.mask == DATA_MASK, "acknowledged"
    fleet.run(5 * S)
    assert fleet.terminal.mask == DATA_MASK, "and not shown again"
    assert fleet.release()
    fleet.run(4 * S)
    assert rows(fleet) == [f"{slot} NOT_STARTED" for slot in range(3)] and not fleet.terminal.errors


def test_a_terminal_that_loses_its_memory_gets_the_screen_again() -> None:
    fleet = ScreenFleet(3, 7)
    fleet.run(6 * S)
    for k in range(10):
        fleet.run(137 * k * MS)
        fleet.terminal.restart()
        assert fleet.until_shown(fleet.now_us, 5 * S) <= 3.0, k
        fleet.run(2 * S)
    assert not fleet.terminal.errors


def test_a_robot_that_was_frozen_does_not_show_a_second_screen() -> None:
    fleet = ScreenFleet(3, 8)
    fleet.run(6 * S)
    frozen = fleet.serving
    assert frozen is not None
    frozen.alive = False  # its process stands still, with all that it knows
    assert fleet.until_shown(fleet.now_us, 5 * S) <= 3.0
    frozen.alive = True
    fleet.run(5 * S)
    assert fleet.terminal.twice == 0 and fleet.serving is not frozen


def test_the_serving_robot_is_killed() -> None:
    found = killed_screens(4, robots=3, seed=9)
    assert found.back_for_s <= 3.0 and found.twice == 0 and not found.errors, found
    assert found.stop_for_ms < 20.0 and found.released == found.stops, found


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_the_serving_robot_is_killed_a_hundred_times(seed: int) -> None:
    found = killed_screens(100, seed=seed)
    assert found.back_for_s <= 3.0 and found.twice == 0 and not found.errors, found
    assert found.stop_for_ms < 20.0 and found.released == found.stops, found
