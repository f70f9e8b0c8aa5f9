"""Which robots get a stop, how often, under which name, and which silences count as a stop."""

from collections.abc import Iterable

import pytest

from agent.interface.config import MS, STOP_REPEAT_US, S
from agent.interface.effects import Effect, Send
from agent.interface.identity import SilencePolicy
from agent.interface.lifecycle import State
from agent.peer.inputs import Heard, Press, Timer
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import REPEATS_ALONE, StopController
from crdt.stops import StopDot
from protocol.frames.fleet_frames import Pose
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import EmergencyReset, EmergencyStop, Reason
from protocol.name import fleet_name
from tests.agent.lone_peer import introduce, peer_in


def stops_of(effects: Iterable[Effect]) -> list[EmergencyStop]:
    sent = [effect.message for effect in effects if isinstance(effect, Send)]
    return [message for message in sent if isinstance(message, EmergencyStop)]


def test_who_knows_nobody_repeats_its_stop_for_a_second() -> None:
    """Found by `headland chaos`, profile press, seed 3226: its only frame was lost."""
    peer = peer_in(State.IDLE, None)
    said = stops_of(peer.step(Press(Reason.PERSON_IN_FIELD), 0))
    for now_us in range(0, 3 * S, STOP_REPEAT_US):
        said += stops_of(peer.safety.on_tick(now_us))
    assert len(said) == 1 + REPEATS_ALONE
    assert len(set(said)) == 1, "one stop; the repetition says the same reason"


@pytest.mark.parametrize("stood", [False, True])
def test_a_claim_by_one_that_may_move_is_no_sign_of_life(stood: bool) -> None:
    """Found by `headland chaos`, profile protocol, seed 1600653: a robot was pressed while it was off the
    bus, came back and claimed its address. It could send the stop only 250 ms later, and its claim
    counted as a sign of life. A fleet that is reset claims again, and is not silent."""
    peer = peer_in(State.WORKING, None)
    name = fleet_name("total", 1).pack()
    introduce(peer, 140, 1)
    pose, silence_for_us = (
        Pose(0.0, 0.0, 0.0, 0.0, State.IDLE, stood, 0),
        peer.membership.silence_for_us,
    )
    peer.step(Heard(140, pose), 0)
    peer.step(Heard(140, AddressClaimed(name)), silence_for_us - 1)
    peer.step(Timer(), silence_for_us)
    assert peer.membership.silent == (set() if stood else {1})
    peer.step(Heard(140, AddressClaimed(name)), silence_for_us + 1)
    assert peer.membership.silent == (set() if stood else {1}), (
        "nor does it come back by that alone"
    )
    peer.step(Heard(140, pose), silence_for_us + 2)
    assert not peer.membership.silent


@pytest.mark.parametrize("back_us", [0, -5 * S])
def test_a_press_is_heard_though_the_clock_is_set_back(back_us: int) -> None:
    peer = peer_in(State.IDLE, None)
    assert stops_of(peer.step(Press(Reason.PERSON_IN_FIELD), 9 * S))
    assert not stops_of(peer.step(Press(Reason.PERSON_IN_FIELD), 9 * S + 1)), "the same hand"
    assert bool(stops_of(peer.step(Press(Reason.PERSON_IN_FIELD), 9 * S + 2 + back_us))) is (
        back_us < 0
    )


def test_a_stranger_that_does_not_stand_is_told_of_the_stop() -> None:
    peer = peer_in(State.IDLE, None)
    peer.step(Press(Reason.PERSON_IN_FIELD), 0)
    moving = Pose(0.0, 0.0, 0.0, 2.0, State.WORKING, False, 0)
    (told,) = stops_of(peer.step(Heard(140, moving), S))
    assert (told.slot, told.echo) == (0, True)
    assert not stops_of(peer.step(Heard(140, moving), S + 1)), "not at once again"
    assert not stops_of(peer.step(Heard(140, moving._replace(stopped=True)), 2 * S))


def test_each_of_many_stops_is_told_in_turn() -> None:
    """Found by `headland chaos`, profile protocol, seed 2403159: a robot told the first four of five
    stops, again and again; those had been cleared where they were heard, behind a cut, and the fifth
    had not."""
    peer = peer_in(State.IDLE, None)
    introduce(peer, 140, 1)
    dots = {StopDot(slot, 7, counter) for slot in range(2) for counter in range(5)}
    for dot in dots:
        peer.step(Heard(140, EmergencyStop(*dot, 1, False, 0, 0)), 0)
    assert peer.safety.stops.active == dots
    moving = Pose(0.0, 0.0, 0.0, 2.0, State.WORKING, False, 0)
    told = [stops_of(peer.step(Heard(140, moving), turn * S)) for turn in range(1, 4)]
    assert {StopDot(*stop[:3]) for stops in told for stop in stops} == dots


@pytest.mark.parametrize("stood", [False, True])
def test_who_stood_before_a_press_has_to_say_that_stop(stood: bool) -> None:
    """Found by `headland chaos`, profile protocol, seed 203087: the only other robot stood already, had
    not heard the stop, and passed for one that had; then the one that was pressed lost its memory."""
    peer = peer_in(State.IDLE, None)
    introduce(peer, 140, 1)
    pose = Pose(0.0, 0.0, 0.0, 0.0, State.EMERGENCY_STOP, True, 0)
    peer.step(Heard(140, pose._replace(stopped=stood)), 0)
    (stop,) = stops_of(peer.step(Press(Reason.PERSON_IN_FIELD), 0))
    peer.step(Heard(140, pose), MS)
    assert bool(stops_of(peer.safety.on_tick(STOP_REPEAT_US))) is stood
    peer.step(Heard(140, stop._replace(echo=True)), STOP_REPEAT_US)
    assert not stops_of(peer.safety.on_tick(2 * STOP_REPEAT_US))


def test_a_life_without_memory_names_its_stops_anew() -> None:
    """Found by `headland chaos`, profile protocol, seed 806733: the new incarnation, 39681, had the low
    byte of the first, which is all that a stop says of it."""
    names = set()
    for incarnation in (1, 39681, 39682):
        safety = StopController(0, incarnation, SilencePolicy.STOP, None, {}, 0)
        (stop,) = stops_of(safety.press(Reason.PERSON_IN_FIELD, 0))
        names.add((stop.incarnation, stop.counter))
    assert len(names) == 3


@pytest.mark.parametrize("cause", [StopCause.BUS_OFF, StopCause.ADDRESS_LOST, StopCause.UNHEARD])
def test_a_press_while_no_frame_leaves_is_sent_when_the_bus_is_back(cause: StopCause) -> None:
    """Found by `headland chaos`, profile flood, seed 1300127: a lone robot was pressed while its
    controller was off the bus, and all its repeats were over before the first could leave."""
    safety = StopController(0, 1, SilencePolicy.CONTINUE, None, {}, 0)
    safety.raise_cause(cause, 0)
    (stop,) = stops_of(safety.press(Reason.PERSON_IN_FIELD, 0))
    for now_us in range(0, 60 * S, 10 * MS):
        safety.on_tick(now_us)
    safety.clear_cause(cause, 60 * S)
    soon = range(60 * S, 60 * S + 100 * MS, MS)
    assert stop in [said for now_us in soon for said in stops_of(safety.on_tick(now_us))]


def test_who_was_stopped_by_another_while_we_were_off_the_bus_has_to_say_our_stop() -> None:
    """Found by `headland chaos`, profile flood, seed 1401584: the members were stopped by a second press
    meanwhile; back on the bus, their stopped bit passed for an echo of the first press, of which no
    other robot and no operator ever heard, until it ended a reset of the fleet."""
    peer = peer_in(State.IDLE, None)
    introduce(peer, 140, 1)
    pose = Pose(0.0, 0.0, 0.0, 0.0, State.WORKING, False, 0)
    peer.step(Heard(140, pose), 0)
    peer.safety.raise_cause(StopCause.BUS_OFF, 0)
    (stop,) = stops_of(peer.step(Press(Reason.PERSON_IN_FIELD), 0))
    peer.safety.on_tick(STOP_REPEAT_US)
    peer.safety.clear_cause(StopCause.BUS_OFF, 60 * MS)
    peer.step(Heard(140, pose._replace(state=State.EMERGENCY_STOP, stopped=True)), 60 * MS)
    assert stop in stops_of(peer.safety.on_tick(70 * MS))
    peer.step(Heard(140, stop._replace(echo=True)), 70 * MS)
    assert not stops_of(peer.safety.on_tick(80 * MS))


def test_a_press_after_its_stop_was_cleared_is_a_new_one() -> None:
    """Within 100 ms, a second press counts as the same one only while that one holds."""
    safety = StopController(0, 1, SilencePolicy.STOP, None, {}, 0)
    safety.press(Reason.PERSON_IN_FIELD, 0)
    (dot,) = safety.stops.active
    safety.receive_reset(EmergencyReset(*dot, 249), 50 * MS)
    assert safety.manual_reset(60 * MS)
    assert stops_of(safety.press(Reason.PERSON_IN_FIELD, 90 * MS))
    assert safety.stops.latched and not safety.manual_reset(95 * MS)


def test_a_cause_that_is_raised_with_an_earlier_end_keeps_its_own() -> None:
    safety = StopController(0, 1, SilencePolicy.STOP, None, {}, 0)
    safety.raise_cause(StopCause.UNAUTHENTICATED_STOP, 1 * S, "now", 2 * S)
    safety.raise_cause(StopCause.UNAUTHENTICATED_STOP, 0, "heard before", 2 * S)
    safety.on_tick(2500 * MS)
    assert safety.holds(StopCause.UNAUTHENTICATED_STOP)
    safety.on_tick(3 * S)
    assert not safety.holds(StopCause.UNAUTHENTICATED_STOP)


def test_a_press_after_its_stop_was_cleared_is_a_new_one_before_the_reset_too() -> None:
    """The machine is still latched by the stop that an operator has cleared. The press was taken for the
    first one, so a release that was under way let the robot go."""
    safety = StopController(0, 1, SilencePolicy.STOP, None, {}, 0)
    safety.press(Reason.PERSON_IN_FIELD, 0)
    (dot,) = safety.stops.active
    safety.receive_stop(EmergencyStop(1, 1, 1, Reason.OPERATOR_INTERVENTION), 1, 10 * MS)
    safety.receive_reset(EmergencyReset(*dot, 249), 50 * MS)
    assert stops_of(safety.press(Reason.PERSON_IN_FIELD, 90 * MS)), (
        "another stop holds it meanwhile"
    )
    safety.receive_reset(EmergencyReset(1, 1, 1, 249), 95 * MS)
    assert safety.stops.latched and not safety.manual_reset(98 * MS)


def test_a_press_that_is_cleared_while_it_is_repeated_leaves_nothing_behind() -> None:
    """Its reason was kept for ever: one more with each press that a person cleared at once."""
    safety = StopController(0, 1, SilencePolicy.STOP, None, {}, 0)
    safety.members(frozenset({0, 1}), frozenset(), 0)
    for k in range(300):
        safety.press(Reason.OPERATOR_INTERVENTION, k * S)
        (dot,) = safety.stops.active
        safety.clear_near(dot, "a test", k * S + 10 * MS)
        safety.on_tick(k * S + 20 * MS)
    assert not (safety._reasons or safety._own or safety._echoes)
