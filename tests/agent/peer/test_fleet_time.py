"""The fleet's time with a thief in the fleet: how far it moves, and that new keys begin another one."""

import pytest

from agent.interface.config import MS, S
from agent.peer.fleet_clock import COMPARED_ANSWERS_MAX, COMPARED_MAX
from agent.peer.inputs import Received
from protocol.authentication import Keys
from protocol.frame_proofs import (
    AHEAD,
    FIRST,
    JUMP_LAST,
    TICK_US,
    TOLD_LAST,
    FleetTime,
    ProofBatch,
    ProofKeys,
)
from protocol.frames.codec import decode, encode
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.trust_frames import WORD_BITS, FleetTimeTold, TimeQuestion
from protocol.name import tool_name
from protocol.rekeying import NOBODY, Rekeying
from sim.rigs.keyed_rig import KeyedRig

FAR = JUMP_LAST - 4 * S // TICK_US  # the others ask for it within so long
END, THIEF, ELSEWHERE = (1 << WORD_BITS) - 1, 1, 200
NEW = Rekeying(1, bytes(range(16)), NOBODY)


def master_of(rig: KeyedRig) -> ProofKeys:
    """What the thief of one robot has."""
    assert rig.keys is not None
    return ProofKeys(Keys(rig.keys.master, None))


def somebody(rig: KeyedRig) -> None:
    """Names are public: a device of the thief claims an address for one."""
    rig.forge(AddressClaimed(tool_name(ELSEWHERE).pack()), ELSEWHERE)


def answer(rig: KeyedRig, slot: int, ticks: int) -> None:
    """Tell a robot this time as the valid answer to its newest question."""
    asked = [m for _, m in map(decode, rig.recorded) if isinstance(m, TimeQuestion)]
    question = next(m for m in reversed(asked) if m.asker == slot)
    tag = master_of(rig).time_tag(question, ticks)
    assert tag is not None
    somebody(rig)
    for told in (FleetTimeTold(0, ticks), FleetTimeTold(1, tag)):
        rig.forge(told, ELSEWHERE)


def time_of(rig: KeyedRig, slot: int) -> FleetTime:
    return rig.peers[slot].named.fleet_clock.time


def ticks_of(rig: KeyedRig) -> list[int]:
    return [time_of(rig, slot).at(rig.now_us) for slot in rig.peers]


def booting(rig: KeyedRig, slot: int) -> None:
    """Switch a robot on again, until it has asked; the others do not hear it."""
    rig.boot(slot)
    rig.cut.update(other for other in rig.peers if other != slot)
    rig.run_for(300 * MS)


def switch(rig: KeyedRig, *slots: int) -> None:
    """The owner has given these robots a new secret and makes them use it."""
    somebody(rig)
    for slot in slots:
        rig.peers[slot].named.keys._next = NEW
        rig.tell(slot, Received(encode(NEW.switch(), ELSEWHERE)))
        assert rig.peers[slot].named.keys.generation == 1


def one_fleet(rig: KeyedRig) -> bool:
    everybody = set(rig.peers)
    return all(peer.membership.live == everybody for peer in rig.peers.values())


@pytest.mark.parametrize("ticks", [END, TOLD_LAST + 1, FIRST - 1, 0])
def test_an_impossible_time_is_refused_and_counted_and_ends_no_program(ticks: int) -> None:
    rig = KeyedRig(1)
    booting(rig, 0)
    answer(rig, 0, ticks)
    assert time_of(rig, 0).refused == 1 and not time_of(rig, 0).known
    rig.forge(
        TimeQuestion(2, 5), ELSEWHERE
    )  # anybody may ask, and robots that know the time answer
    rig.run_for(S)
    rig.cut.clear()
    rig.run_for(3 * S)
    assert one_fleet(rig) and max(ticks_of(rig)) - min(ticks_of(rig)) <= 1


def test_a_thief_that_moves_the_time_as_far_as_it_can_keeps_nobody_out_and_ends_no_program() -> (
    None
):
    rig = KeyedRig(2)
    booting(rig, 0)
    answer(rig, 0, FAR)
    rig.cut.clear()
    rig.run_for(5 * S)
    assert one_fleet(rig) and min(ticks_of(rig)) > JUMP_LAST, "all follow the greatest time"
    rig.forge(TimeQuestion(2, 5), ELSEWHERE)
    rig.boot(2)  # it learns a time that is beyond what moves a known one
    rig.run_for(5 * S)
    assert one_fleet(rig)
    rig.peers[2].named.fleet_clock.asks_at_us = rig.now_us
    rig.cut.update((0, 1))
    rig.run_for(100 * MS)
    before = time_of(rig, 2).at(rig.now_us)
    answer(rig, 2, before + 2 * AHEAD)
    assert time_of(rig, 2).refused == 1, "no answer moves the time any further"
    assert time_of(rig, 2).at(rig.now_us) - before < AHEAD


def test_a_proof_moves_the_time_by_a_second_at_most() -> None:
    rig = KeyedRig(3)
    address = rig.address_of(THIEF)
    for early, moves in ((AHEAD - 2, True), (AHEAD + 5, False)):
        before = time_of(rig, 0).at(rig.now_us)
        time = FleetTime(before + early, rig.now_us)
        time.known = True
        proof = ProofBatch(THIEF, master_of(rig), time).seal(address, rig.now_us)
        assert proof is not None
        rig.forge(proof, address)
        passed = time_of(rig, 0).at(rig.now_us) - before
        assert (passed >= early) is moves, (early, passed)


def test_new_keys_begin_a_new_time_which_a_thief_has_not_moved() -> None:
    rig = KeyedRig(4)
    booting(rig, 0)
    answer(rig, 0, FAR)
    rig.cut.clear()
    rig.run_for(5 * S)
    switch(rig, 0, 1, 2)
    assert max(ticks_of(rig)) < JUMP_LAST
    rig.run_for(5 * S)
    assert one_fleet(rig) and max(ticks_of(rig)) - min(ticks_of(rig)) <= 1
    assert all(peer.safety.may_move for peer in rig.peers.values())


def test_a_robot_that_switches_later_than_the_others_learns_their_time() -> None:
    rig = KeyedRig(5)
    switch(rig, 0, 1)
    rig.run_for(20 * S)
    switch(rig, 2)
    assert ticks_of(rig)[0] - ticks_of(rig)[2] > 10 * S // TICK_US
    rig.run_for(5 * S)
    assert one_fleet(rig) and max(ticks_of(rig)) - min(ticks_of(rig)) <= 1


def test_a_robot_that_knows_no_time_at_the_switch_asks_for_it() -> None:
    rig = KeyedRig(6)
    switch(rig, 0, 1)
    rig.run_for(20 * S)
    rig.boot(2)
    rig.run_for(100 * MS)
    assert not time_of(rig, 2).known
    switch(rig, 2)
    rig.run_for(5 * S)
    assert one_fleet(rig) and max(ticks_of(rig)) - min(ticks_of(rig)) <= 1


def test_forged_answers_and_questions_cost_few_tags(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each answer was compared with each of 128 questions; a flood of both kept a computer busy."""
    rig = KeyedRig(1)
    peer, tags = rig.peers[0], 0
    real = ProofKeys.time_tag

    def counted(keys: ProofKeys, question: TimeQuestion, ticks: int) -> int | None:
        nonlocal tags
        tags += 1
        return real(keys, question, ticks)

    somebody(rig)
    for asker in range(108):
        for nonce in range(3):
            rig.tell(0, Received(encode(TimeQuestion(asker, nonce), ELSEWHERE)))
    pending = peer.named.fleet_clock._pending
    assert len({question.asker for question in pending}) == len(pending) > COMPARED_MAX
    monkeypatch.setattr(ProofKeys, "time_tag", counted)
    for value in range(2 * COMPARED_ANSWERS_MAX):
        for part in (0, 1):
            rig.tell(0, Received(encode(FleetTimeTold(part, 1000 + value), ELSEWHERE)))
    questions = COMPARED_MAX * COMPARED_ANSWERS_MAX
    assert COMPARED_MAX < tags <= questions + 2 * COMPARED_ANSWERS_MAX, (
        "and one for its own question"
    )
