"""The standard stop of ISO 11783-7: several shortcut buttons on one bus, and what a robot says itself."""

from collections.abc import Iterable
from itertools import pairwise

import pytest

from agent.interface.config import MS, S
from agent.interface.effects import Effect, Send
from agent.interface.lifecycle import State
from agent.peer.inputs import Heard, ManualReset, Press, Timer
from agent.peer.peer import Peer
from agent.safety.standard_stop import (
    BUTTONS_MAX,
    HOLD_US,
    PERMITS,
    SAY_US,
    OwnButton,
    ShortcutButtons,
)
from agent.safety.stop_cause import StopCause
from crdt.stops import StopDot
from protocol.frames.fleet_frames import Member
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import AllImplementsStop, EmergencyStop, Reason, Switch
from protocol.name import Name, fleet_name
from tests.agent.lone_peer import held_by, introduce_tools, peer_in

FIRST, SECOND = 38, 41  # addresses of two buttons
OTHER_MAKER = Name(7, manufacturer=100, function=61)


def bus(named: bool) -> Peer:
    """A robot beside two buttons, which have claimed their addresses or not."""
    peer = peer_in(State.WORKING, None)
    for number, address in enumerate((FIRST, SECOND) if named else ()):
        peer.step(Heard(address, AddressClaimed(OTHER_MAKER._replace(identity=number).pack())), 0)
    return peer


def standard_frames(effects: Iterable[Effect]) -> list[AllImplementsStop]:
    sent = [effect.message for effect in effects if isinstance(effect, Send)]
    return [message for message in sent if isinstance(message, AllImplementsStop)]


@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("switch", [Switch.STOP, Switch.ERROR])
def test_a1_release_of_one_button_keeps_the_stop_of_another(named: bool, switch: Switch) -> None:
    peer = bus(named)
    for second in range(10):
        peer.step(Heard(FIRST, AllImplementsStop(1, switch)), second * S)
        peer.step(Heard(SECOND, AllImplementsStop(0, Switch.PERMIT)), second * S + S // 2)
        assert StopCause.IMPLEMENTS_STOP in held_by(peer), second
    peer.step(Heard(FIRST, AllImplementsStop(1, Switch.PERMIT)), 10 * S)
    assert StopCause.IMPLEMENTS_STOP not in held_by(peer), "its own permit ends it"


def test_the_cause_names_the_button_that_holds_and_not_the_one_that_spoke_last() -> None:
    """A person was sent to whichever device had sent a frame, also to one that permits, and to a robot
    that only repeats the fleet's own stop."""
    peer = bus(True)
    for second in range(4):
        peer.step(Heard(SECOND, AllImplementsStop(1, Switch.STOP)), second * S)
        peer.step(Heard(FIRST, AllImplementsStop(0, Switch.PERMIT)), second * S + S // 2)
        assert dict(peer.safety.causes)[StopCause.IMPLEMENTS_STOP] == f"address {SECOND}", second
    buttons = ShortcutButtons()
    buttons.on_message(20, None, True, AllImplementsStop(1, Switch.STOP), 0)
    assert buttons.holder(S) == 20, "nothing else holds"
    buttons.on_message(FIRST, None, False, AllImplementsStop(1, Switch.STOP), S)
    buttons.on_message(SECOND, None, False, AllImplementsStop(1, Switch.STOP), S)
    assert buttons.holder(S) == FIRST and buttons.holder(S + HOLD_US) is None


def test_a1_a_silent_button_holds_for_its_time_out() -> None:
    peer = bus(True)
    peer.step(Heard(FIRST, AllImplementsStop(1, Switch.STOP)), 0)
    for now_us in range(0, 2 * HOLD_US, S // 2):
        peer.step(Heard(SECOND, AllImplementsStop(0, Switch.PERMIT)), now_us)
        peer.safety.on_tick(now_us)
        assert (StopCause.IMPLEMENTS_STOP in held_by(peer)) is (now_us < HOLD_US), now_us


def test_a1_a_missed_transition_stops() -> None:
    peer = bus(True)
    peer.step(Heard(FIRST, AllImplementsStop(4, Switch.PERMIT)), 0)
    assert StopCause.IMPLEMENTS_STOP not in held_by(peer), "what it counted before we were there"
    peer.step(Heard(FIRST, AllImplementsStop(5, Switch.PERMIT)), S)
    for now_us in range(S, S + HOLD_US, S // 2):
        peer.step(Heard(FIRST, AllImplementsStop(5, Switch.PERMIT)), now_us)
        assert StopCause.IMPLEMENTS_STOP in held_by(peer), "a press was missed"
    peer.step(Heard(FIRST, AllImplementsStop(5, Switch.PERMIT)), S + HOLD_US)
    assert StopCause.IMPLEMENTS_STOP not in held_by(peer)
    peer.step(Heard(FIRST, AllImplementsStop(0, Switch.PERMIT)), 6 * S)
    assert StopCause.IMPLEMENTS_STOP not in held_by(peer), "it was switched off and on"


@pytest.mark.parametrize("pressed", [1, 5, 255])
@pytest.mark.parametrize("forged", [0, 1, 5, 6, 255])
def test_permits_in_the_name_of_a_button_that_is_pressed_move_nobody_for_more_than_a_second(
    pressed: int, forged: int
) -> None:
    """Before: with one forged permit after each stop, robots moved all the time (as in T4, with one
    address)."""
    peer, moved = bus(True), 0
    for tick in range(200):
        now_us = tick * S // 10
        if tick % 10 == 0:
            peer.step(Heard(FIRST, AllImplementsStop(pressed, Switch.STOP)), now_us)
        if tick % 10 == 1:
            peer.step(Heard(FIRST, AllImplementsStop(forged, Switch.PERMIT)), now_us)
        peer.safety.on_tick(now_us)
        moved += StopCause.IMPLEMENTS_STOP not in held_by(peer)
    assert moved <= 9, "until the next stop of the button, once"


def test_a_button_that_counts_is_released_at_once_each_time_and_one_that_does_not_after_its_time() -> (
    None
):
    peer = bus(True)
    for press in range(1, 600):
        now_us = press * S
        peer.step(Heard(FIRST, AllImplementsStop(press & 0xFF, Switch.STOP)), now_us)
        assert StopCause.IMPLEMENTS_STOP in held_by(peer)
        peer.step(Heard(FIRST, AllImplementsStop(press & 0xFF, Switch.PERMIT)), now_us + S // 2)
        assert StopCause.IMPLEMENTS_STOP not in held_by(peer), press
    for press in range(2):
        now_us = (700 + 10 * press) * S
        peer.step(Heard(SECOND, AllImplementsStop(0, Switch.STOP)), now_us)
        peer.step(Heard(SECOND, AllImplementsStop(0, Switch.PERMIT)), now_us + S)
        assert (StopCause.IMPLEMENTS_STOP in held_by(peer)) == (press > 0)
        peer.safety.on_tick(now_us + HOLD_US)
        peer.step(Heard(SECOND, AllImplementsStop(0, Switch.PERMIT)), now_us + HOLD_US)
        assert StopCause.IMPLEMENTS_STOP not in held_by(peer)


def test_a_button_that_changes_its_address_between_two_presses_is_one_button() -> None:
    peer = bus(True)
    peer.step(Heard(FIRST, AllImplementsStop(7, Switch.STOP)), 0)
    moved_to = AddressClaimed(OTHER_MAKER._replace(identity=0).pack())
    peer.step(Heard(44, moved_to), S // 2)
    peer.step(Heard(44, AllImplementsStop(7, Switch.PERMIT)), S)
    assert StopCause.IMPLEMENTS_STOP not in held_by(peer), "it is its own permit"
    peer.step(Heard(44, AllImplementsStop(9, Switch.PERMIT)), 2 * S)
    assert StopCause.IMPLEMENTS_STOP in held_by(peer), "two presses were missed"


def test_t4_a_reset_tool_permits_for_itself_alone() -> None:
    peer = bus(True)
    peer.step(Heard(FIRST, AllImplementsStop(1, Switch.STOP)), 0)
    peer.step(Heard(249, AllImplementsStop(0, Switch.PERMIT)), MS)
    assert StopCause.IMPLEMENTS_STOP in held_by(peer)


def test_a1_more_buttons_than_addresses_only_stand_longer() -> None:
    buttons = ShortcutButtons()
    for name in range(3 * BUTTONS_MAX):
        buttons.on_message(0, name, False, AllImplementsStop(1, Switch.STOP), name)
    assert len(buttons) == BUTTONS_MAX
    for name in range(3 * BUTTONS_MAX):
        buttons.on_message(0, name, False, AllImplementsStop(1, Switch.PERMIT), S)
    assert buttons.ends_at_us() > S, "those for which there was no room cannot permit"
    assert buttons.ends_at_us() <= 3 * BUTTONS_MAX + HOLD_US


def pressed_robot() -> tuple[Peer, list[tuple[int, AllImplementsStop]]]:
    """Pressed at 2 s, reset at 8 s, watched to 14 s: its standard frames and their times."""
    peer, said = peer_in(State.IDLE, None), list[tuple[int, AllImplementsStop]]()
    now_us = 0

    def run(ends_at_us: int) -> None:
        nonlocal now_us
        while now_us < ends_at_us:
            now_us = max(now_us + 1, peer.due_at_us)
            said.extend((now_us, m) for m in standard_frames(peer.step(Timer(), now_us)))

    run(2 * S)
    effects = peer.step(Press(Reason.PERSON_IN_FIELD), now_us)
    said.extend((now_us, m) for m in standard_frames(effects))
    run(8 * S)
    for dot in peer.safety.stops.active:
        peer.safety.clear_near(dot, "test", 0)
    effects = peer.step(ManualReset(), now_us)
    assert all(e.source is not None for e in effects if isinstance(e, Send))
    said.extend((now_us, m) for m in standard_frames(effects))
    run(14 * S)
    return peer, said


def test_a4_a_press_says_the_standard_stop_every_second_until_the_release() -> None:
    _, said = pressed_robot()
    stops = [t_us for t_us, m in said if m == AllImplementsStop(1, Switch.STOP)]
    permits = [t_us for t_us, m in said if m == AllImplementsStop(1, Switch.PERMIT)]
    assert len(stops) + len(permits) == len(said), "counted from power up: this is the first"
    assert 6 <= len(stops) <= 7 and stops[0] < 2 * S + 100 * MS
    assert max(b - a for a, b in pairwise(stops)) <= SAY_US + 100 * MS
    assert len(permits) == 1 + PERMITS and permits[0] < 8 * S + 100 * MS


def test_a4_the_count_is_that_of_stops() -> None:
    button = OwnButton()
    for press in range(1, 300):
        said = button.press(press * S)
        assert said == button.press(press * S + 1) == AllImplementsStop(press & 0xFF, Switch.STOP)
        assert button.release(press * S + 2) == AllImplementsStop(press & 0xFF, Switch.PERMIT)


def test_a4_one_of_those_latched_by_a_panel_says_it_and_another_takes_over() -> None:
    """The first of three says it and falls silent; the second takes over before listeners forget."""
    buttons = [OwnButton() for _ in range(3)]
    said = list[tuple[int, int]]()
    for now_us in range(0, 20 * S, 50 * MS):
        for rank, button in enumerate(buttons):
            if rank == 0 and now_us >= 8 * S:
                continue  # its power has failed
            message = button.outgoing(True, rank, now_us)
            if message is not None:
                said.append((now_us, rank))
                for other in buttons:
                    if other is not button:
                        other.on_message(message, now_us)
    assert {rank for t_us, rank in said if t_us < 8 * S} == {0}
    assert {rank for t_us, rank in said if t_us >= 8 * S} == {1}
    times_us = [t_us for t_us, _ in said]
    assert max(b - a for a, b in pairwise(times_us)) < HOLD_US


def test_a4_a_robot_latched_by_a_panel_says_it() -> None:
    peer, said = introduce_tools(peer_in(State.IDLE, None), 140), list[AllImplementsStop]()
    now_us = 0
    while now_us < 4 * S:
        now_us = max(now_us + 1, peer.due_at_us)
        said += standard_frames(peer.step(Timer(), now_us))
        if now_us >= S and not peer.safety.latched:
            peer.step(Heard(140, EmergencyStop(*StopDot(140, 1, 1), 1)), now_us)
    assert 3 <= len(said) <= 4 and set(said) == {AllImplementsStop(1, Switch.STOP)}


def test_a4_a_robot_that_stays_latched_alone_brakes_the_others_once() -> None:
    """One that was switched off during the reset comes back and says its stop every second."""
    peer = peer_in(State.WORKING, None)
    peer.step(Heard(140, AddressClaimed(fleet_name("total", 1).pack())), 0)
    peer.step(Heard(140, Member(1, 0, 1)), 0)
    for now_us in range(0, 6 * S, S):
        peer.step(Heard(140, AllImplementsStop(1, Switch.STOP)), now_us)
        peer.safety.on_tick(now_us)
        assert (StopCause.IMPLEMENTS_STOP in held_by(peer)) is (now_us < HOLD_US), now_us
    peer.step(Heard(140, AllImplementsStop(2, Switch.STOP)), 6 * S)
    assert StopCause.IMPLEMENTS_STOP in held_by(peer), "pressed again"
