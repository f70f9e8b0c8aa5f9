"""Who has met whom, told by links and power alone."""

from agent.interface.config import S
from sim.can.can_wire import Wire
from sim.fleet.contact_history import MET_US, ContactHistory


def test_robots_on_one_bus_have_met_after_a_while() -> None:
    wire = Wire()
    nodes = {slot: wire.attach() for slot in range(3)}
    known = ContactHistory(wire)
    known.look(MET_US - 1, nodes)
    assert not known.met(0, 1)
    known.look(MET_US, nodes)
    assert known.met(0, 1) and known.met(1, 0)


def test_who_boots_behind_a_cut_has_met_nobody_there() -> None:
    """Found by `headland chaos`, profile protocol, seeds 1313 and 1524: S1 was asked of a robot that
    had never heard of the one that was pressed."""
    wire = Wire()
    nodes = {slot: wire.attach() for slot in range(3)}
    known = ContactHistory(wire)
    known.look(10 * S, nodes)
    wire.partition({nodes[0]}, {nodes[1], nodes[2]})
    del nodes[2]
    known.look(11 * S, nodes)
    known.boots(2)
    nodes[2] = wire.attach()
    wire.nodes[nodes[2]].island = 1
    known.look(20 * S, nodes)
    assert known.met(2, 1) and not known.met(2, 0)
    assert known.met(0, 2), "its earlier life was met"
    assert known.met(1, 0) and known.met(0, 1), "before the cut"


def test_what_is_lost_or_heard_one_way_only_is_no_meeting() -> None:
    wire = Wire()
    nodes = {slot: wire.attach() for slot in range(2)}
    wire.faults.deaf.add((nodes[0], nodes[1]))
    known = ContactHistory(wire)
    known.look(10 * S, nodes)
    assert known.met(0, 1) and not known.met(1, 0)
    wire.faults.deaf.clear()
    wire.faults.loss = 0.1
    known.look(20 * S, nodes)
    assert not known.met(1, 0)


def test_one_that_hangs_meets_nobody_meanwhile() -> None:
    """Found by `headland chaos`, profile protocol, seed 602014: S1 was asked of a robot that was
    switched on while the one that was pressed hung."""
    wire = Wire()
    nodes = {slot: wire.attach() for slot in range(2)}
    known = ContactHistory(wire)
    known.hangs(0, 4 * S, 6 * S)
    known.hangs(0, 5 * S, 8 * S)
    assert known.hang_began_at_us(0, 7 * S) == 4 * S and known.hang_began_at_us(0, 8 * S) is None
    assert known.is_hung(0, 5 * S) and not known.is_hung(0, 8 * S)
    known.look(8 * S + MET_US - 1, nodes)
    assert not known.met(1, 0) and not known.met(0, 1)
    known.look(8 * S + MET_US, nodes)
    assert known.met(1, 0)


def test_robots_that_are_driven_from_every_address_meet_later() -> None:
    """Found by `headland chaos`, profile protocol, seed 1000211: S6 was asked of a robot that restarted
    while a device had driven the robot that died later from every address."""
    wire = Wire()
    nodes = {slot: wire.attach() for slot in range(2)}
    known = ContactHistory(wire)
    known.look(10 * S, nodes)
    known.boots(0)
    known.addresses_taken(20 * S)
    known.look(20 * S + MET_US - 1, nodes)
    assert not known.met(0, 1) and known.met(1, 0)
    known.look(20 * S + MET_US, nodes)
    assert known.met(0, 1)


def test_a_robot_meets_others_after_its_bus_off_and_not_during_it() -> None:
    """Found by `headland chaos`, profile claims, seed 96000005: S6 was asked of a robot that came back
    from bus-off 70 ms before the death of a robot that had joined meanwhile."""
    wire = Wire()
    nodes = {slot: wire.attach() for slot in range(2)}
    known = ContactHistory(wire)
    wire.bus_off(nodes[1], 9 * S)
    known.boots(0)
    known.look(5 * S, nodes)
    wire.advance(9 * S)
    known.look(9 * S + MET_US - 1, nodes)
    assert not known.met(0, 1) and not known.met(1, 0)
    known.look(9 * S + MET_US, nodes)
    assert known.met(0, 1) and known.met(1, 0)


def test_a_bus_off_between_two_looks_begins_the_meeting_again() -> None:
    """It has begun and ended between two looks."""
    wire = Wire()
    nodes = {slot: wire.attach() for slot in range(2)}
    known = ContactHistory(wire)
    wire.advance(1 * S)
    wire.bus_off(nodes[1], 2 * S)
    wire.advance(4 * S)
    known.look(4 * S, nodes)
    assert not known.met(0, 1)
