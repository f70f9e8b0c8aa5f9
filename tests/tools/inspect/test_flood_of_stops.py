"""Stops with forged names: a listener keeps those that it shows, counts the others, and stays quick."""

from random import Random

from agent.peer.leader_election import OPERATOR_GATEWAY
from protocol.frames.codec import encode
from protocol.frames.delivery_frames import TASK_NUMBERS, TaskOrder
from protocol.frames.fleet_frames import LeaderElectionVote, Member
from protocol.frames.safety_frames import EmergencyReset, EmergencyStop, HeldReset, Reason
from sim.record.live_recording import LiveRecording
from tools.inspect.inspector import (
    CLEARED_MAX,
    LATCHED_TOLD,
    STOPS_MAX,
    TERMS_MAX,
    Inspector,
    latched_words,
)
from tools.inspect.measured_inspector import PRESSES_MAX, MeasuredInspector
from tools.livemap.map_state import Watcher
from tools.livemap.page_updates import FIRST_STOPS_TOLD, NEWEST_STOPS_TOLD, PageUpdates
from tools.livemap.playback import Index, Player

FLOOD = 3_000
HONEST = (3, 7, 1)
STRANGER = 0xC8  # the bus address of a device that forges


def press(heard: Inspector, t_s: float, dot: tuple[int, int, int]) -> None:
    heard.hear(t_s, encode(EmergencyStop(*dot, Reason.PERSON_IN_FIELD), STRANGER))


def flooded(heard: Inspector) -> None:
    """An honest stop, and then forged ones; each is said twice."""
    press(heard, 0.5, HONEST)
    for k in range(2 * FLOOD):
        press(heard, 1.0 + k / 1_900, (100 + k % FLOOD // 256, k % FLOOD & 0xFF, 9))


def test_a_flood_of_forged_stops_is_counted_and_pushes_out_no_shown_one() -> None:
    heard = Inspector()
    flooded(heard)
    assert len(heard.stops) == STOPS_MAX and heard.latched[0] == HONEST
    assert len(heard.latched) + heard.latched_more == FLOOD + 1
    told = latched_words(heard.to_dict())
    assert told.startswith("3.7.1, ") and told.count(",") == LATCHED_TOLD
    assert told.endswith(f" and {FLOOD + 1 - LATCHED_TOLD:,} more")


def test_a_reset_clears_the_stops_without_a_name_too() -> None:
    heard = Inspector()
    flooded(heard)
    beyond = (100 + (FLOOD - 1) // 256, (FLOOD - 1) & 0xFF, 9)
    heard.hear(9.0, encode(EmergencyReset(*beyond, 0), STRANGER))
    assert len(heard.latched) + heard.latched_more == FLOOD
    heard.hear(9.1, encode(HeldReset(255, 0), STRANGER))
    assert not heard.latched and not heard.latched_more and not latched_words(heard.to_dict())
    press(heard, 9.2, (3, 7, 2))
    assert heard.latched == [(3, 7, 2)], "the next one has its name again"


def test_resets_of_stops_that_nobody_heard_are_forgotten_and_no_heard_one_holds_again() -> None:
    heard = Inspector()
    press(heard, 0.5, HONEST)
    heard.hear(0.6, encode(EmergencyReset(*HONEST, 0), STRANGER))
    for k in range(3 * CLEARED_MAX):
        heard.hear(1.0 + k / 1_900, encode(EmergencyReset(200, k >> 8, k & 0xFF, 0), STRANGER))
        assert len(heard.cleared) <= CLEARED_MAX
    assert not heard.latched


def test_a_picture_of_a_flood_of_stops_names_few_and_tells_how_many() -> None:
    recording = LiveRecording(None)
    recording.follow(lambda: 5_000_000)
    player = Player(Index(recording), True, 1.0)
    player.reader.watcher = watcher = Watcher(None)
    watcher.hear(0.1, encode(Member(3, 7, 0), 3))
    flooded(watcher)
    stop = PageUpdates(player).tell()["stop"]
    assert stop["latched"][0]["dot"] == "3.7.1"
    assert len(stop["latched"]) == FIRST_STOPS_TOLD + NEWEST_STOPS_TOLD
    assert len(stop["latched"]) + stop["more"] == FLOOD + 1
    assert len(watcher.reasons) <= 2 * STOPS_MAX


def test_a_flood_of_stops_is_not_measured_one_by_one() -> None:
    """Each frame of it looked at each press of the last ten seconds."""
    heard = MeasuredInspector()
    flooded(heard)
    assert len(heard._presses) <= PRESSES_MAX


def test_forged_terms_and_tasks_are_not_kept_without_limit() -> None:
    heard, rng = Inspector(), Random(1)
    heard.hear(0.0, encode(Member(3, 7, 0), 3))
    heard.hear(0.1, encode(LeaderElectionVote(OPERATOR_GATEWAY, 5, 3), 3))
    for k in range(FLOOD):
        heard.hear(1.0 + k / 1_900, encode(LeaderElectionVote(7, k, 3), 3))
        heard.hear(1.0 + k / 1_900, encode(TaskOrder(rng.randrange(1 << 16), 1, 2), STRANGER))
    assert len(heard.votes) == TERMS_MAX and (OPERATOR_GATEWAY, 5) in heard.votes
    assert heard.transports and all(task < TASK_NUMBERS for task in heard.transports)
