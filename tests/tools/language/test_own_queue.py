"""Goals that wait belong to the launch for which they were said."""

import json
from pathlib import Path

import pytest

from tools.common.bus_address import LAUNCH
from tools.common.run_folder import QUEUE, RUNS
from tools.language.say_options import Options, own_queue


def bus(port: int, interface: str = "socketcand") -> Options:
    return Options((interface, "can0", 250_000, "127.0.0.1", port))


def test_a_queue_is_in_the_folder_of_its_launch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert own_queue(bus(0).bus) == RUNS / QUEUE, "no launch"
    LAUNCH.parent.mkdir(parents=True)
    where = {"host": "127.0.0.1", "port": 5000, "folder": str(tmp_path / "runs" / "small-1")}
    LAUNCH.write_text(json.dumps(where))
    assert own_queue(bus(0).bus) == own_queue(bus(5000).bus) == tmp_path / "runs/small-1" / QUEUE
    assert own_queue(bus(5001).bus) == RUNS / QUEUE, "another bus"
    assert own_queue(bus(0, "socketcan").bus) == RUNS / QUEUE
