"""Tools read frames of our maker only, and a launch counts the sections of its field (A2, T8)."""

from random import Random

import pytest

from agent.interface.lifecycle import State
from crdt import Phase
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member
from protocol.frames.frame import Frame
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import EmergencyStop, Reason
from protocol.frames.work_frames import TaskClaim
from protocol.name import DeviceFields, Name, fleet_name
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.inspect.inspector import Inspector
from tools.operate.operator_device import Operator

FOREIGN = AddressClaimed(Name(4711, manufacturer=100, function=130).pack())
ROBOT = AddressClaimed(fleet_name("north", 1).pack())
AT, ROBOT_AT = 0x40, 129


class Silent:
    def send(self, frame: Frame) -> bool:
        return True


def operator() -> Operator:
    return Operator(Silent(), None)  # type: ignore[arg-type]


def proprietary(rng: Random) -> Frame:
    """Any frame of a group that each maker uses for something else."""
    group = 0xFF00 + rng.randrange(0x34)
    return Frame(rng.randrange(8) << 26 | group << 8 | AT, rng.randbytes(8))


def test_a2_frames_of_another_maker_make_no_robots_and_no_stops_for_tools() -> None:
    rng, tool, inspector = Random(24), operator(), Inspector()
    for listener in (tool, inspector):
        listener.hear(0.0, encode(FOREIGN, AT))
        listener.hear(0.1, encode(ROBOT, ROBOT_AT))
        listener.hear(0.2, encode(Member(1, 1, 7), ROBOT_AT))
        for tick in range(3_000):
            listener.hear(0.2 + tick * 1e-3, proprietary(rng))
        listener.hear(3.3, encode(Heartbeat(1, 3, False, False, True, False, 1.0, 0, 0), ROBOT_AT))
    assert list(tool.robots) == [1] and not tool.unknown and not tool.shown.near
    assert list(inspector.robots) == [1] and not inspector.stops and not inspector.malformed
    assert sum(inspector.makers.refused.values()) == 3_000
    assert len(inspector.to_dict()["other_makers"]) == 0x34


def test_tools_read_robots_of_the_manufacturer_that_they_are_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    device = DeviceFields(manufacturer=555, function=140, device_class=24)
    claim = AddressClaimed(fleet_name("north", 1, device).pack())
    for told, seen in (("", []), ("556", []), ("555", [1])):
        monkeypatch.setenv("HEADLAND_MANUFACTURER", told)
        tool, inspector = operator(), Inspector()
        for listener in (tool, inspector):
            listener.hear(0.0, encode(claim, ROBOT_AT))
            listener.hear(0.1, encode(Member(1, 1, 7), ROBOT_AT))
            assert list(listener.robots) == seen


def test_a2_a_robot_that_another_makers_frame_had_made_goes_with_its_claim() -> None:
    tool, inspector = operator(), Inspector()
    for listener in (tool, inspector):
        listener.hear(0.0, encode(Member(77, 1, 7), AT))  # we came after its claim
        assert 77 in listener.robots
        listener.hear(0.1, encode(FOREIGN, AT))
        listener.hear(0.2, encode(Member(77, 1, 7), AT))
        assert not listener.robots


def test_a2_a_robot_that_is_known_stays_in_the_count_when_another_claims_its_address() -> None:
    tool = operator()
    tool.hear(0.0, encode(Member(1, 1, 7), ROBOT_AT))
    tool.hear(0.1, encode(ROBOT, ROBOT_AT))
    tool.hear(0.2, encode(FOREIGN, ROBOT_AT))
    assert list(tool.robots) == [1]
    tool.expect((2,))  # as a launch's file says
    tool.hear(0.3, encode(Member(2, 1, 7), AT))
    tool.hear(0.4, encode(FOREIGN, AT))
    assert list(tool.robots) == [1, 2]


def test_a2_a_robot_that_loses_or_defends_its_address_stays_in_view() -> None:
    """It was gone from `inspect` and the map, and a launch told that its stop was released."""
    inspector = Inspector()
    beat = encode(Heartbeat(1, State.EMERGENCY_STOP, True, True, True, False, 1.0, 0, 0), ROBOT_AT)
    for t_s, frame in ((0.0, encode(ROBOT, ROBOT_AT)), (0.1, encode(Member(1, 1, 7), ROBOT_AT))):
        inspector.hear(t_s, frame)
    inspector.hear(0.2, beat)
    inspector.hear(0.3, encode(FOREIGN, ROBOT_AT))
    assert inspector.robots[1].state == State.EMERGENCY_STOP.name
    inspector.hear(0.4, beat)  # of the other device
    assert inspector.robots[1].last_s == 0.2
    inspector.hear(0.5, encode(ROBOT, ROBOT_AT))
    inspector.hear(0.6, beat)
    assert inspector.robots[1].last_s == 0.6, "it has defended its address"
    inspector.hear(0.7, encode(FOREIGN, ROBOT_AT))
    inspector.hear(0.8, encode(Member(1, 1, 7), ROBOT_AT + 1))
    inspector.hear(0.9, encode(ROBOT, ROBOT_AT))
    assert inspector.slot_of == {ROBOT_AT + 1: 1}, "it has moved"


def test_a2_a_stop_of_a_device_that_claims_nothing_is_shown() -> None:
    inspector = Inspector()
    inspector.hear(0.0, encode(EmergencyStop(150, 1, 1, Reason.OPERATOR_INTERVENTION), 0x50))
    assert inspector.latched == [(150, 1, 1)]


def test_t8_done_of_a_section_that_the_field_has_not_is_counted_and_not_added() -> None:
    sections = frozenset(s.id for s in FieldSetup(load("small")).field.sections)
    inspector = Inspector(sections)
    inspector.hear(0.0, encode(Member(0, 1, 7), 128))
    for section in (max(sections) + 1, 60_000, *sections):
        inspector.hear(0.1, encode(TaskClaim(section, 1, Phase.DONE, 0, 9, 0), 128))
    assert inspector.allocation.done_count() == len(sections)
    assert inspector.to_dict()["beyond_the_field"] == inspector.beyond == 2
