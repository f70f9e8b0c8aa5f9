"""Floods of frames that outrank a stop, and a wire that loses a sender in the middle of a frame."""

from random import Random

import pytest

from protocol.frames.frame import Frame
from sim.can.can_wire import QUEUE_MAX, Delivery, Wire

LOWEST = Frame(0x0000004D, bytes(8))  # nothing outranks it but an identifier below


def frame(identifier: int, payload: int = 0) -> Frame:
    return Frame(identifier, payload.to_bytes(8, "little"))


def drain(wire: Wire) -> list[Delivery]:
    result: list[Delivery] = []
    while (next_at_us := wire.next_at_us) is not None:
        result += wire.advance(next_at_us)
    return result


@pytest.mark.parametrize("full", [False, True])
def test_item_2_a_wire_goes_on_when_its_sender_goes_in_the_middle_of_a_frame(full: bool) -> None:
    wire = Wire()
    flooder, robot, other = (wire.attach() for _ in range(3))
    for _ in range(QUEUE_MAX):
        wire.submit(flooder, LOWEST, 0)
    for count in range(QUEUE_MAX if full else 3):
        wire.submit(robot, frame(0x18FF1080, count), 0)
    wire.advance(700)  # the second frame of the flood is under way
    wire.detach(flooder)
    if full:
        assert not wire.submit(robot, frame(0x18FF1080), 800), "refused, as before"
    heard = drain(wire)
    assert len(heard) == (QUEUE_MAX if full else 3)
    assert all(delivery.receivers == (other,) for delivery in heard)
    assert wire.busy_for_us <= heard[-1].t_us


def test_item_2_a_stop_finds_its_place_in_a_queue_that_is_full() -> None:
    wire = Wire()
    flooder, robot = wire.attach(), wire.attach()
    wire.submit(flooder, LOWEST, 0)
    for count in range(QUEUE_MAX):
        assert wire.submit(robot, frame(0x14FF1080, count), 0)
    assert not wire.submit(robot, frame(0x14FF1080), 0), "as urgent as what waits: refused"
    assert wire.submit(robot, frame(0x00FF0080), 0), "a stop takes the place of the last of these"
    heard = [delivery.frame for delivery in drain(wire)]
    assert heard[:2] == [LOWEST, frame(0x00FF0080)]
    assert heard[2:] == [frame(0x14FF1080, count) for count in range(QUEUE_MAX - 1)]


@pytest.mark.parametrize("seed", range(30))
def test_a_flood_without_events_is_the_same_as_one_frame_by_frame(seed: int) -> None:
    """Frames that follow one another in one train, against each with its own arbitration."""
    rng = Random(seed)
    identifier = rng.choice((0, 0x4D, 0x0C00004D, 0x14FF104D, 0x1FFFFF4D))
    what = Frame(identifier, rng.randbytes(rng.randrange(9)))
    train, single = Wire(), Wire()
    single.faults.duplicate = 1e-300  # one by one
    wires, told = (train, single), {id(train): list[Delivery](), id(single): list[Delivery]()}
    for wire in wires:
        for _ in range(5):
            wire.attach()
        wire.flood(4, what, 100)
    flooding, now_us = True, 100
    for _ in range(400):
        now_us += rng.choice((1, 2, 3, 5, 7, 101, 903, 3001))
        if now_us % 4 == 0:  # no frame ends there: a frame of that very microsecond may be too late
            now_us += 1
        dice, node = rng.random(), rng.randrange(4)
        sent = frame(rng.choice((0x00FF0080, 0x14FF1080, 0x18FF1181)) + node, rng.randrange(256))
        for wire in wires:
            told[id(wire)] += wire.advance(now_us)
            if dice < 0.05:
                wire.flood(4, None if flooding else what, now_us)
            elif dice < 0.07:
                wire.partition({0, 4}, {1, 2, 3}) if dice < 0.06 else wire.heal()
            else:
                wire.submit(node, sent, now_us)
        flooding = not flooding if dice < 0.05 else flooding
    for wire in wires:
        wire.flood(4, None, now_us)
        told[id(wire)] += drain(wire)
    others = [[d for d in told[id(wire)] if d.sender != 4] for wire in wires]
    assert others[0] == others[1], f"seed {seed}"
    counts = [(w.frames, w.busy_for_us, w.worst_for_us, w.by_group, w.nodes[4].sent) for w in wires]
    assert counts[0] == counts[1], f"seed {seed}"
