"""Stops are judged by the bodies in the world of a launch."""

import asyncio
import json

import pytest

from agent.interface.effects import HALT, Drive, GatedDrive
from sim.record.remote_body import BodyServer
from sim.world.drive_trains import Chassis
from sim.world.world import World
from tools.bench.standing_bodies import Bodies, BodiesPress, standing
from tools.bench.watched_launch import tell

ZERO_US, STEP_US = 5_000_000, 10_000


def line(now_s: float, *bodies: tuple[float, float, float]) -> bytes:
    return json.dumps({"bodies": bodies, "now_s": now_s}, separators=(",", ":")).encode() + b"\n"


def test_a_press_lasts_until_the_last_body_stands() -> None:
    bodies = Bodies(2.0)
    bodies.take(b"robot 1: process 77\n")
    bodies.take(line(10.0, (9.9, 9.9, 1.1), (4.0, 4.0, 0.0)))
    assert bodies.driving == 1
    bodies.take(line(12.0, (10.9, 10.25, 0.0), (4.0, 4.0, 0.0)))
    told = asyncio.run(bodies.stood(10.0, 1))
    assert told == pytest.approx((250.0, 900.0, 1)) and bodies.driving == 0


def test_bodies_that_creep_are_not_pressed_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A body that has just begun to drive stands within a step, and says nothing of a stop."""
    bodies, looks = Bodies(2.0), iter((0.1, 0.9, 1.1))

    async def look(_: float) -> None:
        bodies.take(line(10.0, (10.0, 10.0, 1.5), (10.0, 10.0, next(looks))))

    monkeypatch.setattr("tools.bench.standing_bodies.asyncio.sleep", look)
    assert asyncio.run(bodies.drive()) == 2 and next(looks, None) is None


def test_a_side_that_is_too_slow_is_said() -> None:
    sides = [("here", [BodiesPress(400.0, 1300.0, 2), BodiesPress(430.0, 1200.0, 1)])]
    commanded, stood = standing("a door", sides, 2, 833.0, "")
    assert (commanded.value, commanded.holds) == (430.0, False)
    assert (stood.value, stood.holds) == (1300.0, False)
    assert "1 or more drove" in stood.scope


def test_a_launch_says_when_its_bodies_moved_last(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Told(Exception):
        pass

    async def once(_: float) -> None:
        raise Told

    world = World([[(0.0, 0.0), (50.0, 0.0), (50.0, 50.0), (0.0, 50.0)]])
    world.add_robot(0, (10.0, 10.0), 0.5, Chassis())
    body = world.body(0)
    for k in range(10):
        body.drive(GatedDrive(Drive(1.0, 0.0)), k * 5 * STEP_US)
    body.drive(GatedDrive(HALT), 500_000)
    world.advance(2_000_000)
    monkeypatch.setattr("tools.bench.watched_launch.asyncio.sleep", once)
    with pytest.raises(Told):
        asyncio.run(tell(BodyServer(world, ZERO_US)))
    bodies = Bodies(2.5)
    bodies.take(capsys.readouterr().out.encode())
    assert bodies.speeds_m_s == [0.0] and bodies.now_s == 7.0 and bodies.commanded_s == [5.5]
    speed_m_s = 1.0
    assert 5.5 + 0.5 * speed_m_s / 3.0 < bodies.moved_s[0] < 5.5 + 1.3 * speed_m_s / 3.0
