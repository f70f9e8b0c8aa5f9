"""DM1 of a whole fleet that stands, read by a tool that we did not write from our codec."""

from itertools import pairwise

from agent.interface.config import S
from agent.peer.diagnostics import SHARED, fault_of
from agent.safety.stop_cause import StopCause
from sim.rigs.faults_rig import StandingFleet

STOPPED, BUTTON = fault_of(StopCause.STOP_DOT), fault_of(StopCause.IMPLEMENTS_STOP)


def told(rig: StandingFleet, since_at_us: int) -> dict[int, list[tuple[tuple[int, int], ...]]]:
    """What each device told to all, by address."""
    found: dict[int, list[tuple[tuple[int, int], ...]]] = {}
    for one in rig.tool.read:
        if one.at_us >= since_at_us and not one.was_asked:
            found.setdefault(one.source, []).append(one.faults)
    return found


def test_what_holds_the_whole_fleet_is_repeated_by_its_leader_and_told_by_all_who_are_asked() -> (
    None
):
    """Each DM1 of two faults takes three frames: those of twenty robots took 3.5 % of the bus."""
    rig = StandingFleet(4, 41)
    rig.stop()
    begins_at_us = rig.fleet.now_us
    rig.fleet.run(10 * S)
    leader = rig.fleet.serving
    assert leader is not None and leader.peer.address is not None
    said = told(rig, begins_at_us)
    assert len(said) == 4 and all(9 <= len(each) <= 11 for each in said.values())
    for address, each in said.items():
        expected = {(STOPPED, BUTTON)} if address == leader.peer.address else {(STOPPED,)}
        assert set(each) == expected, address
    for robot in rig.fleet.robots:
        rig.tool.ask(robot.peer.address or 0)
        rig.fleet.run(S // 2)
        asked = [one for one in rig.tool.read if one.was_asked]
        assert asked[-1].source == robot.peer.address
        assert set(asked[-1].faults) == {STOPPED, BUTTON}, (
            "a robot that is asked tells all of its causes"
        )
    assert not rig.tool.errors


def test_no_fault_is_left_out_for_long_when_the_leader_dies() -> None:
    """The others tell all themselves once they miss the leader, and its silence as well."""
    rig = StandingFleet(4, 42)
    rig.stop()
    leader = rig.fleet.serving
    assert leader is not None
    leader.alive, killed_at_us = False, rig.fleet.now_us
    rig.fleet.run(12 * S)
    others = [robot.peer.address for robot in rig.fleet.robots if robot is not leader]
    with_button = [
        one.at_us for one in rig.tool.read
        if one.at_us >= killed_at_us and one.source in others and BUTTON in one.faults
    ]  # fmt: skip
    gaps = [b - a for a, b in pairwise([killed_at_us, *with_button, rig.fleet.now_us])]
    assert max(gaps) <= 2.5 * S, gaps


def test_a_fault_of_one_robot_is_told_beside_what_holds_all() -> None:
    """The robot tells its own fault; what the leader tells, too, does not hide it."""
    rig = StandingFleet(3, 43)
    rig.stop()
    leader = rig.fleet.serving
    other = next(robot for robot in rig.fleet.robots if robot is not leader)
    other.peer.safety.raise_cause(StopCause.DISK_ERROR, rig.fleet.now_us, "")
    begins_at_us = rig.fleet.now_us + S
    rig.fleet.run(5 * S)
    assert set(told(rig, begins_at_us)[other.peer.address or 0]) == {
        (fault_of(StopCause.DISK_ERROR),)
    }
    assert StopCause.DISK_ERROR not in SHARED
