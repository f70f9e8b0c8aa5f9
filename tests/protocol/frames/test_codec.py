"""Every frame kind there and back; any frame at all without an exception."""

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from protocol.frames.agreement_frames import FALLEN, SilentPosition
from protocol.frames.codec import Malformed, decode, encode
from protocol.frames.fleet_frames import POSE, Heartbeat, Pose
from protocol.frames.frame import Frame
from protocol.frames.messages import GROUPS
from protocol.frames.operator_frames import (
    goal_frames,
)
from protocol.frames.safety_frames import (
    AllImplementsStop,
    EmergencyStop,
)  # fmt: skip
from protocol.frames.work_frames import (
    TaskClaim,
)  # fmt: skip

u8, u16, u24 = st.integers(0, 0xFF), st.integers(0, 0xFFFF), st.integers(0, 0xFFFFFF)
state = st.integers(0, 4)


@given(
    st.floats(-3276, 3276), st.floats(-3276, 3276), st.floats(0, 6.28), st.floats(0, 12.7), state,
    st.booleans(), u8, st.booleans(),
)  # fmt: skip
def test_pose_is_right_to_its_resolution(
    x_m: float, y_m: float, course_rad: float, speed_m_s: float, now: int, stopped: bool,
    heard: int, at_work: bool,
) -> None:  # fmt: skip
    pose = Pose(x_m, y_m, course_rad, speed_m_s, now, stopped, heard, at_work)
    source, back = decode(encode(pose, 7))
    assert isinstance(back, Pose) and source == 7
    assert abs(back.x_m - x_m) <= 0.026 and abs(back.y_m - y_m) <= 0.026
    assert abs(back.speed_m_s - speed_m_s) <= 0.026
    turn = (back.course_rad - course_rad + 3.14159) % 6.28318 - 3.14159
    assert abs(turn) <= 0.0063
    assert back[4:] == (now, stopped, heard, at_work)


@given(st.integers(0, (1 << 17) - 1), st.integers(0, (1 << 17) - 1))
def test_a_silent_position_is_decoded_as_the_pose_that_it_repeats(x: int, y: int) -> None:
    pose = POSE.unpack((x | y << 17).to_bytes(8, "little"))
    repeated = FALLEN.unpack(FALLEN.pack(SilentPosition(pose.x_m, pose.y_m, 1, 2)))
    assert repeated[:2] == pose[:2]


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
