"""A log as a body: where it is looked for, and what it says of the place."""

import asyncio
from functools import reduce
from operator import xor
from pathlib import Path

import pytest

from agent.interface.config import MS

pytest.importorskip("pynmeagps", reason="the extra nmea is not installed")

from agent.runtime.bodies.replay_body import ReplayBody
from agent.runtime.robot_file import RobotError, RobotFile
from agent.runtime.robot_process import opened_body

NOW_US = 7_000_000


def sentence(body: str) -> bytes:
    return b"$%b*%02X\r\n" % (body.encode(), reduce(xor, body.encode(), 0))


def robot(folder: Path, log: str) -> RobotFile:
    options = {"log": log, "origin": [52.0, 5.0]}
    document = {"name": "n", "robot": {"slot": 0}, "fleet": {"robots": 2},
                "body": {"plugin": "replay", "options": options}}  # fmt: skip
    return RobotFile.of(document, "robot.toml", folder)


def test_a_log_is_found_beside_the_robot_file_and_tells_its_places_in_time(tmp_path: Path) -> None:
    """It was looked for in the working folder, unlike all other files."""
    lines = [
        sentence(f"GNGGA,235959.{tick:02d},5200.{tick:04d},N,00500.0000,E,4,17,0.6,80.0,M,46.0,M,,")
        + sentence("GNHDT,0.0,T")
        for tick in (0, 5, 10)
    ]
    (tmp_path / "day.nmea").write_bytes(b"".join(lines))
    body = asyncio.run(opened_body(robot(tmp_path, "day.nmea")))
    seen = [body.sense(NOW_US + for_us) for for_us in (0, 60 * MS, 1000 * MS)]
    assert [each and each.sensed_at_us - NOW_US for each in seen] == [0, 50 * MS, 100 * MS]
    # 0.0001 minutes are 0.1854 m.
    assert [each and each.y_m for each in seen] == pytest.approx([0.0, 0.927, 1.854], abs=0.01)


def test_a_log_goes_on_at_midnight(tmp_path: Path) -> None:
    """The place after a gap at midnight came in no time after the one before, as a jump, and what a
    receiver had said before midnight passed for new all day."""
    lines = [
        sentence(f"GNGGA,{at},5200.{tick:04d},N,00500.0000,E,4,17,0.6,80.0,M,46.0,M,,")
        + sentence("GNHDT,0.0,T")
        for tick, at in enumerate(("235950.00", "000010.00", "000010.05", "000009.00", "000009.10"))
    ]
    (tmp_path / "night.nmea").write_bytes(b"".join(lines))
    body = asyncio.run(opened_body(robot(tmp_path, "night.nmea")))
    assert isinstance(body, ReplayBody)
    times_ms = [each.sensed_at_us / MS for each in body.seen]
    assert times_ms == [0, 20_000, 20_050, 20_050, 20_150]


@pytest.mark.parametrize("content", [None, b"", b"no sentence\n"])
def test_a_log_that_cannot_be_played_needs_a_person(tmp_path: Path, content: bytes | None) -> None:
    """The code was 75, so that a supervisor started the robot again for ever."""
    if content is not None:
        (tmp_path / "day.nmea").write_bytes(content)
    with pytest.raises(RobotError, match=r"options\.log: .*day\.nmea: ") as problem:
        asyncio.run(opened_body(robot(tmp_path, "day.nmea")))
    assert problem.value.code == 2
