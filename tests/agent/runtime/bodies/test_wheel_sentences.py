"""Sentences to a wheel controller: what is packed is read, by us and by the simulated machine."""

from hypothesis import given
from hypothesis import strategies as st

from agent.motion.wheel_kinematics import WheelSpeeds
from agent.runtime.bodies.wheel_sentences import WheelSentence, pack, unpack
from sim.machines.nmea_machine import _told

number = st.floats(-99.0, 99.0).map(lambda value: round(value, 4))
sentences = st.builds(
    WheelSentence, st.integers(0, 999), st.integers(0, 1000), st.booleans(),
    st.builds(WheelSpeeds, st.lists(number, min_size=1, max_size=4).map(tuple), number),
)  # fmt: skip


@given(sentences)
def test_a_packed_sentence_is_read(sentence: WheelSentence) -> None:
    line = pack(sentence)
    assert len(line) <= 82, "the longest sentence of NMEA 0183"
    assert unpack(line.rstrip()) == sentence
    wheels, steer_rad = list(sentence.speeds.wheels_rad_s), sentence.speeds.steer_rad
    told = sentence.life_for_ms / 1000, sentence.implement, steer_rad, wheels
    assert _told(line.rstrip(), len(wheels)) == told


@given(sentences, st.integers(0, 81), st.integers(1, 255))
def test_a_sentence_with_a_wrong_byte_is_none(
    sentence: WheelSentence, at: int, change: int
) -> None:
    line = bytearray(pack(sentence).rstrip())
    line[at % len(line)] ^= change
    assert unpack(bytes(line)) is None


@given(st.binary(max_size=120))
def test_no_bytes_are_an_exception(line: bytes) -> None:
    assert unpack(line) is None
