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


def test_a_clock_that_is_set_in_a_log_does_not_fill_the_memory_of_the_map() -> None:
    recording = Recording()
    set_at_us = 1_700_000_000_000_000
    for slot in (0, 1):
        recording.write(0, encode(Member(slot, 1, 0), 0x80 + slot))
        beats(recording, slot, 1_000, 2_000_000)
    beats(recording, 0, set_at_us, set_at_us + 2_000_000)
    index = Index(recording)
    for _ in range(20):
        index.work(0.05)
    assert index.complete and len(index.snapshots) < 10
    told = [event.text for event in index.events]
    assert told == ["robot 0 falls silent", "robot 1 falls silent", "robot 0 is heard again"]
    assert index.events[-1].at_s == pytest.approx(set_at_us / 1e6, abs=0.6)


def test_intents_while_the_bus_is_silent_are_looked_at() -> None:
    recording = Recording()
    for slot in (0, 1):
        recording.write(0, encode(Member(slot, 1, 0), 0x80 + slot))
        beats(recording, slot, 1_000, 2_000_000)
    for at_us in range(100_000_000, 104_000_000, 200_000):
        for slot in (0, 1):
            recording.tell(at_us, {"slot": slot, "hears": []})
    beats(recording, 0, 200_000_000, 201_000_000)
    index = Index(recording)
    index.work(1e9)
    assert "bus split: 0 | 1" in [event.text for event in index.events]
