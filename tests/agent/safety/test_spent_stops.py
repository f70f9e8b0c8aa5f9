"""A press whose name was cleared before, a press without an address, and a release of many stops."""

from collections.abc import Iterable
from random import Random

import pytest

from agent.interface.config import MS, STOP_REPEAT_US, S
from agent.interface.effects import HALT, Effect, Persist, Send
from agent.interface.identity import Identity, SilencePolicy
from agent.interface.lifecycle import State
from agent.peer.inputs import Heard, ManualReset, Press, Start, Timer
from agent.peer.peer import Peer
from agent.runtime.peer_factory import make_peer
from agent.safety.stop_cause import StopCause, about
from agent.safety.stop_controller import (
    AGAIN_US,
    HELD,
    HOLD_KEY,
    SPENT_HOLD_US,
    StopController,
)
from agent.segments.fleet_stops import FleetStops
from crdt.stops import ACTIVE_MAX, StopDot
from protocol.authentication import Keyring, Keys
from protocol.fleet_tags import FleetTags, HeldTags
from protocol.frames.safety_frames import (
    Challenge,
    EmergencyReset,
    EmergencyStop,
    HeldReset,
    Reason,
    StopsHeld,
)
from protocol.frames.segment_frames import FleetStop
from protocol.name import fleet_name
from tests.agent.lone_peer import held_by, introduce, introduce_tools, peer_in

PANEL, OPERATOR = 140, 200
DOT = StopDot(PANEL, 1, 1)
PRESS = EmergencyStop(*DOT, Reason.PERSON_IN_FIELD)
KEYS = Keys(bytes(16), bytes(range(16)))


def stops_of(effects: Iterable[Effect]) -> list[EmergencyStop]:
    sent = [effect.message for effect in effects if isinstance(effect, Send)]
    return [message for message in sent if isinstance(message, EmergencyStop)]


def cleared_before(dot: StopDot = DOT) -> Peer:
    """A robot at work that was told to clear a stop that nobody has pressed, and started again."""
    peer = introduce_tools(peer_in(State.WORKING, None), PANEL, 249)
    peer.step(Heard(249, EmergencyReset(*dot, OPERATOR)), 0)
    assert not peer.safety.latched
    peer.step(Start(named=False), 0)
    return peer


def test_a_robot_that_missed_a_stop_waits_for_a_start_when_it_is_cleared() -> None:
    """Found by `headland chaos`, profile stop, seed 104000389: a flood hid the stop, and the reset was
    the first that this robot received of it. It drove while all others stood and waited for a start."""
    peer = introduce_tools(peer_in(State.WORKING, None), PANEL, 249)
    effects = peer.step(Heard(249, EmergencyReset(*DOT, OPERATOR)), 0)
    assert HALT in effects and peer.safety.holds(StopCause.NOT_STARTED)
    assert Persist(HOLD_KEY, HELD) in effects, "also after a restart"
    peer.step(Start(named=False), S)
    assert peer.safety.may_move
    peer.step(Heard(249, EmergencyReset(*DOT, OPERATOR)), 2 * S)
    assert peer.safety.may_move, "a repetition tells nothing new"


def test_t5_a_stop_with_a_cleared_name_brakes_and_is_answered() -> None:
    peer = cleared_before()
    effects = peer.step(Heard(PANEL, PRESS), S)
    assert HALT in effects and not peer.safety.may_move
    (answer,) = stops_of(effects)
    assert (answer.spent, answer.echo, StopDot(*answer[:3])) == (True, True, DOT)
    assert not peer.safety.latched, "one frame may be late"
    peer.safety.on_tick(S + SPENT_HOLD_US)
    assert peer.safety.may_move


def test_t5_a_stop_with_a_cleared_name_that_is_said_still_latches() -> None:
    peer, now_us = cleared_before(), S
    while not peer.safety.latched and now_us < 2 * S:
        peer.step(Heard(PANEL, PRESS), now_us)
        assert not peer.safety.may_move
        peer.step(Timer(), now_us)
        now_us += STOP_REPEAT_US
    assert now_us <= S + AGAIN_US + 2 * STOP_REPEAT_US
    assert peer.safety.latched and peer.lifecycle.state is State.EMERGENCY_STOP
    (dot,) = peer.safety.stops.active
    assert dot.slot == peer.slot, "under a name of its own, which can be cleared"
    peer.step(Heard(249, EmergencyReset(*dot, OPERATOR)), now_us)
    peer.step(ManualReset(), now_us)
    assert not peer.safety.latched


def test_t5_a_panel_with_one_name_that_speaks_once_a_second_latches() -> None:
    peer = cleared_before()
    for second in range(1, 3):
        peer.step(Heard(PANEL, PRESS), second * S)
        peer.step(Timer(), second * S)
    assert peer.safety.latched


def test_t5_late_echoes_of_a_cleared_stop_do_nothing() -> None:
    peer = cleared_before()
    for now_us in range(S, 3 * S, 100 * MS):
        assert not stops_of(peer.step(Heard(PANEL, PRESS._replace(echo=True)), now_us))
        assert peer.safety.may_move and not peer.safety.latched


def test_t5_late_repeats_within_a_moment_only_brake() -> None:
    peer = cleared_before()
    for now_us in range(S, S + AGAIN_US, STOP_REPEAT_US):
        peer.step(Heard(PANEL, PRESS), now_us)
        peer.safety.on_tick(now_us)
    peer.safety.on_tick(S + AGAIN_US + SPENT_HOLD_US)
    assert not peer.safety.latched and peer.safety.may_move


def test_t5_a_pressed_robot_that_is_told_takes_another_name() -> None:
    peer = introduce_tools(peer_in(State.WORKING, None), PANEL, 249)
    introduce(peer, 141, 1)
    (press,) = stops_of(peer.step(Press(Reason.PERSON_IN_FIELD), S))
    told = press._replace(echo=True, spent=True)
    assert not stops_of(peer.step(Heard(141, told), S + MS)), "not within the spacing of stops"
    (again,) = stops_of(peer.step(Heard(141, told), S + 100 * MS))
    assert again[:3] != press[:3] and not again.echo
    for now_us in range(2 * S, 60 * S, 100 * MS):
        last = peer.step(Heard(141, again._replace(echo=True, spent=True)), now_us)
        again = (stops_of(last) or [again])[0]
    assert len(peer.safety.stops.active) <= 10, "somebody who only says so wears nothing out"


def test_t11_a_signed_stop_stops_though_its_name_was_cleared() -> None:
    safety = StopController(0, 1, SilencePolicy.STOP, Keyring(KEYS, 0, b"robot"), {}, 0)
    panel = Keyring(Keys(KEYS.master, None), PANEL, b"panel")
    safety.start(0)
    safety.stops.clear(DOT)
    for now_us in range(0, 200 * MS, STOP_REPEAT_US):
        safety.receive_stop(panel.sign(PRESS), None, now_us)
        safety.on_tick(now_us)
        assert not safety.may_move
    assert safety.latched
    assert safety.authority.refused == 0


def test_t5_forged_words_that_a_name_was_used_hold_for_a_moment_only() -> None:
    peer = introduce_tools(peer_in(State.WORKING, None), PANEL, 249)
    peer.step(Heard(PANEL, PRESS._replace(echo=True, spent=True)), S)
    assert held_by(peer) == {StopCause.SPENT_STOP}
    peer.safety.on_tick(S + SPENT_HOLD_US)
    assert peer.safety.may_move and not peer.safety.latched


# ---------------------------------------------------------------- many stops


def full(count: int, keyring: Keyring | None = None) -> StopController:
    safety = StopController(0, 1, SilencePolicy.STOP, keyring, {}, 0)
    for k in range(count):
        safety.press_near(StopDot(k >> 8 & 0x7F, k & 0xFF, k & 0xFF), 0)
    return safety


@pytest.mark.parametrize("count", [1, 20, 2_000, 70_000])
def test_t9_one_reset_releases_any_number_of_stops(count: int) -> None:
    safety = full(count)
    held = [e.message for e in safety.answer_stops(0, S) if isinstance(e, Send)][-1]
    assert isinstance(held, StopsHeld) and held.stops == min(count, 255)
    safety.receive_held_reset(HeldReset(held.digest, OPERATOR), S)
    assert safety.manual_reset(S)


@pytest.mark.parametrize("count", [1, 20, 2_000])
def test_t9_a_press_after_the_question_is_not_cleared(count: int) -> None:
    safety = full(count)
    held = safety.held_stops
    safety.receive_stop(EmergencyStop(120, 1, 1, 0), None, S)
    safety.receive_held_reset(HeldReset(held.digest, OPERATOR), S)
    assert safety.stops.latched and not safety.manual_reset(S)
    for now_us in range(2 * S, 3 * S, STOP_REPEAT_US):
        safety.receive_stop(EmergencyStop(120, 1, 1, 0, True), None, now_us)
    safety.receive_held_reset(HeldReset(safety.held_stops.digest, OPERATOR), 3 * S)
    assert safety.manual_reset(3 * S)


def test_t9_two_thousand_stops_cost_two_hundred_and_fifty_six_echoes() -> None:
    peer = introduce_tools(peer_in(State.IDLE, None), PANEL, 249)
    said = 0
    for k in range(2_000):
        said += len(
            stops_of(peer.step(Heard(PANEL, EmergencyStop(k >> 8, 1, k & 0xFF, 0)), k * MS))
        )
    assert said == ACTIVE_MAX and peer.safety.stops.more


def test_t11_an_operator_tells_a_robots_word_from_a_forged_one() -> None:
    safety, question = full(3, Keyring(KEYS, 0, b"robot")), 0x1234_5678_9ABC
    (held,) = (
        e.message
        for e in safety.answer_stops(question, S)
        if isinstance(e, Send) and isinstance(e.message, StopsHeld)
    )
    operator = HeldTags(Keys(None, KEYS.operator))
    assert operator.sign(held, question) == held
    assert operator.sign(held, question + 1) != held, "a replayed answer"
    assert operator.sign(held._replace(digest=held.digest ^ 1), question).tag != held.tag


def test_t11_a_reset_of_what_is_not_held_is_kept_for_no_later_time() -> None:
    """What the next press of a panel would be can be guessed; a reset that names it does nothing."""
    safety = full(0)
    later = full(0)
    later.receive_stop(PRESS, None, 0)
    safety.receive_held_reset(HeldReset(later.held_stops.digest, OPERATOR), 0)
    safety.receive_stop(PRESS, None, S)
    assert safety.stops.latched


def test_t16_a_stop_whose_questions_are_starved_brakes_at_once_and_latches_in_the_end() -> None:
    """The panel answers each asker once in 10 ms, and an attacker asks in the robot's name at the rate
    of a full bus. The robot had lost the panel's counter. One of its questions gets through."""
    safety = StopController(0, 1, SilencePolicy.STOP, Keyring(KEYS, 0, b"robot"), {}, 0)
    panel = Keyring(Keys(KEYS.master, None), PANEL, b"panel", 500)  # out of the robot's window
    rng, question, asked = Random(16), None, 0
    for turn in range(60_000):
        now_us = turn * 640  # a frame
        if turn % 100 == 0:  # the panel repeats its stop
            stop = panel.sign(EmergencyStop(*DOT, Reason.PERSON_IN_FIELD))
            sent = [
                e.message for e in safety.receive_stop(stop, None, now_us) if isinstance(e, Send)
            ]
            question = next((m for m in sent if isinstance(m, Challenge)), None)
            due = turn + rng.randrange(1, 90)
            assert not safety.may_move, "it stands from the first frame on"
        if question is not None and turn == due:
            asked += 1
            proof = panel.answer(question, now_us)
            if proof is not None:
                safety.authority.prove(proof, now_us)
        else:
            panel.answer(Challenge(PANEL, 0, turn), now_us)
        if safety.stops.latched:
            break
    assert safety.stops.latched and asked > 1, "seed 16"


def told_address(peer: Peer) -> int:
    """The address that this robot tells people to look for, with the one cause that holds it."""
    ((cause, detail),) = peer.safety.causes
    return about(cause, detail)


def test_a_device_that_holds_a_fleet_with_an_untagged_stop_is_named() -> None:
    """People were told to look for the device, and not for which one."""
    identity = Identity(0, frozenset(range(3)), fleet_name("total", 0), 1, SilencePolicy.STOP, True)
    keyring = Keyring(KEYS, 0, b"robot")
    peer = introduce_tools(make_peer(identity, Random(1), 0, {}, keyring=keyring), PANEL, 141)
    peer.safety.start(0)
    peer.safety.clear_cause(StopCause.BOOT_UNCONFIRMED, 0)
    peer.step(Heard(PANEL, PRESS), S)
    assert held_by(peer) == {StopCause.UNAUTHENTICATED_STOP} and told_address(peer) == PANEL
    everywhere = FleetStops(1, peer.safety, peer.senders, FleetTags(KEYS))
    everywhere.direct[FleetStop](141, None, FleetStop(2, *DOT), S)
    assert told_address(peer) == 141


def test_a_device_that_holds_a_fleet_with_a_used_name_is_named() -> None:
    peer = cleared_before()
    peer.step(Heard(PANEL, PRESS), 0)
    assert held_by(peer) == {StopCause.SPENT_STOP} and told_address(peer) == PANEL
    introduce(peer, 141, 1)
    answer = PRESS._replace(echo=True, spent=True)
    peer.step(Heard(141, answer), MS)
    assert told_address(peer) == PANEL, "a robot only answers"
    peer.step(Heard(249, answer), MS)
    assert told_address(peer) == 249, "who only says that a name was used holds the fleet, too"
