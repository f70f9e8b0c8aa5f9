"""A fleet with keys on two segments: what an attacker on one of them does through the gateways."""

from collections.abc import Iterator
from random import Random

import can
import pytest

from agent.peer.inputs import ClaimSection
from agent.runtime.peer_factory import MissionParts, identity_of, keyring_of, make_peer
from agent.segments.gateway import Publish
from agent.segments.gateway_proofs import GatewayProofs
from agent.segments.segment_parts import remote_segments_of
from agent.segments.work_relay import BLOCK, REGISTER
from crdt import Phase
from protocol import backbone_messages as backbone
from protocol.authentication import Keys
from protocol.backbone_messages import BackboneHeader, BackboneKind
from protocol.frame_proofs import BACK, FIRST, TICK_US, ProofKeys, TimeAnswers
from protocol.frames.codec import decode, encode
from protocol.frames.fleet_frames import Member
from protocol.frames.frame import Frame
from protocol.frames.messages import Message
from protocol.frames.segment_frames import GATEWAY_ADDRESS, GatewayBeat, SegmentSummary
from protocol.frames.trust_frames import Proof
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress
from protocol.links.bus import CanBus
from sim.rigs.segments_rig import FIELD_HASH, SegmentFleet

S = 1_000_000
SEED = 28
KEYS = Keys(b"m" * 16, b"o" * 16)
OTHER = Keys(b"x" * 16, None)
LENT = 38  # of segment 1, the last two of forty; segment 2 borrows them
HOME, SHARED = 40, 2


@pytest.fixture
def fleet() -> Iterator[SegmentFleet]:
    made = SegmentFleet(2, 2, SEED, candidates=2, keys=KEYS, shared=SHARED)
    assert made.run(10 * S, lambda: made.joined), f"seed {SEED}"
    made.run(2 * S)  # the gateways know the fleet's time
    yield made
    made.end()


class Attacker:
    """A laptop on one segment: it hears everything and says anything, and holds no key."""

    def __init__(self, fleet: SegmentFleet, number: int) -> None:
        self.fleet = fleet
        self.heard: list[Frame] = []
        self.bus = CanBus(can.Bus(interface="fieldbus", channel=fleet.channel(number)))
        self.bus.subscribe(self.heard.append)

    def say(self, message: Message, source: int) -> None:
        """A frame under any address, and time for it to pass."""
        self.bus.send(encode(message, source, 255))
        self.fleet.run(3_000)


def work_of(fleet: SegmentFleet, number: int) -> list[tuple[dict[int, int], bytes]]:
    return [(dict(p.allocation.entries()), p.progress.serialize()) for p in fleet.peers(number)]


def there(fleet: SegmentFleet, section: int) -> int:
    """The number that segment 2 has for a section of segment 1."""
    return next(
        number for number, place in fleet.areas[2].borrowed.items() if place.section == section
    )


def all_know_done(fleet: SegmentFleet, section: int) -> bool:
    theirs = there(fleet, section)
    return all(p.allocation.phase_of(section) is Phase.DONE for p in fleet.peers(1)) and all(
        p.allocation.phase_of(theirs) is Phase.DONE and p.progress.covered(theirs) == 3
        for p in fleet.peers(2)
    )


def test_claims_progress_and_sync_of_the_other_segment_are_proven_there(
    fleet: SegmentFleet,
) -> None:
    listener = Attacker(fleet, 2)
    fleet.finish(1, 0, LENT)
    assert fleet.run(10 * S, lambda: all_know_done(fleet, LENT)), f"seed {SEED}"
    said = [decode(frame) for frame in listener.heard]
    carried = [m for source, m in said if source >= GATEWAY_ADDRESS]
    assert {TaskClaim, WorkProgress, Proof} <= {type(message) for message in carried}
    for peer in fleet.peers(2):
        assert not remote_segments_of(peer).alone
        assert peer.proven.checker is not None and peer.proven.checker.accepted
    listener.bus.close()


def test_work_that_met_while_the_segments_were_cut_is_proven_after_the_heal(
    fleet: SegmentFleet,
) -> None:
    fleet.backbone.cut({1}, {2})
    fleet.finish(1, 0, LENT)
    fleet.run(6 * S)
    assert fleet.peer(1, 1).allocation.phase_of(LENT) is Phase.DONE
    fleet.backbone.heal()
    assert fleet.run(15 * S, lambda: all_know_done(fleet, LENT)), f"seed {SEED}"


def test_a_second_gateway_takes_over_with_proofs(fleet: SegmentFleet) -> None:
    led = fleet.leader(2)
    assert led is not None
    fleet.kill_gateway(led)
    assert fleet.run(10 * S, lambda: fleet.joined), f"seed {SEED}"
    fleet.finish(1, 1, LENT + 1)
    assert fleet.run(10 * S, lambda: all_know_done(fleet, LENT + 1)), f"seed {SEED}"


@pytest.mark.parametrize("kind", [TaskClaim, StateSyncResponse])
def test_an_attacker_of_one_segment_ends_no_work_through_the_gateway(
    fleet: SegmentFleet, kind: type[TaskClaim] | type[StateSyncResponse]
) -> None:
    attacker, near, far = Attacker(fleet, 1), work_of(fleet, 1), work_of(fleet, 2)
    address = fleet.peer(1, 0).address
    assert address is not None
    for _ in range(20):
        for section in (0, LENT, LENT + 1):
            attacker.say(kind(section, 0, Phase.DONE, 0, 900, 0), address)
            attacker.say(WorkProgress(section, 0, 7), address)
        attacker.say(Member(0, 0, FIELD_HASH), 160)
        attacker.say(Proof(0, 4, 1, 2), address)
    fleet.run(10 * S)
    assert work_of(fleet, 1) == near and work_of(fleet, 2) == far, f"seed {SEED}"
    leader = fleet.leader(1)
    assert leader is not None and leader.gateway.proofs is not None
    assert leader.gateway.proofs.checker.dropped > 0
    attacker.bus.close()


def test_an_attacker_in_a_gateways_name_ends_no_work(fleet: SegmentFleet) -> None:
    attacker, near, far = Attacker(fleet, 2), work_of(fleet, 1), work_of(fleet, 2)
    for turn in range(30):
        for number in range(4):
            source = GATEWAY_ADDRESS + number
            for section in (0, there(fleet, LENT)):
                attacker.say(TaskClaim(section, 0, Phase.DONE, 0, 900, 0), source)
                attacker.say(StateSyncResponse(section, 0, Phase.DONE, 0, 900, 0), source)
                attacker.say(WorkProgress(section, 0, 7), source)
            attacker.say(Proof(124 + number, 3, turn, turn), source)
    fleet.run(10 * S)
    assert work_of(fleet, 1) == near and work_of(fleet, 2) == far, f"seed {SEED}"
    attacker.bus.close()


def test_recorded_frames_of_a_gateway_change_nothing(fleet: SegmentFleet) -> None:
    attacker = Attacker(fleet, 2)
    fleet.runners[1, 0].operate(ClaimSection(LENT, 3))
    fleet.run(6 * S)
    recorded = [frame for frame in attacker.heard if frame.identifier & 0xFF >= GATEWAY_ADDRESS]
    assert recorded
    far = work_of(fleet, 2)
    refused = [p.proven.checker.stale for p in fleet.peers(2) if p.proven.checker]
    for frame in recorded[-200:]:
        attacker.bus.send(frame)
        fleet.run(2_000)
    fleet.run(3 * S)
    assert work_of(fleet, 2) == far, f"seed {SEED}"
    assert [p.proven.checker.stale for p in fleet.peers(2) if p.proven.checker] > refused
    attacker.bus.close()


def test_nobody_hides_that_the_other_segments_are_lost(fleet: SegmentFleet) -> None:
    for number in fleet.segments:
        for runner in list(fleet.gateways[number]):
            fleet.kill_gateway(runner)
    attacker = Attacker(fleet, 1)
    for turn in range(200):
        attacker.say(GatewayBeat(124, 3, 9, 1, 7), GATEWAY_ADDRESS)
        attacker.say(SegmentSummary(2, 2, 0, 0, 250, turn), GATEWAY_ADDRESS)
        fleet.run(20_000)
    assert all(remote_segments_of(peer).alone for peer in fleet.peers(1)), f"seed {SEED}"
    assert all(remote_segments_of(p).summaries[2].summary.done == 0 for p in fleet.peers(1))
    attacker.bus.close()


def test_messages_of_the_backbone_without_a_tag_change_no_work(fleet: SegmentFleet) -> None:
    before = work_of(fleet, 1), work_of(fleet, 2)
    forger = fleet.backbone.attach(9)
    done = TaskClaim(LENT, 3, Phase.DONE, 0, 900, 0)
    entries = (
        backbone.Entry(BLOCK, 1, LENT, 0, 0, encode(WorkProgress(LENT, 0, 7), 1, 255).data),
        backbone.Entry(REGISTER, 1, LENT, 1, 0, encode(done, 1, 255).data),
    )
    for sequence in range(50):
        for segment in (1, 2):
            head = BackboneHeader(BackboneKind.WORK, segment, 99, 124, 1, 1000 + sequence)
            data = backbone.pack(head, entries)
            forger.publish(Publish(BackboneKind.WORK, data))
            forger.publish(Publish(BackboneKind.WORK, data + bytes(8)))
        fleet.run(20_000)
    fleet.run(5 * S)
    assert (work_of(fleet, 1), work_of(fleet, 2)) == before, f"seed {SEED}"
    leader = fleet.leader(1)
    assert leader is not None and leader.gateway.counts["unproven message"] > 0


def test_gateways_without_keys_carry_stops_and_no_work() -> None:
    fleet = SegmentFleet(
        2, 2, SEED, candidates=1, keys=KEYS, shared=SHARED, gateways_with_keys=False
    )
    fleet.run(10 * S)
    far = work_of(fleet, 2)
    fleet.finish(1, 0, LENT)
    fleet.run(10 * S)
    assert fleet.peer(1, 1).allocation.phase_of(LENT) is Phase.DONE
    assert work_of(fleet, 2) == far, f"seed {SEED}"
    assert all(remote_segments_of(peer).alone for peer in fleet.peers(2)), "and says so"
    fleet.end()


def test_a_gateway_with_the_keys_of_before_a_rotation_is_not_believed(fleet: SegmentFleet) -> None:
    for number in fleet.segments:
        for runner in fleet.gateways[number]:
            assert runner.gateway.proofs is not None
            runner.gateway.proofs.rekey(OTHER, fleet.event_loop.now_us())
    far = work_of(fleet, 2)
    fleet.finish(1, 0, LENT)
    fleet.run(10 * S)
    assert work_of(fleet, 2) == far, f"seed {SEED}"
    assert all(remote_segments_of(peer).alone for peer in fleet.peers(2))
    for number in fleet.segments:  # its file is read again
        for runner in fleet.gateways[number]:
            assert runner.gateway.proofs is not None
            runner.gateway.proofs.rekey(Keys(KEYS.master, None), fleet.event_loop.now_us())
    assert fleet.run(15 * S, lambda: all_know_done(fleet, LENT)), f"seed {SEED}"


def reboot(fleet: SegmentFleet, number: int, day: int) -> None:
    """All robots of a segment are switched off, and on again. They draw another time."""
    for slot in range(fleet.robots):
        fleet.runners.pop((number, slot)).bus.close()
    fleet.run(5 * S)
    for slot in range(fleet.robots):
        name = f"segment {number}"
        identity = identity_of(name, slot, fleet.robots, FIELD_HASH, first_boot=True)
        rng = Random(f"{day}/{number}/{slot}")
        peer = make_peer(
            identity, rng, fleet.event_loop.now_us(), parts=MissionParts(),
            keyring=keyring_of(KEYS, slot, rng.randbytes(16)), area=fleet.areas[number],
            backbone=fleet.policy,
        )  # fmt: skip
        bus = CanBus(can.Bus(interface="fieldbus", channel=fleet.channel(number)))
        runner = fleet.event_loop.make_runner(peer, bus, None, None, None)
        fleet.event_loop.start(runner)
        fleet.runners[number, slot] = runner


@pytest.mark.parametrize("day", [12, 13, 14])
def test_a_gateway_believes_robots_that_were_switched_off_over_night(
    fleet: SegmentFleet, day: int
) -> None:
    """Found by a review: every second time their new time was smaller, and it ignored them for good."""
    reboot(fleet, 2, day)
    fleet.run(20 * S)
    assert not any(remote_segments_of(peer).alone for peer in fleet.peers(2))


@pytest.mark.parametrize(("later_for_us", "back"), [(1 * S, True), (1 * S + 1, False)])
def test_only_an_answer_of_just_now_sets_the_time_of_a_gateway_back(
    later_for_us: int, back: bool
) -> None:
    """Somebody who repeats an earlier answer would make old proofs good again."""
    proofs = GatewayProofs(KEYS, 1, 0)
    (asked,) = [effect.message for effect in proofs.cover([], 131, 131, 0)]
    answers = TimeAnswers(ProofKeys(KEYS))
    earlier, now = FIRST, FIRST + 3 * BACK
    for ticks, at_us in ((now, 0), (earlier, later_for_us)):
        for half in answers.halves(asked, ticks):
            assert proofs.hear(140, 0, half, at_us) == ()
    passed = later_for_us // TICK_US
    assert proofs.checker.time.at(later_for_us) == (earlier if back else now + passed)
