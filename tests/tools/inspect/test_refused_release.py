"""A release that robots refuse is none for a listener on the bus (T11)."""

import pytest

from agent.interface.lifecycle import State
from agent.safety.stop_cause import StopCause
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member, Standstill
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import EmergencyReset, EmergencyStop, HeldReset, Reason
from protocol.frames.segment_frames import FleetStop
from protocol.name import fleet_name
from sim.record.recording import Recording
from tools.inspect.inspector import RESET_REFUSED_S, RESET_TAKEN_S, Inspector
from tools.livemap.playback import Index
from tools.report.timeline import History

DOT = (1, 1, 7)


def listener(keyed: bool) -> Inspector:
    """It has heard a robot whose fleet has keys or none, and a press there."""
    inspector = Inspector()
    beat = Heartbeat(1, State.EMERGENCY_STOP, True, True, True, False, 1.0, 0, 0, keyed)
    claim = AddressClaimed(fleet_name("held", 1).pack())
    stop = EmergencyStop(*DOT, Reason.OPERATOR_INTERVENTION, False, 9, 9)
    for message in (claim, Member(1, 1, 7), beat, stop):
        inspector.hear(0.1, encode(message, 129))
    assert inspector.keyed is keyed and inspector.latched == [DOT]
    return inspector


@pytest.mark.parametrize("signs", [False, True])
@pytest.mark.parametrize("reset", [HeldReset(5, 249), EmergencyReset(*DOT, 249)], ids=type)
@pytest.mark.parametrize("keyed", [False, True])
def test_t11_a_fleet_with_keys_is_not_shown_as_released_by_a_reset_without_a_tag(
    keyed: bool, reset: HeldReset | EmergencyReset, signs: bool
) -> None:
    """`headland release` without the keys cleared the stop in `inspect`, on the map and in figures
    for Prometheus, and the robots stood latched."""
    inspector = listener(keyed)
    said: Message = reset._replace(freshness=1, tag=2) if signs else reset
    inspector.hear(0.2, encode(said, 249))
    assert inspector.latched == ([DOT] if keyed and not signs else [])


@pytest.mark.parametrize(
    "reset", [HeldReset(5, 249, 1, 2), EmergencyReset(*DOT, 249, 1, 2)], ids=type
)
def test_t11_a_reset_with_a_wrong_tag_is_shown_as_refused_when_robots_say_what_holds_them(
    reset: HeldReset | EmergencyReset,
) -> None:
    """After such a frame of any device `inspect`, the map and the figures showed no stop for good, and
    the robots stood latched."""
    inspector = listener(True)
    held = encode(Standstill(1, StopCause.STOP_DOT.number, 0, 1, number=1), 129)
    inspector.hear(1.0, encode(reset, 249))
    inspector.hear(1.1, held)
    assert inspector.latched == [], "the reset may be under way to that robot"
    inspector.hear(2.0, encode(reset, 249))
    inspector.hear(2.0 + RESET_TAKEN_S + 0.1, held)
    assert inspector.latched == [DOT]
    inspector.hear(60.0, encode(reset, 249))
    none = Standstill(1, StopCause.NOT_STARTED.number, 0, 1)
    inspector.hear(60.0 + RESET_TAKEN_S + 0.1, encode(none, 129))
    inspector.hear(60.0 + RESET_REFUSED_S + 1.0, held)
    assert inspector.latched == [], "that is a stop that nobody has heard"


def test_t11_a_stop_of_another_segment_that_holds_a_robot_says_nothing_of_a_reset() -> None:
    inspector = listener(True)
    inspector.hear(1.0, encode(FleetStop(2, 9, 9, 9), 129))
    inspector.hear(1.0, encode(EmergencyReset(*DOT, 249, 1, 2), 249))
    held = Standstill(1, StopCause.STOP_DOT.number, 0, 1, number=1)
    inspector.hear(1.1 + RESET_TAKEN_S, encode(held, 129))
    assert inspector.latched == []


def test_t11_the_list_of_the_map_and_a_report_tell_that_a_release_was_refused() -> None:
    recording, timeline = Recording(), History()
    beat = Heartbeat(1, State.EMERGENCY_STOP, True, True, True, False, 1.0, 0, 0, True)
    stop = EmergencyStop(*DOT, Reason.OPERATOR_INTERVENTION, False, 9, 9)
    held = Standstill(1, StopCause.STOP_DOT.number, 0, 1, number=1)
    frames: list[tuple[float, Message, int]] = [
        (0.0, Member(1, 1, 7), 129), (0.1, beat, 129), (0.2, stop, 129),
        (1.0, HeldReset(5, 249, 1, 2), 249), (1.1 + RESET_TAKEN_S, held, 129),
    ]  # fmt: skip
    frames += [(0.1 * k, beat, 129) for k in range(1, 60)]
    for t_s, message, source in sorted(frames, key=lambda each: each[0]):
        recording.write(round(t_s * 1e6), encode(message, source))
        timeline.hear(t_s, encode(message, source))
    index = Index(recording)
    index.work(1e9)
    told = [event.text for event in index.events]
    assert "the release was refused: robots hold the stop" in told, told
    (pressed,) = timeline.pressed
    assert pressed.cleared_s is None


@pytest.mark.parametrize("held", [False, True])
def test_a_stop_whose_reset_was_not_heard_is_not_shown_for_ever(held: bool) -> None:
    """A map whose link was away at the reset showed a stop while all robots drove."""
    inspector = listener(False)
    other = AddressClaimed(fleet_name("held", 2).pack())
    for message in (other, Member(2, 1, 7)):
        inspector.hear(0.2, encode(message, 130))
    free = Heartbeat(1, State.WORKING, False, False, True, False, 1.0, 0, 0, False)
    for tick in range(10, 200):
        inspector.hear(0.1 * tick, encode(free, 129))
        inspector.hear(0.1 * tick, encode(free._replace(stopped=held), 130))
        assert (inspector.latched == [DOT]) is (held or tick < 60), tick
    inspector.hear(20.0, encode(EmergencyStop(1, 1, 8, Reason.OPERATOR_INTERVENTION), 249))
    assert (1, 1, 8) in inspector.latched, "a press is shown at once"
