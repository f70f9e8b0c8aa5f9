"""Which differences between two looks at a bus are events of the map's list."""

import pytest

from crdt.claim_register import Phase
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member
from protocol.frames.work_frames import TaskClaim
from sim.record.recording import Recording
from tools.livemap.playback import Index

BEAT_US = 100_000


def beats(recording: Recording, slot: int, begin_at_us: int, end_at_us: int) -> None:
    for at_us in range(begin_at_us, end_at_us, BEAT_US):
        beat = Heartbeat(slot, 1, False, False, True, False, 1.0, 0, 0)
        recording.write(at_us, encode(beat, 0x80 + slot))


def test_a_silence_and_the_takeover_of_a_section_are_told() -> None:
    recording = Recording()
    for slot in (0, 1):
        recording.write(0, encode(Member(slot, 1, 0), 0x80 + slot))
    recording.write(1_000, encode(TaskClaim(7, 1, Phase.STARTED, 9, 1, 1), 0x81))
    beats(recording, 1, 2_000, 2_000_000)
    beats(recording, 0, 2_000_000, 6_000_000)
    recording.write(6_000_000, encode(TaskClaim(7, 2, Phase.CLAIMED, 9, 2, 0), 0x80))
    beats(recording, 0, 6_100_000, 7_000_000)
    beats(recording, 1, 7_000_000, 7_500_000)
    beats(recording, 0, 7_500_000, 8_300_000)
    index = Index(recording)
    index.work(1e9)
    told = [event.text for event in index.events]
    wanted = [
        "robot 1 falls silent",
        "robot 0 takes S7 over from robot 1",
        "robot 1 is heard again",
    ]
    assert [text for text in told if text in wanted] == wanted, told
    silent = next(event for event in index.events if event.text == wanted[0])
    assert silent.at_s == pytest.approx(1.9, abs=0.2), "when it was heard last"
