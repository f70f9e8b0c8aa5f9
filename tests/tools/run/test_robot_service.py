"""The unit and the image of a robot: systemd accepts the one, and `headland` understands both."""

import configparser
import json
import shlex
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from agent.interface.config import LEAVES_WITHIN_US, S
from agent.runtime.bodies.line_port import CONNECT_S, LOOK_S
from agent.runtime.ready_kernels import CACHE
from agent.runtime.robot_file import AbsentError
from agent.runtime.robot_process import GOODBYE_S, WRONG
from tests.tools.launching import ROOT
from tools.cli.entrance import robot_words

EXAMPLE = ROOT / "examples" / "robot"
UNIT = EXAMPLE / "headland@.service"
KERNELS = EXAMPLE / "headland-kernels.service"
LIMIT_S = 60


class UnitFile(configparser.ConfigParser):
    """Keys of systemd have capitals."""

    def optionxform(self, optionstr: str) -> str:
        return optionstr


@pytest.fixture
def unit() -> configparser.SectionProxy:
    parser = UnitFile(interpolation=None, strict=False)
    parser.read(UNIT)
    return parser["Service"]


def test_systemd_accepts_the_unit(tmp_path: Path) -> None:
    """With a root of its own, so that the machine need not have Headland."""
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd-analyze is not installed")
    units = tmp_path / "etc/systemd/system"
    program = tmp_path / "opt/headland/bin/headland"
    for folder in (units, program.parent, tmp_path / "usr/lib/systemd/system"):
        folder.mkdir(parents=True)
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    for each in (UNIT, KERNELS):
        shutil.copy(each, units)
    done = subprocess.run(
        [analyze, "verify", "--man=no", "--recursive-errors=no", f"--root={tmp_path}",
         "headland@3.service", KERNELS.name],
        capture_output=True, text=True, check=False, timeout=LIMIT_S,
    )  # fmt: skip
    if "unrecognized option" in done.stderr or "not supported" in done.stderr:
        pytest.skip(f"systemd-analyze is too old: {done.stderr.strip()}")
    assert (done.returncode, done.stderr) == (0, ""), done.stderr


def test_the_unit_starts_a_robot_and_does_not_restart_what_needs_a_person(
    unit: configparser.SectionProxy,
) -> None:
    program, *words = shlex.split(unit["ExecStart"].replace("%i", "3"))
    told = robot_words(words)
    assert program.endswith("/bin/headland")
    assert told is not None and (told.slot, told.interface, told.channel) == (
        3,
        "socketcan",
        "can0",
    )
    assert int(unit["RestartPreventExitStatus"]) == WRONG and unit["Restart"] == "on-failure"
    assert AbsentError.code != WRONG  # a receiver that comes later than the machine
    assert unit["KillSignal"] == "SIGTERM"  # on which a robot says farewell


def test_a_new_machine_is_started_by_hand_as_the_user_of_its_service(
    unit: configparser.SectionProxy,
) -> None:
    """As root it left a memory that the service could not open, and there was no folder for it."""
    user, program = unit["User"], unit["ExecStart"].split()[0]
    steps = [line[1:].split() for line in UNIT.read_text().splitlines() if line.startswith("#   ")]
    assert steps[1][:5] == ["install", "-d", "-o", user, f"/var/lib/{unit['StateDirectory']}"]
    assert steps[2][:4] == ["sudo", "-u", user, program]
    told = robot_words(steps[2][4:])
    assert told is not None and told.first_boot and told.interface == "socketcan"


def test_a_robot_that_brakes_has_time_for_its_farewell(unit: configparser.SectionProxy) -> None:
    """It was killed after 5 s, when it perhaps still braked, and the fleet stood for a silent member."""
    longest_s = LEAVES_WITHIN_US / S + GOODBYE_S + CONNECT_S + LOOK_S  # the last two end a port
    assert int(unit["TimeoutStopSec"]) > longest_s


def test_kernels_are_made_ready_before_a_robot_starts_and_where_it_looks_for_them(
    unit: configparser.SectionProxy,
) -> None:
    """A base install without them took 223 MB: nobody had called `headland compile --kernels`."""
    robots, kernels = UnitFile(interpolation=None, strict=False), UnitFile(interpolation=None)
    robots.read(UNIT)
    kernels.read(KERNELS)
    for order in ("After", "Wants"):
        assert KERNELS.name in robots["Unit"][order].split()
    made = kernels["Service"]
    assert shlex.split(made["ExecStart"])[1:] == ["compile", "--kernels"]
    assert Path(made["ExecStart"].split()[0]).name == "headland"
    for key in ("User", "CacheDirectory", "Environment"):
        assert made[key] == unit[key]
    assert unit["Environment"] == f"{CACHE}=/var/cache/{unit['CacheDirectory']}"


def test_the_image_starts_a_robot_and_installs_what_is_there() -> None:
    lines = (EXAMPLE / "Dockerfile").read_text().replace("\\\n", " ").splitlines()
    steps = [line.split(" ", 1) for line in lines if line and not line.startswith("#")]
    (entry,) = (json.loads(rest) for word, rest in steps if word == "ENTRYPOINT")
    shown = next(line for line in lines if "headland-robot fleet.toml" in line)
    words = shown.split("headland-robot ")[-1].split()
    assert robot_words([*entry[1:], *words]) is not None
    (run,) = (rest for word, rest in steps if word == "RUN")
    commands = [shlex.split(each) for each in run.split("&&")]
    assert [words[0].rpartition("/")[2] for words in commands] == ["python", "pip", "headland"]
    assert commands[1][-2:] == ["/src[nmea]", "setuptools"]
    copied = [rest.split() for word, rest in steps if word == "COPY"]
    made: dict[str, Any] = {"folder": commands[0][-1]}
    assert copied[1] == ["--from=made", made["folder"], made["folder"]]
    assert entry[0] == f"{made['folder']}/bin/headland"
