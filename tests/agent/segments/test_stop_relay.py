"""For how long a gateway repeats a stop of another segment to the robots of its own."""

from agent.interface.config import MS, S
from agent.segments.stop_relay import AGAIN_US, DOTS_MAX, LIVE_US, StopRelay
from crdt.stops import RemoteStopDot
from protocol.fleet_tags import plain_reset
from protocol.frames.segment_frames import FleetReset, FleetStop

ROBOT = 0x80  # bus address
STOP = FleetStop(segment=1, slot=3, incarnation=1, counter=1)
NEW = STOP._replace(incarnation=99)
BEAT_US = 100 * MS


def sent(relay: StopRelay, begins_at_us: int, for_us: int, beats: bool) -> int:
    """How many stops are sent; with `beats` to a robot that drives on."""
    frames = 0
    for now_us in range(begins_at_us, begins_at_us + for_us, MS):
        if beats and now_us % BEAT_US == 0:
            relay.on_pose(ROBOT, False, now_us)
        frames += len(relay.on_tick(now_us))
    return frames


def dot_of(m: FleetStop | FleetReset) -> RemoteStopDot:
    return RemoteStopDot(m.slot, m.incarnation, m.counter, m.segment)


def relay_with_stop() -> StopRelay:
    relay = StopRelay(2, 0)
    relay.leads = True
    relay.on_backbone_stops([STOP], 0)
    return relay


def test_a_stop_that_came_while_no_robot_was_heard_is_sent_to_the_first_one_that_drives() -> None:
    """The gateway was off its bus for a few seconds, or the robots were switched off."""
    relay = relay_with_stop()
    assert sent(relay, 0, 4 * S, beats=False)
    assert sent(relay, 4 * S, AGAIN_US, beats=True), "it does not know the stop"


def test_a_stop_that_no_robot_obeys_is_not_sent_for_good() -> None:
    """A press with a wrong tag, or one that the robots know as cleared."""
    relay = relay_with_stop()
    assert sent(relay, 0, 4 * S, beats=True)
    assert not sent(relay, 4 * S, 4 * S, beats=True)
    assert not sent(relay, 8 * S + 2 * LIVE_US, 4 * S, beats=True)


def test_old_stops_that_are_told_are_said_after_their_resets_and_not_for_long() -> None:
    """A gateway that restarts is told all stops there ever were. It said each for 2 s, and all resets
    after that, so the reset of a stop that holds the robots now waited for minutes."""
    relay = StopRelay(2, 0)
    relay.leads = True
    old = [STOP._replace(counter=count, told=True) for count in range(1, 11)]
    relay.on_backbone_stops(old, 0)
    relay.on_backbone_resets([half for stop in old for half in plain_reset(dot_of(stop))], MS)
    now = STOP._replace(counter=99)
    relay.on_backbone_stops([now], 10 * MS)
    relay.on_backbone_resets(plain_reset(dot_of(now)), 20 * MS)
    reset, last_at_us = set[RemoteStopDot](), 0
    for now_us in range(0, 8 * S, MS):
        if now_us % BEAT_US == 0:
            relay.on_pose(ROBOT, False, now_us)
        for said in relay.on_tick(now_us):
            last_at_us = now_us
            if isinstance(said, FleetReset):
                reset.add(dot_of(said))
            elif said.told:
                assert dot_of(said) in reset, "else it would latch a robot that knows neither"
    assert len(reset) == len(old) + 1 and last_at_us < 4 * S


def test_a_cleared_stop_stays_cleared_whatever_resets_follow() -> None:
    """Each half of a reset of an unknown stop took the room of a known one. Without its reset a stop of
    long ago was told again, and latched a robot that had never heard of it."""
    relay = relay_with_stop()
    relay.on_backbone_resets(plain_reset(dot_of(STOP)), MS)
    assert sent(relay, 0, 4 * S, beats=False)
    for k in range(DOTS_MAX + 1):
        unknown = RemoteStopDot(9, k >> 8, k & 0xFF, 3)
        relay.on_reset(plain_reset(unknown)[0])
    assert len(relay.resets) == DOTS_MAX
    assert not sent(relay, 4 * S, 4 * S, beats=True)


def test_a_stop_is_carried_though_its_name_was_said_with_another_tag_before() -> None:
    """The next name of a robot is known. A device without keys said it once in advance, and the stop that
    the robot pressed then reached no other segment."""
    false, true = STOP._replace(tag=1), STOP._replace(tag=2)
    near, far = StopRelay(1, 0), StopRelay(2, 0)
    near.leads = far.leads = True
    for at_us, stop in ((0, false), (10 * S, true)):
        carried = near.on_stop(ROBOT, stop, at_us)
        assert carried == [stop]
        far.on_backbone_stops(carried, at_us)
    said = [m for now_us in range(0, 13 * S, MS) for m in far.on_tick(now_us)]
    assert {m.tag for m in said if isinstance(m, FleetStop)} == {1, 2}
    assert near.digest == far.digest, "nothing has to be told again"
    resets = plain_reset(dot_of(STOP))
    for half in resets:
        near.on_reset(half)
    far.on_backbone_resets(resets, 20 * S)
    assert sent(far, 21 * S, 4 * S, beats=True) == 2 * len(resets), "one reset clears the name"


def test_gateways_that_have_forgotten_other_stops_of_long_ago_have_nothing_to_tell() -> None:
    """Each forgets what was the oldest to it. They told each other all stops once a second for good, said
    the forgotten ones again on their buses, and forgot the next ones for these."""
    old = [STOP._replace(incarnation=k >> 8, counter=k & 0xFF) for k in range(DOTS_MAX)]
    near, far = StopRelay(1, 0), StopRelay(2, 0)
    for relay, stops in ((near, old), (far, [old[1], old[0], *old[2:]])):
        for k, stop in enumerate(stops):
            relay.on_stop(ROBOT, stop, k * S)
            for half in plain_reset(dot_of(stop)):
                relay.on_reset(half)
    for relay in (near, far):
        relay.on_stop(ROBOT, NEW, DOTS_MAX * S)
    assert near.stops.keys() != far.stops.keys()
    assert near.digest == far.digest
    for half in plain_reset(dot_of(NEW)):
        near.on_reset(half)
    assert near.digest != far.digest, "a reset is missing where the stop is active"


def test_the_digest_is_that_of_what_is_kept_now() -> None:
    """It is kept between two changes, because each summary of another segment is compared with it."""
    relay = relay_with_stop()
    for count in range(1, 40):
        stop = STOP._replace(counter=count)
        relay.on_stop(ROBOT, stop, count * S)
        if count % 3:
            for half in plain_reset(dot_of(stop))[: count % 3]:
                relay.on_reset(half)
        if count % 5 == 0:
            relay.on_backbone_resets(plain_reset(dot_of(NEW)._replace(counter=count)), count * S)
        kept, relay._digest = relay.digest, None
        assert relay.digest == kept, count


def test_resets_that_wait_to_be_said_are_limited() -> None:
    """Another segment, or what speaks for it, could fill the memory of a gateway."""
    relay = StopRelay(2, 0)
    for count in range(1, 3 * DOTS_MAX):
        relay.on_backbone_resets(plain_reset(dot_of(STOP._replace(counter=count))), 0)
    waiting = 0
    while relay.due_at_us < 10**15:
        waiting += len(relay.on_tick(relay.due_at_us)) // 2
    assert waiting == 2 * DOTS_MAX and relay.refused
