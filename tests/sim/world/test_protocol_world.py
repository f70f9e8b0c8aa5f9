"""The world of fleets without bodies."""

from agent.interface.observation import Observation
from sim.world.protocol_world import ProtocolWorld, StationaryBody


def test_what_a_robot_without_a_body_senses_has_every_field() -> None:
    """It is built as a plain tuple, for speed: a new field of an observation was missing in it, and
    each robot failed at its first control period."""
    seen = StationaryBody(ProtocolWorld(2, 4), 1).sense(1_000)
    assert len(seen) == len(Observation._fields)
    assert seen == Observation(**seen._asdict())
    assert seen.implement_down is None and seen.sensed_at_us == 1_000
