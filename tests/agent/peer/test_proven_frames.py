"""When what a robot sends is proven."""

from types import SimpleNamespace
from typing import Any

import pytest

from agent.interface.config import BEATS
from agent.interface.effects import Send
from agent.peer.proven_frames import PATIENT_US, SOON_US, ProvenFrames
from protocol.authentication import KEY_SIZE, Keys
from protocol.frame_proofs import FleetTime, ProofKeys
from protocol.frames.fleet_frames import Heartbeat, LeaderElectionVote, VectorSlice
from protocol.frames.trust_frames import Proof
from protocol.frames.work_frames import TaskClaim

NOW_US = 5_000_000
BEAT = Heartbeat(1, 3, False, False, True, False, 1.0, 1, 1)
VOTE = LeaderElectionVote(1, 2, 0, 0, 7)
SLICE = VectorSlice(0, (1, 2, 3, 4, 5, 6, 7))
CLAIM = TaskClaim(4, 1, 1, 0, 7, 1)


def part_with_keys() -> ProvenFrames:
    keys = ProofKeys(Keys(bytes(KEY_SIZE), bytes(KEY_SIZE)))
    time = FleetTime(1 << 40, 0)
    time.known = True
    joining: Any = SimpleNamespace(address=129)  # all that this part asks of it
    membership: Any = SimpleNamespace()
    return ProvenFrames(1, keys, time, membership, joining)


def proofs(effects: Any) -> list[int]:
    return [e.message.covered for e in effects if type(e.message) is Proof]


@pytest.mark.parametrize("patient", [VOTE, SLICE])
def test_what_nobody_waits_for_is_proven_with_the_next_heartbeat(patient: Any) -> None:
    """Each had a proof of its own: 108 robots spent 6.8 points of the bus on proofs, of 6 allowed."""
    part = part_with_keys()
    assert not proofs(part.cover([Send(patient)], NOW_US))
    assert part.due_at_us == NOW_US + PATIENT_US
    later_us = NOW_US + BEATS[-1].heartbeat_period_us // 2
    assert proofs(part.cover([Send(BEAT)], later_us)) == [2]


def test_a_claim_does_not_wait_for_a_vote() -> None:
    part = part_with_keys()
    part.cover([Send(VOTE)], NOW_US)
    part.cover([Send(CLAIM)], NOW_US)
    assert part.due_at_us == NOW_US + SOON_US
