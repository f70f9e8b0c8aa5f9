"""A live bus for a day: memory that does not grow, and a past that can still be looked at."""

from math import cos, sin
from random import Random

import numpy as np
import pytest
import shapely

from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Member, Pose
from protocol.frames.frame import Frame
from sim.record import live_recording
from sim.record.live_recording import LiveRecording, NoteRing
from sim.world.ground_truth import EVEN_M, Track
from tools.livemap.playback import AGES, EVENTS_MAX, SNAPSHOT_US, Index, Player

S = 1_000_000
DAY_S = 86_400
STEP_S = 2  # between two frames of this quiet bus


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_recording, "FRAMES", 1000)
    monkeypatch.setattr(live_recording, "FINE_BYTES", 20_000)
    monkeypatch.setattr(live_recording, "FINE_ROWS", 300)


def test_the_newest_frames_are_kept_in_a_ring() -> None:
    recording = LiveRecording()
    for k in range(2500):
        recording.write(k * 1000, Frame(0x18FF1080 + k % 7, bytes([k % 256] * (k % 9))))
        assert recording.end_at_us == k * 1000 and recording.count == k + 1
    assert (recording.first, recording.begin_at_us) == (1500, 1_500_000)
    for k in range(recording.first, recording.count):
        wanted = Frame(0x18FF1080 + k % 7, bytes([k % 256] * (k % 9)))
        assert recording[k] == (k * 1000, wanted) and recording.t_us(k) == k * 1000


def test_a_ring_of_notes_holds_the_newest_that_fit() -> None:
    seed = 5
    rng, ring, all_of_it = Random(seed), NoteRing(2000, 40), []
    t_us = 0
    for k in range(3000):
        t_us += rng.randrange(3)
        note = {"slot": k, "path": [rng.random() for _ in range(rng.randrange(8))]}
        ring.append(t_us, note)
        all_of_it.append((t_us, note))
        kept = ring.count - ring.first
        assert 0 < kept <= 40
        if k % 50 == 0:
            assert ring.between(-1, t_us) == all_of_it[-kept:], f"seed {seed}, {k}"
            assert ring.between(t_us - 3, t_us - 1) == [
                each for each in all_of_it[-kept:] if t_us - 3 < each[0] <= t_us - 1
            ]
    before = ring.count
    ring.append(t_us, {"too": [rng.random() for _ in range(1000)]})
    assert ring.count == before


@pytest.mark.slow
def test_a_day_of_a_live_bus_is_kept_in_fixed_memory() -> None:
    """It was 13 GB: every intent and a snapshot each ten seconds, for good."""
    recording = LiveRecording()
    index, now_us = Index(recording), 0
    recording.follow(lambda: now_us)
    member, pose = Member(3, 1, 0), Pose(0.0, 0.0, 0.0, 1.0, 3, False, 255)
    recording.write(0, encode(member, 0x80))
    sizes = []
    for k in range(1, DAY_S // STEP_S):
        now_us = k * STEP_S * S
        recording.write(now_us, encode(pose._replace(x_m=k % 3000 * 1.0), 0x80))
        recording.tell(now_us, {"slot": 3, "path": [[k, 1.5], [k, 2.5]]})
        if k % 5 == 0:
            index.work(1.0)
        if k % 1800 == 0:
            sizes.append((len(index.snapshots), sum(len(s.state) for s in index.snapshots)))
    assert sizes[-1][0] < 2 * sizes[0][0] + 100 and sizes[-1][0] < 300, sizes
    assert sizes[-1][1] < 1_000_000 and len(recording.intents) == 0
    assert len(index.events) == EVENTS_MAX < index.noted, "it falls silent between two poses"
    assert recording.count - recording.first == 1000
    assert index.begin_at_us <= SNAPSHOT_US + STEP_S * S, "the first minute can be looked at"
    player = Player(index, False, 1.0)
    for t_us in (now_us // 4, now_us // 2, now_us - 3600 * S, now_us - 100 * S, now_us):
        player.playing = False
        player.seek(t_us)
        player.advance(0.0, 1e9)
        assert player.caught_up and player.head_us == t_us
        seen_s = player.watcher.robots[3].last_s
        age_s = (now_us - t_us) / S
        assert 0 <= t_us / S - seen_s <= 2 * age_s / AGES + SNAPSHOT_US / S + STEP_S
        assert player.watcher.robots[3].x_m == pytest.approx(seen_s / STEP_S % 3000, abs=0.1)
        assert 3 in player.watcher.intents or age_s > 3000
    player.seek(now_us - 4 * 3600 * S)
    player.playing, player.speed = True, 256.0
    for _ in range(2000):  # from snapshot to snapshot, then frame by frame
        player.advance(0.1, 1e9)
        assert player.caught_up
    assert player.watcher.robots[3].last_s == pytest.approx(now_us / S, abs=STEP_S)


def test_the_track_of_a_launch_keeps_turns_and_leaves_out_straights() -> None:
    """Ten points a second for each of ten robots were 276 MB a day."""
    seed = 3
    rng, every, few = Random(seed), Track(), Track(straight_m=0.02)
    x_m = y_m = course = 0.0
    told: list[float] = []
    for k in range(20_000):
        if k % 300 < 30:  # a turn
            course += 0.1
        step_m = 0.25 + rng.gauss(0.0, 0.01)  # no drive is even
        x_m, y_m = x_m + step_m * cos(course), y_m + step_m * sin(course)
        if k % 1000 > 950:  # back the way it came
            x_m, y_m = x_m - 2 * step_m * cos(course), y_m - 2 * step_m * sin(course)
        tool_on = k % 700 > 50
        for track in (every, few):
            track.add(k * 100_000, x_m, y_m, tool_on)
        if rng.random() < 0.1:  # what was written to a disk does not change after that
            told += few.settled_from(len(told) // 4)
    assert few.driven_m == pytest.approx(every.driven_m)
    assert len(few) < 0.25 * len(every)
    told += few.settled_from(len(told) // 4)
    assert told + few.newest == few.to_array().ravel().tolist()
    was, kept = every.to_array(), few.to_array()
    there = np.stack([np.interp(was[:, 0], kept[:, 0], kept[:, axis]) for axis in (1, 2)], axis=1)
    late_m = np.hypot(*(there - was[:, 1:3]).T)
    assert late_m.max() <= EVEN_M + 0.02 + 1e-9, f"seed {seed}"
    off_m = shapely.distance(shapely.LineString(kept[:, 1:3]), shapely.points(was[:, 1:3]))
    assert off_m.max() <= 2 * 0.02, f"seed {seed}"
    at = np.searchsorted(kept[:, 0], was[:, 0], side="right") - 1
    assert (kept[at, 3] == was[:, 3]).all(), "switches of the implement stay"
