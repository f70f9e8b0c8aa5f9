"""Several segments in one event loop: stops, cuts, gateways that die, borders, forged messages."""

from collections.abc import Iterator
from random import Random

import can
import numpy as np
import pytest

from agent.interface.identity import SilencePolicy
from agent.peer.inputs import ClaimSection, Heard, ManualReset, Press, Start
from agent.segments.fleet_stops import FleetStops
from agent.segments.gateway import Publish
from agent.segments.segment_parts import remote_segments_of
from crdt.occupancy import Geometry
from crdt.stops import RemoteStopDot
from protocol import backbone_messages as backbone
from protocol.authentication import Keys
from protocol.backbone_messages import BackboneHeader, BackboneKind
from protocol.fleet_tags import plain_reset
from protocol.frames.codec import encode
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import EmergencyReset, EmergencyStop, Reason
from protocol.frames.segment_frames import GATEWAY_ADDRESS, FleetReset, FleetStop
from protocol.links.bus import CanBus
from protocol.name import tool_name
from sim.rigs.segments_rig import SegmentFleet
from tools.operate.operator_device import Operator

S = 1_000_000
SEED = 7
KEYS = Keys(b"m" * 16, b"o" * 16)
OPERATOR = 200


@pytest.fixture
def fleet() -> Iterator[SegmentFleet]:
    made = SegmentFleet(3, 3, SEED)
    assert made.run(8 * S, lambda: made.joined), f"seed {SEED}"
    made.run(S)  # the robots have heard of it
    yield made
    made.end()


def press(fleet: SegmentFleet, number: int, slot: int = 0) -> None:
    fleet.runners[number, slot].operate(Press(Reason.PERSON_IN_FIELD))


def all_latched(fleet: SegmentFleet, *numbers: int) -> bool:
    return all(p.safety.latched for k in numbers or fleet.segments for p in fleet.peers(k))


def test_a_stop_pressed_anywhere_stops_everyone_everywhere(fleet: SegmentFleet) -> None:
    at_us = fleet.event_loop.now_us()
    press(fleet, 2)
    assert fleet.run(60_000, lambda: all_latched(fleet)), f"seed {SEED}"
    assert fleet.event_loop.now_us() - at_us <= 60_000
    fleet.count_from_here()
    fleet.run(3 * S)
    assert max(ours for _, ours in fleet.share.values()) < 0.05, "no echo goes round"


def test_a_reset_where_it_was_pressed_holds_everywhere(fleet: SegmentFleet) -> None:
    press(fleet, 1, 1)
    assert fleet.run(S, lambda: all_latched(fleet))
    dot = next(iter(fleet.peer(1, 0).safety.stops.active))
    tool = AddressClaimed(tool_name(OPERATOR).pack())
    for slot in range(3):
        fleet.runners[1, slot].operate(Heard(249, tool))
        fleet.runners[1, slot].operate(Heard(249, EmergencyReset(*dot, OPERATOR)))
    held = [peer for k in fleet.segments for peer in fleet.peers(k)]
    assert fleet.run(S, lambda: not any(p.safety.far.latched for p in held)), f"seed {SEED}"
    assert all(peer.safety.manual_reset(0) for peer in held)


def test_an_operator_clears_what_was_pressed_elsewhere(fleet: SegmentFleet) -> None:
    """An operator's device of segment 3 asks what holds the robots, and clears it for all segments."""
    press(fleet, 1)
    assert fleet.run(S, lambda: all_latched(fleet))
    bus = CanBus(can.Bus(interface="fieldbus", channel=fleet.channel(3)))
    operator = Operator(bus, None)
    bus.subscribe(lambda frame: operator.hear(fleet.event_loop.now_us() / 1e6, frame))
    operator.ask_stops()
    assert fleet.run(S, lambda: bool(operator.shown.far)), f"seed {SEED}"
    for far in operator.shown.far:
        operator.clear_far(far)
    held = [peer.safety for k in fleet.segments for peer in fleet.peers(k)]
    assert fleet.run(S, lambda: not any(s.far.latched or s.stops.latched for s in held))
    bus.close()


def test_a_cut_segment_knows_that_it_is_alone_and_hears_after_the_heal(fleet: SegmentFleet) -> None:
    fleet.backbone.cut({1}, {2, 3})
    assert fleet.run(6 * S, lambda: all(remote_segments_of(p).alone for p in fleet.peers(1))), (
        f"seed {SEED}"
    )
    assert not any(remote_segments_of(p).alone for k in (2, 3) for p in fleet.peers(k))
    assert all(peer.safety.may_move for peer in fleet.peers(1)), "the policy is to go on"
    press(fleet, 1)
    fleet.run(S)
    assert all_latched(fleet, 1) and not any(p.safety.latched for p in fleet.peers(2))
    fleet.backbone.heal()
    assert fleet.run(5 * S, lambda: all_latched(fleet)), "told by comparing digests"
    assert fleet.run(3 * S, lambda: not any(remote_segments_of(p).alone for p in fleet.peers(1)))


def test_the_policy_may_be_to_stand_while_alone() -> None:
    fleet = SegmentFleet(2, 2, SEED, candidates=1, policy=SilencePolicy.STOP)
    assert fleet.run(8 * S, lambda: fleet.joined)
    fleet.run(S)
    assert all(peer.safety.may_move for peer in fleet.peers(1))
    fleet.backbone.cut({1}, {2})
    assert fleet.run(6 * S, lambda: not any(p.safety.may_move for p in fleet.peers(1)))
    fleet.backbone.heal()
    assert fleet.run(3 * S, lambda: all(p.safety.may_move for p in fleet.peers(1))), f"seed {SEED}"
    fleet.end()


def test_a_link_that_carries_one_way_is_known_and_still_carries_stops(fleet: SegmentFleet) -> None:
    fleet.backbone.deaf = {(1, 2), (1, 3)}  # nothing leaves segment 1
    fleet.run(4 * S)
    leader = fleet.leader(1)
    assert leader is not None
    now_us = fleet.event_loop.now_us()
    assert set(leader.gateway.reach.heard(now_us)) == {2, 3}
    assert leader.gateway.reach.reached(now_us) == []
    assert all(remote_segments_of(peer).alone for peer in fleet.peers(1)), f"seed {SEED}"
    press(fleet, 2)
    assert fleet.run(S, lambda: all_latched(fleet, 1, 2, 3))


def test_work_done_behind_a_one_way_link_is_told_as_soon_as_it_carries_again() -> None:
    """However long that lasted: the other side could begin the finished section meanwhile."""
    fleet = SegmentFleet(2, 2, SEED, candidates=1, home=10)
    assert fleet.run(8 * S, lambda: fleet.joined)
    fleet.backbone.deaf = {(1, 2)}
    fleet.run(4 * S)
    fleet.finish(1, 0, 9)
    fleet.run(70 * S)
    assert not fleet.borders_equal
    fleet.backbone.heal()
    assert fleet.run(5 * S, lambda: fleet.borders_equal), f"seed {SEED}"
    fleet.end()


def test_a_gateway_that_dies_is_replaced_and_takes_no_stop_with_it(fleet: SegmentFleet) -> None:
    dead = fleet.leader(2)
    assert dead is not None
    term = dead.gateway.candidacy.term
    fleet.kill_gateway(dead)
    press(fleet, 3)
    assert fleet.run(60_000, lambda: all_latched(fleet)), "the one that stands by carries stops"
    assert fleet.run(4 * S, lambda: fleet.leader(2) is not None), f"seed {SEED}"
    after = fleet.leader(2)
    assert after is not None and after.gateway.candidacy.term > term, "a later term"
    assert fleet.run(3 * S, lambda: fleet.joined)


def test_all_gateways_of_a_segment_restart_and_are_not_fenced_off(fleet: SegmentFleet) -> None:
    """They remember no term; the other segments do, and say so."""
    leader = fleet.leader(2)
    assert leader is not None
    fleet.kill_gateway(leader)
    assert fleet.run(4 * S, lambda: fleet.leader(2) is not None)
    assert fleet.run(3 * S, lambda: fleet.joined)
    for runner in list(fleet.gateways[2]):
        fleet.kill_gateway(runner)
    fleet.add_gateway(2)
    assert fleet.run(8 * S, lambda: fleet.joined), f"seed {SEED}"


def test_what_is_done_on_both_sides_of_a_cut_is_known_on_both_after_it(fleet: SegmentFleet) -> None:
    fleet.backbone.cut({1}, {2, 3})
    fleet.run(3 * S)
    done = {1: range(35, 40), 2: range(5)}  # each side of the border of 1 and 2, at home
    for k, section in enumerate(done[1]):
        fleet.finish(1, k % 3, section)
        fleet.finish(2, k % 3, done[2][k])
        fleet.run(2 * S)
    assert not fleet.borders_equal
    fleet.backbone.heal()
    assert fleet.run(5 * S, lambda: fleet.borders_equal), f"seed {SEED}"
    for number in (1, 2):
        for peer in fleet.peers(number):
            known = [peer.allocation.phase_of(s).name for s in done[number]]
            assert known == ["DONE"] * 5, "nothing lost"


def test_only_the_home_decides_about_a_section_at_the_border(fleet: SegmentFleet) -> None:
    """A robot of segment 1 and one of segment 2 want the same section of 2 at the same moment."""
    lent = 0  # of segment 2, lent to 1
    here = next(s for s, place in fleet.areas[1].borrowed.items() if place == (2, lent))
    fleet.runners[1, 0].operate(ClaimSection(here, 3))
    fleet.runners[2, 2].operate(ClaimSection(lent, 3))
    fleet.run(2 * S)
    guest, host = fleet.peer(1, 0).claims.current, fleet.peer(2, 2).claims.current
    assert (guest is None) != (host is None), f"one of them has it; seed {SEED}"
    assert fleet.borders_equal
    ties = [g.gateway.border.counts["ties"] for g in fleet.gateways[2]]
    assert sum(ties) > 0, "equal but for the owner: the case that the epoch decides"


def test_a_lent_section_is_not_claimed_by_who_cannot_ask(fleet: SegmentFleet) -> None:
    here = next(iter(fleet.areas[1].borrowed))
    fleet.backbone.cut({1}, {2, 3})
    assert fleet.run(6 * S, lambda: remote_segments_of(fleet.peer(1, 0)).alone)
    fleet.runners[1, 0].operate(ClaimSection(here, 3))
    assert fleet.peer(1, 0).allocation.key(here) is None, f"seed {SEED}"


def test_duplicates_and_loss_on_the_backbone_change_nothing(fleet: SegmentFleet) -> None:
    fleet.backbone.duplicate, fleet.backbone.loss = 0.5, 0.2
    for k in range(5):
        fleet.finish(1, k % 3, 35 + k)
    fleet.count_from_here()
    assert fleet.run(15 * S, lambda: fleet.borders_equal and fleet.event_loop.now_us() > 12 * S)
    assert max(ours for _, ours in fleet.share.values()) < 0.10, f"seed {SEED}"
    press(fleet, 2)
    assert fleet.run(5 * S, lambda: all_latched(fleet))


@pytest.mark.slow
def test_a_flood_from_the_backbone_does_not_fill_the_bus(fleet: SegmentFleet) -> None:
    """Invented stops and invented work of a segment that does not exist."""
    node = fleet.backbone.attach(9)
    fleet.count_from_here()
    for k in range(2_000):
        header = BackboneHeader(BackboneKind.STOPS, 9, 0, 124, 1, k)
        stop = FleetStop(9, k % 100, k >> 8, k & 0xFF)
        node.publish(Publish(BackboneKind.STOPS, backbone.pack(header, (stop,))))
        entry = backbone.Entry(1, 1, k % 40, 9, 1, bytes(8))
        work = backbone.pack(BackboneHeader(BackboneKind.WORK, 9, 0, 124, 1, k), (entry,))
        node.publish(Publish(BackboneKind.WORK, work))
        fleet.run(2_000)
    shares = [ours for _, ours in fleet.share.values()]
    assert max(shares) <= 0.15, f"{shares}, seed {SEED}"
    assert all_latched(fleet), "without keys anybody may stop"


def test_tags_hold_from_end_to_end() -> None:
    fleet = SegmentFleet(2, 2, SEED, candidates=1, keys=KEYS)
    assert fleet.run(8 * S, lambda: fleet.joined)
    forger = fleet.backbone.attach(9)
    stop = FleetStop(2, 1, 1, 1, tag=0xABCDEF)
    forger.publish(
        Publish(
            BackboneKind.STOPS,
            backbone.pack(BackboneHeader(BackboneKind.STOPS, 9, 0, 124, 1, 1), (stop,)),
        )
    )
    fleet.run(200_000)
    assert not fleet.peer(1, 0).safety.latched, "held while it is repeated, never latched"
    assert not fleet.peer(1, 0).safety.may_move
    fleet.run(5 * S)
    assert fleet.peer(1, 0).safety.may_move, f"seed {SEED}"
    press(fleet, 1)
    assert fleet.run(60_000, lambda: all_latched(fleet)), "a true one latches in both"
    dot = next(iter(fleet.peer(2, 0).safety.far.active))
    for part in (0, 1):
        half = FleetReset(dot.segment, part, *dot[:3], half=0x123456)
        head = BackboneHeader(BackboneKind.RESETS, 9, 0, 124, 1, 2 + part)
        forger.publish(Publish(BackboneKind.RESETS, backbone.pack(head, (half,))))
    fleet.run(S)
    assert fleet.peer(2, 0).safety.far.latched, "an invented reset clears nothing"
    tags = next(p for p in fleet.peer(1, 0).parts if isinstance(p, FleetStops)).tags
    assert tags is not None
    halves = tags.reset(dot)
    head = BackboneHeader(BackboneKind.RESETS, 9, 0, 124, 1, 9)
    forger.publish(Publish(BackboneKind.RESETS, backbone.pack(head, halves)))
    fleet.run(S)
    assert not fleet.peer(2, 0).safety.far.latched, "an operator's does"
    assert not fleet.peer(1, 0).safety.stops.latched, "where it was pressed, too"
    fleet.end()


def test_one_map_of_all_segments() -> None:
    """What robots of two segments have seen, cut and together again: the same map, bit for bit."""
    fleet = SegmentFleet(2, 2, SEED, candidates=1, geometry=Geometry(32, 32, (0.0, 0.0), 0.1))
    assert fleet.run(8 * S, lambda: fleet.joined)
    rng = Random(SEED)

    def look(number: int) -> None:
        chart = fleet.peer(number, rng.randrange(2)).named.chart
        assert chart is not None
        chart.see(rng.randrange(64), np.array(rng.choices((0, 1, 2), k=16)), rng.randrange(16))

    def equal() -> bool:
        charts = [p.named.chart for k in fleet.segments for p in fleet.peers(k)]
        maps = {c.chart.serialize() for c in charts if c is not None}
        return len(maps) == 1 and not any(c is not None and c.pending for c in charts)

    fleet.backbone.cut({1}, {2})
    for _ in range(30):
        for number in fleet.segments:
            look(number)
        fleet.run(100_000)
    assert not equal()
    fleet.backbone.heal()
    assert fleet.run(10 * S, equal), f"seed {SEED}"
    fleet.count_from_here()
    for _ in range(20):
        look(1)
        fleet.run(100_000)
    assert fleet.run(5 * S, equal)
    assert max(ours for _, ours in fleet.share.values()) <= 0.15
    fleet.end()


def test_the_same_seed_gives_the_same_run() -> None:
    def run(seed: int) -> list[object]:
        fleet = SegmentFleet(2, 3, seed)
        fleet.run(4 * S)
        press(fleet, 1)
        fleet.run(S)
        said = [sorted(fleet.bits.items()), sorted(fleet.bridged.items()), fleet.halted_at_us]
        fleet.end()
        return [*said, fleet.backbone.messages]

    assert run(5) == run(5)
    assert run(5) != run(6)


PANEL, PANEL_DOT = 150, (140, 1, 1)


def panel_of(fleet: SegmentFleet, number: int) -> CanBus:
    """An emergency stop panel that has claimed an address in a segment."""
    bus = CanBus(can.Bus(interface="fieldbus", channel=fleet.channel(number)))
    bus.send(encode(AddressClaimed(tool_name(PANEL).pack()), PANEL, 255))
    fleet.run(100_000)
    return bus


def clear_here(fleet: SegmentFleet, dot: tuple[int, int, int, int], number: int) -> None:
    """The robots of a segment cleared a stop of any maker; no gateway has heard of it."""

    for slot in range(3):
        for half in plain_reset(RemoteStopDot(*dot)):
            fleet.runners[number, slot].operate(Heard(GATEWAY_ADDRESS, half))


def hold_button(fleet: SegmentFleet, bus: CanBus, for_us: int) -> None:
    """A press, said each 10 ms."""
    end_us = fleet.event_loop.now_us() + for_us
    while fleet.event_loop.now_us() < end_us:
        bus.send(encode(EmergencyStop(*PANEL_DOT, Reason.PERSON_IN_FIELD), PANEL, 255))
        fleet.run(10_000)


def release(fleet: SegmentFleet, dot: tuple[int, ...], bus: CanBus) -> None:
    """An operator's device clears a dot of segment 1 for all segments, then every machine is reset and
    started."""
    for half in plain_reset(RemoteStopDot(dot[0], dot[1], dot[2], 1)):
        bus.send(encode(half, PANEL, 255))
    peers = [peer for k in fleet.segments for peer in fleet.peers(k)]
    cleared = [peer.safety for peer in peers]
    assert fleet.run(S, lambda: not any(s.far.latched or s.stops.latched for s in cleared))
    for runner in fleet.runners.values():
        runner.operate(ManualReset())
    assert fleet.run(5 * S, lambda: fleet.joined), f"seed {SEED}"
    for runner in fleet.runners.values():
        runner.operate(Start())
    assert fleet.run(3 * S, lambda: all(peer.safety.may_move for peer in peers)), f"seed {SEED}"


def test_t5_a_press_elsewhere_with_a_name_that_was_cleared_here_latches(
    fleet: SegmentFleet,
) -> None:
    bus = panel_of(fleet, 1)
    clear_here(fleet, (*PANEL_DOT, 1), 2)
    assert all(p.safety.far.is_cleared(RemoteStopDot(*PANEL_DOT, 1)) for p in fleet.peers(2))
    hold_button(fleet, bus, 60_000)
    assert all_latched(fleet, 1, 3), f"seed {SEED}"
    assert not any(p.safety.may_move for p in fleet.peers(2)), "it brakes at once"
    hold_button(fleet, bus, 200_000)
    assert all_latched(fleet, 2), f"seed {SEED}"
    fleet.run(3 * S)
    assert all_latched(fleet), "and stays so, under a name of its own"
    bus.close()


def test_t5_a_press_with_a_name_that_the_gateways_know_as_cleared_is_carried(
    fleet: SegmentFleet,
) -> None:
    bus = panel_of(fleet, 1)
    hold_button(fleet, bus, 60_000)
    assert all_latched(fleet)
    release(fleet, PANEL_DOT, bus)
    peers = [peer for k in fleet.segments for peer in fleet.peers(k)]
    for peer in fleet.peers(1):  # those have lost their memory of it: to them it is a new press
        peer.safety.stops = type(peer.safety.stops)()
    hold_button(fleet, bus, 60_000)
    assert not any(p.safety.may_move for p in peers), "it brakes everywhere"
    hold_button(fleet, bus, 300_000)
    assert all_latched(fleet), f"seed {SEED}"
    bus.close()


def test_t5_an_old_stop_that_a_new_gateway_is_told_stops_nobody(fleet: SegmentFleet) -> None:
    """A gateway that restarts is told all stops there ever were, and says those that it did not know."""
    press(fleet, 1)
    assert fleet.run(S, lambda: all_latched(fleet))
    bus = panel_of(fleet, 1)
    release(fleet, next(iter(fleet.peer(1, 0).safety.stops.active)), bus)
    fleet.run(S)
    for runner in list(fleet.gateways[2]):
        fleet.kill_gateway(runner)
    made = fleet.add_gateway(2)
    moving = [peer for k in fleet.segments for peer in fleet.peers(k)]
    assert fleet.run(8 * S, lambda: fleet.joined and bool(made.gateway.stops.stops)), f"seed {SEED}"
    for _ in range(300):
        fleet.run(10_000)
        assert all(peer.safety.may_move for peer in moving), f"seed {SEED}"
    bus.close()


def test_an_old_stop_that_a_new_gateway_is_told_does_not_latch_a_new_robot(
    fleet: SegmentFleet,
) -> None:
    """A robot that joins after the release has heard of neither. The gateway said the old stop for 2 s,
    and the reset after that: the new robot latched alone, and a person had to release it."""
    press(fleet, 1)
    assert fleet.run(S, lambda: all_latched(fleet))
    bus = panel_of(fleet, 1)
    release(fleet, next(iter(fleet.peer(1, 0).safety.stops.active)), bus)
    fleet.run(S)
    fleet.replace_robot(2, 2)
    assert fleet.run(8 * S, lambda: fleet.joined), f"seed {SEED}"
    new = fleet.peer(2, 2)
    assert not new.safety.far.cleared, "it knows of no stop"
    for runner in list(fleet.gateways[2]):
        fleet.kill_gateway(runner)
    made = fleet.add_gateway(2)
    assert fleet.run(8 * S, lambda: bool(made.gateway.stops.stops)), f"seed {SEED}"
    fleet.run(5 * S)
    assert new.safety.far.cleared and not new.safety.latched, f"seed {SEED}"
    bus.close()


def test_a_gateway_that_stands_by_and_missed_old_stops_does_not_tell_its_own_for_good(
    fleet: SegmentFleet,
) -> None:
    """Other segments compare with the leader alone, so no gateway tells a second one that restarts. Once
    a second it told every segment all stops that it knew, as many as there were since its start."""
    bus = panel_of(fleet, 1)

    def press_and_release() -> None:
        press(fleet, 1)
        assert fleet.run(S, lambda: all_latched(fleet)), f"seed {SEED}"
        release(fleet, next(iter(fleet.peer(1, 0).safety.stops.active)), bus)
        fleet.run(5 * S)

    press_and_release()
    fleet.kill_gateway(next(runner for runner in fleet.gateways[2] if not runner.gateway.leads))
    second = fleet.add_gateway(2)
    assert fleet.run(8 * S, lambda: second.gateway.candidacy.number is not None), f"seed {SEED}"
    press_and_release()
    assert not second.gateway.leads and len(second.gateway.stops.stops) == 1
    far = fleet.leader(3)
    assert far is not None
    before = far.gateway.counts["STOPS"]
    fleet.run(60 * S)
    assert far.gateway.counts["STOPS"] <= before + 5, "twice the time from each one to the next"
    bus.close()
