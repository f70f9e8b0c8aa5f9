"""What members report of themselves, beside what others told of them before."""

from agent.interface.lifecycle import State
from agent.peer.member_reports import MemberReports
from crdt import VectorClock
from protocol.frames.fleet_frames import Heartbeat


def test_a_heartbeat_corrects_the_count_that_an_old_slice_moved_too_far() -> None:
    reports = MemberReports(0, VectorClock({1: 1000}))
    reports.clock.witness(1, 870 & 0xFF, bits=8)  # a slice of a robot that was away
    assert reports.clock[1] == 1126
    reports.heard(1, Heartbeat(1, State.IDLE, False, False, True, False, 1.0, 1001, 0))
    assert reports.clock[1] == 1001
