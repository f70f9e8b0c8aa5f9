"""Every frame kind there and back; any frame at all without an exception."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.frames.accord_frames import Accord
from protocol.frames.codec import Malformed, decode, encode
from protocol.frames.fleet_frames import Heartbeat, LeaderElectionVote, Member, Pose, VectorSlice
from protocol.frames.frame import Frame
from protocol.frames.messages import GROUPS
from protocol.frames.network_frames import (
    Acknowledgment,
    AddressClaimed,
    Request,
    TransportData,
    TransportManagement,
)  # fmt: skip
from protocol.frames.operator_frames import (
    LOWEST_M,
    PLACE_M,
    OperatorGoal,
    OperatorReport,
    ReportKind,
    goal_frames,
)
from protocol.frames.safety_frames import (
    AllImplementsStop,
    Challenge,
    EmergencyReset,
    EmergencyStop,
    Freshness,
    HeldReset,
    OperatorCommand,
    StopsHeld,
)  # fmt: skip
from protocol.frames.segment_frames import FleetReset, FleetStop, GatewayBeat, SegmentSummary
from protocol.frames.work_frames import (
    Digests,
    StateSyncRequest,
    StateSyncResponse,
    TaskClaim,
    WorkProgress,
)  # fmt: skip

u8, u16, u24 = st.integers(0, 0xFF), st.integers(0, 0xFFFF), st.integers(0, 0xFFFFFF)
phase, bid = st.sampled_from((0, 1, 2, 7)), st.integers(0, 31)
state = st.integers(0, 4)
register = (u16, u8, phase, bid, u24, u8)
KINDS: dict[Any, st.SearchStrategy[Any]] = {
    EmergencyStop: st.builds(
        EmergencyStop, u8, u8, u8, st.integers(0, 15), st.booleans(), u8, u24, st.booleans()
    ),
    StopsHeld: st.builds(StopsHeld, u8, u8, u24, u24),
    HeldReset: st.builds(HeldReset, u24, u8, u8, u24),
    EmergencyReset: st.builds(EmergencyReset, u8, u8, u8, u8, u8, u24),
    OperatorCommand: st.builds(OperatorCommand, st.integers(0, 9), u8, u8, u8, u8, u24),
    OperatorGoal: st.builds(OperatorGoal, u8, u8, st.integers(0, 0x7FFF), st.booleans(), u8, u24),
    OperatorReport: st.builds(
        OperatorReport,
        u8,
        st.integers(0, 15),
        st.sampled_from(ReportKind),
        u16.map(lambda n: n * PLACE_M + LOWEST_M),
        u16.map(lambda n: n * PLACE_M + LOWEST_M),
        u8.map(lambda n: n * PLACE_M),
        u8.map(lambda n: n * PLACE_M),
    ),
    Challenge: st.builds(Challenge, u8, u8, st.integers(0, (1 << 48) - 1)),
    Freshness: st.builds(Freshness, u8, st.integers(0, 0xFFFF_FFFF), u24),
    AllImplementsStop: st.builds(AllImplementsStop, u8, st.integers(0, 3)),
    LeaderElectionVote: st.builds(LeaderElectionVote, u16, u16, u8, u8, u16),
    TaskClaim: st.builds(TaskClaim, *register),
    StateSyncResponse: st.builds(StateSyncResponse, *register),
    StateSyncRequest: st.builds(StateSyncRequest, u24, u24, u8, u8),
    Digests: st.builds(Digests, u8, u8, u16, u16, u16),
    WorkProgress: st.builds(WorkProgress, u16, u8, st.integers(0, (1 << 40) - 1)),
    Accord: st.builds(Accord, u16, st.integers(0, 2), st.integers(0, 2), u16, u16, u8),
    Member: st.builds(Member, u8, u16, u24, u8),
    VectorSlice: st.builds(VectorSlice, u8, st.tuples(*[u8] * 7)),
    FleetStop: st.builds(FleetStop, st.integers(1, 0x7FFF), u8, u8, u8, u24, st.booleans()),
    FleetReset: st.builds(FleetReset, st.integers(1, 0x7FFF), st.integers(0, 1), u8, u8, u8, u24),
    GatewayBeat: st.builds(GatewayBeat, st.integers(124, 127), st.integers(0, 3), u16, u16, u16),
    SegmentSummary: st.builds(
        SegmentSummary, st.integers(1, 0x7FFF), u8, u8, u8, st.integers(0, 250), u16
    ),
    AddressClaimed: st.builds(AddressClaimed, st.integers(0, (1 << 64) - 1)),
    Request: st.builds(Request, u24),
    Acknowledgment: st.builds(Acknowledgment, st.integers(0, 3), u8, u8, u24),
    TransportManagement: st.builds(TransportManagement, u8, st.binary(min_size=4, max_size=4), u24),
    TransportData: st.builds(TransportData, u8, st.binary(min_size=7, max_size=7)),
}


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
@given(data=st.data(), source=u8)
def test_there_and_back(kind: Any, data: st.DataObject, source: int) -> None:
    message = data.draw(KINDS[kind])
    frame = encode(message, source)
    assert len(frame.data) == next(g.length for g in GROUPS if g.kind is kind)
    assert decode(frame) == (source, message)


@given(
    st.floats(-3276, 3276), st.floats(-3276, 3276), st.floats(0, 6.28), st.floats(0, 12.7), state,
    st.booleans(), u8,
)  # fmt: skip
def test_pose_is_right_to_its_resolution(
    x_m: float, y_m: float, course_rad: float, speed_m_s: float, now: int, stopped: bool, heard: int
) -> None:
    pose = Pose(x_m, y_m, course_rad, speed_m_s, now, stopped, heard)
    source, back = decode(encode(pose, 7))
    assert isinstance(back, Pose) and source == 7
    assert abs(back.x_m - x_m) <= 0.026 and abs(back.y_m - y_m) <= 0.026
    assert abs(back.speed_m_s - speed_m_s) <= 0.026
    turn = (back.course_rad - course_rad + 3.14159) % 6.28318 - 3.14159
    assert abs(turn) <= 0.0063
    assert back[4:] == (now, stopped, heard)


@given(u8, state, st.booleans(), st.integers(0, 250), u16, u24)
def test_heartbeat(
    counter: int, now: int, flag: bool, health: int, operations: int, digest: int
) -> None:
    beat = Heartbeat(counter, now, flag, not flag, flag, not flag, health / 250, operations, digest)
    assert decode(encode(beat, 1))[1] == beat


@given(st.integers(0, (1 << 32) - 1), st.binary(max_size=64))
def test_decode_never_raises(identifier: int, data: bytes) -> None:
    decode(Frame(identifier, data))


@given(st.sampled_from(GROUPS), st.binary(min_size=8, max_size=8))
def test_any_payload_of_a_known_kind_is_read_or_counted(group: Any, data: bytes) -> None:
    _, message = decode(Frame(6 << 26 | group.pgn << 8 | 0x80, data[: group.length]))
    if isinstance(message, Malformed):
        assert message.reason == "range"


@given(st.floats(-3276, 3276), st.floats(-3276, 3276))
def test_a_place_in_two_frames_is_right_to_its_resolution(x_m: float, y_m: float) -> None:
    east, north = goal_frames(3, 249, x_m, y_m)
    assert not east.north and north.north
    assert abs(east.metres - x_m) <= 0.11 and abs(north.metres - y_m) <= 0.11


def test_reasons_are_few() -> None:
    assert decode(Frame(0x18123456, b""))[1] == Malformed("unknown PGN")
    assert decode(Frame(0x18FF1080, b"short"))[1] == Malformed("length")
    assert decode(Frame(0x18FF0880, b"\0\0\0\x05\0\0\0\0"))[1] == Malformed("range")


def test_golden_bytes() -> None:
    """The layout, once by hand, so that a change of it is seen."""
    claim = encode(TaskClaim(0x0102, 3, 2, 5, 0x040506, 7), 0x81)
    assert claim == Frame(0x10FF0881, bytes.fromhex("02 01 03 2A 06 05 04 07".replace(" ", "")))
    stop = encode(EmergencyStop(1, 2, 3, 1, True, 4, 0x0A0B0C), 0x80)
    assert stop == Frame(0x00FF0080, bytes.fromhex("0102031104 0C0B0A".replace(" ", "")))
    aiso = encode(AllImplementsStop(9, 0), 0x80)
    assert aiso == Frame(0x0CFD0280, bytes.fromhex("FFFFFFFFFFFF09FC"))
