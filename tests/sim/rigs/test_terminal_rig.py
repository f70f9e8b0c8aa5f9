"""The fleet's screen on a terminal that we did not write from our client: shown, killed, obeyed."""

from collections.abc import Callable, Iterable, Sequence

import pytest

from agent.interface.config import MS, S
from agent.interface.mission import STILL, ClaimRequest, FleetView, Mission, MotionRequest
from agent.peer.inputs import ManualReset, Timer
from agent.peer.terminal_service import CONFIRM, NEW_STOP, NOT_CONFIRMED, NOTHING_HELD
from agent.runtime.peer_factory import MissionParts
from crdt import Progress
from protocol.authentication import Keyring
from protocol.frames.codec import decode
from protocol.frames.frame import Frame
from protocol.frames.operator_frames import OperatorReport, ReportKind
from protocol.frames.safety_frames import Command
from protocol.terminal_client import TerminalState
from protocol.terminal_pool import ALARM_CHARACTERS
from sim.rigs.terminal_rig import ScreenFleet, killed_screens
from tools.operate.operator_device import OPERATOR_SLOT, Operator

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


@pytest.mark.parametrize("members", [21, 108])
def test_a_fleet_of_more_robots_than_lines_shows_those_that_stand(members: int) -> None:
    """On commit d1aa422d a line that the pool does not have was changed, and a robot of a fleet of 65
    ended with an AssertionError when all were stopped."""
    fleet = ScreenFleet(2, 31, members=members)
    fleet.run(8 * S)
    assert len(rows(fleet)) == 20 and rows(fleet)[:2] == ["0 IDLE", "1 IDLE"]
    fleet.press_stop()
    fleet.run(4 * S)
    assert rows(fleet)[:2] == ["0 STOP_DOT", "1 STOP_DOT"] and not fleet.terminal.errors


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


ALARM_TEXT = 4003  # an object of the pool


def alarm(fleet: ScreenFleet) -> str:
    """What the terminal shows as an alarm; "" while it shows the data mask."""
    terminal = fleet.terminal
    if terminal.mask == DATA_MASK or terminal.active is None:
        return ""
    return terminal.texts[terminal.active][ALARM_TEXT].decode().rstrip()


def asked(fleet: ScreenFleet, since: int = 0) -> int:
    """How often a robot said that somebody asks for a release."""
    said = [decode(frame)[1] for frame in fleet.bus.carried[since:]]
    return sum(isinstance(m, OperatorReport) and m.matter == ReportKind.RELEASE_ASKED for m in said)


class KeyHolder:
    """The device of `headland release`, with a key or without one; it acts from `acts_at_us` on."""

    def __init__(self, keyring: Keyring | None, acts_at_us: int) -> None:
        self.waiting: list[Frame] = []
        self.acts_at_us = acts_at_us
        self.operator = Operator(self, keyring)  # type: ignore[arg-type]  # only sends
        self.acted_at_us = 0
        self.asked: list[int] = []

    def send(self, frame: Frame) -> bool:
        self.waiting.append(frame)
        return True

    def subscribe(self, listener: object) -> None:
        """The rig brings the frames."""

    def hears(self, frame: Frame, now_us: int) -> list[Frame]:
        self.operator.hear(now_us / S, frame)
        return self._sent()

    def turns(self, now_us: int) -> list[Frame]:
        if now_us >= self.acts_at_us and now_us - self.acted_at_us >= 100 * MS:
            self.acted_at_us = now_us
            operator = self.operator
            self.asked = self.asked or operator.release_asked
            operator.ask_who()
            operator.ask_stops()
            for digest in operator.shown.sums:
                operator.clear_held(digest)
            for robot in operator.live:
                operator.command(Command.MANUAL_RESET, robot.slot)
        return self._sent()

    def _sent(self) -> list[Frame]:
        frames, self.waiting = self.waiting, []
        return frames


def latched(fleet: ScreenFleet) -> Sequence[bool]:
    return [robot.stopped_at_us is not None for robot in fleet.robots]


def asked_for(robots: int, seed: int) -> ScreenFleet:
    """A fleet with keys: it was stopped at the terminal, and then a release was asked for there."""
    fleet = ScreenFleet(robots, seed, keyed=True)
    fleet.run(8 * S)
    assert fleet.press_stop() < 20.0
    fleet.run(2 * S)
    assert not fleet.release(), "the key of the terminal alone releases nobody"
    fleet.run(1 * S)
    assert alarm(fleet) == CONFIRM and all(latched(fleet)) and asked(fleet) >= 3
    return fleet


def test_in_a_fleet_with_keys_a_release_is_asked_for_and_a_key_holder_confirms_it() -> None:
    fleet = asked_for(3, 21)
    serving = fleet.serving
    assert serving is not None and fleet.keys is not None
    holder = KeyHolder(Keyring(fleet.keys, OPERATOR_SLOT, b"holder"), fleet.now_us + S)
    fleet.bus.attach(holder)
    fleet.run(8 * S)
    assert holder.asked == [serving.slot], "the tool knows where it was asked for"
    assert not any(latched(fleet))
    before = len(fleet.bus.carried)
    fleet.run(4 * S)
    assert asked(fleet, before) == 0, "nobody asks any more"
    assert rows(fleet) == [f"{slot} NOT_STARTED" for slot in range(3)]
    assert alarm(fleet) == "" and not fleet.terminal.errors


def test_a_release_that_is_asked_for_keeps_no_computer_busy_between_reset_and_rejoining() -> None:
    """The question was due again while the robot had no address to ask it from."""
    fleet = asked_for(2, 27)
    assert fleet.serving is not None
    peer, now_us, timers = fleet.serving.peer, fleet.now_us, 0
    for dot in list(peer.safety.stops.active):
        peer.safety.clear_near(dot, "operator", now_us)
    peer.step(ManualReset(), now_us)
    assert not peer.joining.joined
    while now_us < fleet.now_us + 200 * MS and timers < 1000:
        now_us, timers = max(now_us, peer.due_at_us), timers + 1
        peer.step(Timer(), now_us)
        assert peer.due_at_us > now_us
    assert not peer.joining.joined and timers < 20


def test_in_a_fleet_with_keys_nobody_without_one_confirms_a_release() -> None:
    """Neither a tool without a key, nor a forged word that a release was asked for."""
    fleet = asked_for(3, 22)
    fleet.bus.attach(KeyHolder(None, fleet.now_us))
    fleet.run(6 * S)
    assert all(latched(fleet)) and alarm(fleet) == CONFIRM


@pytest.mark.slow
def test_a_release_that_nobody_confirms_ends() -> None:
    fleet = asked_for(2, 23)
    fleet.run(121 * S)
    assert alarm(fleet) == NOT_CONFIRMED and all(latched(fleet))
    before = len(fleet.bus.carried)
    fleet.terminal.press(3002, 3)
    fleet.run(3 * S)
    assert asked(fleet, before) == 0 and alarm(fleet) == "", "acknowledged"


def test_a_new_stop_voids_a_release_that_was_asked_for() -> None:
    fleet = asked_for(2, 24)
    fleet.terminal.press(3000, 1)
    fleet.run(3 * S)
    assert alarm(fleet) == NEW_STOP and all(latched(fleet))


def test_many_presses_of_release_make_no_flood() -> None:
    """An imitated terminal may press as often as it likes."""
    fleet = asked_for(2, 26)
    before = len(fleet.bus.carried)
    for _ in range(100):
        fleet.terminal.press(3001, 2)
        fleet.run(10 * MS)
    assert asked(fleet, before) <= 3, "twice a second"


def test_a_release_of_a_fleet_with_keys_that_is_not_stopped_says_so() -> None:
    fleet = ScreenFleet(2, 25, keyed=True)
    fleet.run(8 * S)
    fleet.terminal.press(3001, 2)
    fleet.run(2 * S)
    assert alarm(fleet) == NOTHING_HELD and asked(fleet) == 0
    texts = (CONFIRM, NEW_STOP, NOT_CONFIRMED, NOTHING_HELD)
    assert max(map(len, texts)) <= ALARM_CHARACTERS


OUTLINE = ((0.0, 0.0), (96.0, 0.0), (96.0, 160.0), (0.0, 160.0))  # two metres a dot, nearly
PICTURE, RED, GREEN, WIDE = 4004, 12, 2, 48


class DrawnField(Mission):
    """A field that is worked line by line, without a robot that drives."""

    lines = 0

    @property
    def outline(self) -> Sequence[tuple[float, float]]:
        return OUTLINE

    def worked_lines(self, progress: Progress) -> Iterable[Sequence[tuple[float, float]]]:
        return [((4.0, 4.0 + 2 * k), (92.0, 4.0 + 2 * k)) for k in range(DrawnField.lines)]

    def choose(self, view: FleetView) -> ClaimRequest | None:
        return None

    def work(self, view: FleetView) -> MotionRequest:
        return STILL

    idle = work


@pytest.fixture
def drawn_fleet(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], ScreenFleet]:
    """A fleet whose screen is shown, and that looks at its picture each 3 s instead of each 30 s."""
    monkeypatch.setattr("agent.peer.terminal_service.PICTURE_US", 3 * S)

    def begun(seed: int) -> ScreenFleet:
        DrawnField.lines = 0
        fleet = ScreenFleet(3, seed, mission=lambda: MissionParts(DrawnField()))
        assert fleet.until_shown(0, 10 * S) < 10.0
        return fleet

    return begun


def dots(fleet: ScreenFleet, colour: int) -> list[tuple[int, int]]:
    """Where the terminal's picture has a colour: column, and row from the bottom."""
    terminal = fleet.terminal
    assert terminal.active is not None
    data = terminal.texts[terminal.active][PICTURE]
    each = [dot for byte in data for dot in (byte >> 4, byte & 15)]
    height = len(each) // WIDE
    return [(k % WIDE, height - 1 - k // WIDE) for k, dot in enumerate(each) if dot == colour]


def test_the_picture_of_the_field_follows_the_work_and_the_robots(
    drawn_fleet: Callable[[int], ScreenFleet],
) -> None:
    """It was drawn once, when the screen came up."""
    fleet = drawn_fleet(51)
    assert dots(fleet, GREEN) == []
    for slot, robot in enumerate(fleet.robots):
        robot.place_m = 48.0, 40.0 * (1 + slot)
    DrawnField.lines = 20
    fleet.run(5 * S)
    assert fleet.terminal.redrawn == 1 and not fleet.terminal.errors
    rows = sorted(row for _, row in dots(fleet, RED))
    assert len(rows) == 3 and all(abs(row - 20 * (1 + k)) <= 3 for k, row in enumerate(rows))
    worked = {row for _, row in dots(fleet, GREEN)}
    assert worked and max(worked) < 26, "the lower quarter"
    fleet.run(7 * S)
    assert fleet.terminal.redrawn == 1, "the same picture is not sent again"
    assert fleet.terminal.shown_at_us and len(fleet.terminal.pools) == 1


def test_a_robot_that_never_knew_its_place_does_not_shrink_the_field(
    drawn_fleet: Callable[[int], ScreenFleet],
) -> None:
    """It tells a place 3 km away, and the whole field was one dot of the picture."""
    fleet = drawn_fleet(54)
    black = dots(fleet, 0)
    assert (
        dots(fleet, RED) == [] and max(row for _, row in black) - min(row for _, row in black) > 70
    )


def test_a_robot_that_dies_while_it_draws_again_is_replaced_in_time(
    drawn_fleet: Callable[[int], ScreenFleet],
) -> None:
    fleet = drawn_fleet(52)
    DrawnField.lines = 40
    serving = fleet.serving
    assert serving is not None
    while serving.peer.named.terminal.client.state is TerminalState.SHOWN:
        fleet.run(2 * MS)
    serving.alive = False
    assert fleet.until_shown(fleet.now_us, 5 * S) <= 3.0
    assert len(dots(fleet, GREEN)) > 500 and fleet.terminal.twice == 0


def test_a_terminal_that_takes_no_picture_alone_has_its_screen_back_once(
    drawn_fleet: Callable[[int], ScreenFleet],
) -> None:
    fleet = drawn_fleet(53)
    fleet.terminal.refuses = True
    DrawnField.lines = 40
    assert fleet.until_shown(fleet.now_us, 8 * S) < 8.0, "after the picture was refused"
    DrawnField.lines, back_at_us = 60, fleet.now_us
    fleet.run(8 * S)
    active = fleet.terminal.active
    assert active is not None and fleet.terminal.shown_at_us[active] <= back_at_us


@pytest.mark.slow
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
