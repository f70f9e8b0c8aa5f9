"""What `headland inspect` and the map show of stops on the bus."""

from protocol.frames.codec import encode
from protocol.frames.safety_frames import AllImplementsStop, EmergencyStop, HeldReset, Switch
from tools.inspect.inspector import BUTTON_S, Inspector


def test_a1_the_map_shows_a_stop_while_any_button_is_pressed() -> None:
    inspector = Inspector()
    inspector.hear(0.0, encode(AllImplementsStop(1, Switch.STOP), 38))
    inspector.hear(0.5, encode(AllImplementsStop(0, Switch.PERMIT), 41))
    assert inspector.implements_stop == 0.0
    inspector.hear(BUTTON_S, encode(AllImplementsStop(0, Switch.PERMIT), 41))
    assert inspector.implements_stop is None, "it is silent"
    inspector.hear(5.0, encode(AllImplementsStop(2, Switch.STOP), 38))
    inspector.hear(5.1, encode(AllImplementsStop(2, Switch.PERMIT), 38))
    assert inspector.implements_stop is None


def test_t5_that_a_name_was_used_before_is_no_stop() -> None:
    inspector = Inspector()
    inspector.hear(0.0, encode(EmergencyStop(140, 1, 1, 0, True, spent=True), 128))
    assert inspector.latched == []
    inspector.hear(1.0, encode(EmergencyStop(140, 1, 2, 0), 60))
    assert inspector.latched == [(140, 1, 2)]
    inspector.hear(2.0, encode(HeldReset(77, 249), 249))
    assert inspector.latched == []
