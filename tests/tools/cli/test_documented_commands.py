"""No documented command rots: each is run as it stands, or parsed where a reason says why not run.

The documents' tutorial is carried out block by block in an empty folder.
"""

import asyncio
import os
import re
import signal
import subprocess
import sys
import tomllib
from asyncio.subprocess import DEVNULL, Process
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.tools.documented import ROOT, Shown, blocks, parse, shown
from tests.tools.launching import ENVIRONMENT, WAIT_S, robots_up, start

RUN_S = 300.0  # a run of the default field takes one minute on a quiet machine

# Run for real by `test_what_works_on_a_run` in this order, in a folder with one run in it.
RUN = (
    "report runs/latest", "report runs/latest -o report.html", "report runs/run", "inspect runs/latest",
    "inspect runs/latest --why S7", "inspect runs/latest --picture inspect.svg", "inspect --mermaid",
    "inspect runs/latest --speed", "export runs/latest --isoxml OUT",
    "export runs/latest --isoxml TASKDATA", "export runs/latest --geojson work.geojson",
    "replay runs/latest", "replay runs/latest --speed 10", "dbc", "dbc headland.dbc",
    "say --log runs/latest", "say --read", "keys new", "keys new keys", "keys rotate keys",
    "keys show keys", "coverage solve --H", "plan oxted --robots", "coverage replay vacuum_plan.json",
    "coverage replay PLAN", "--help", "--show-completion", "--version", "list", "doctor",
    "check small", "check --schema",
)  # fmt: skip
# What a base install does not have: tests/tools/cli/test_base_install.py.
NEED_SIM = {"launch", "run", "mapf", "coverage", "ros2", "vda5050", "plan", "list"}
# Why a command is only parsed, by what it contains; the first that fits.
PARSED = {
    "floor.map": "run by tests/tools/cli/test_tutorials.py",
    "house.toml": "run by test_tutorials.py",
    "depot.toml": "run by test_tutorials.py",
    "story.toml": "run by test_tutorials.py",
    "--port 29536": "run by test_tutorials.py",
    "rescue": "run by test_tutorials.py",
    "-i socketcan": "needs a real interface",
    "-i zenoh": "needs a router",
    "--cluster": "needs a Dask scheduler",
    "python -m": "run by the tests of its module",
    "--install-completion": "writes the start-up file of a shell",
    "bench": "minutes; tests/tools/bench/test_bench.py runs each kind",
    "chaos": "minutes; tests/chaos runs stories and campaigns",
    "fuzz": "minutes; tests/fuzz runs each target",
    "compile": "minutes and a C compiler; tests/tools/build/test_compiled_core.py",
    "warmup": "minutes on a cold cache; tests/tools/build/test_warmup.py",
    "coverage drive": "a minute; tests/tools/run/test_coverage.py",
    "coverage solve MAP": "a reader's own map",
    "headland mapf": "minutes on the maps shown; tests/tools/run/test_mapf.py",
    "headland ros2": "needs ROS 2; tests/tools/ros2",
    "headland run": "a minute each; run by tests of its mission",
    "keys rotate --running": "needs a launch; tests/tools/cli/test_keys.py",
    "headland keys rotate": "run above with its folder; named in a sentence without one",
    "keys rotate keys --running": "needs a launch; tests/tools/cli/test_keys.py",
    "keys log": "needs the files of a launch; tests/agent/runtime/test_release_log.py",
    "keys operator": "needs the files of an owner; tests/tools/cli/test_keys.py",
    "keys revoke": "needs a launch; tests/tools/cli/test_keys.py",
    "headland launch": "runs in real time; the tutorial's is run here",
    "headland fields": "a reader's own file; tests/tools/cli/test_given_files.py",
    "headland plan": "a reader's own file; tests/tools/run/test_plan.py",
    "headland tc": "runs until it is ended; tests/tools/run/test_task_controller.py",
    "headland hub": "runs until it is ended; tests/tools/cli/test_hub_restart.py",
    "headland bridge": "runs until it is ended; tests/tools/cli/test_bridge.py",
    "export runs/latest --film": "ten seconds; tests/tools/run/test_film.py",
    "--bag": "needs the extra ros; tests/sim/record/test_ros_bag.py",
    "headland robot": "runs until it is ended; tests/tools/run/test_robot_command.py",
    "headland machine": "runs until it is ended; tests/tools/run/test_body_check.py",
    "headland body-check": "needs a machine; tests/tools/run/test_body_check.py",
    "headland map": "serves until it is ended; tests/tools/livemap/test_map.py",
    "replay runs/latest/run.mcap": "as long as the run took",
    "headland order": "needs a launch; tests/tools/run/test_launch.py",
    "headland task add": "needs a launch; tests/tools/run/test_launch_delivery.py",
    "headland task list": "needs a launch; tests/tools/run/test_launch_delivery.py",
    "headland task status": "needs a launch; tests/tools/run/test_launch_delivery.py",
    "headland vda5050": "needs a broker; tests/tools/vda5050/test_master.py",
    "headland say": "needs a launch; the tutorial's is run here",
    "headland stop": "needs a launch; the tutorial's is run here",
    "headland release": "needs a launch; the tutorial's is run here",
    "headland new": "writes a file; tests/tools/cli/test_scenario_files.py",
    "headland inspect": "needs a launch; tests/tools/run/test_launch.py",
    "report candump.log": "a reader's own log",
    "report can.log": "a reader's own log",
    "report runs/chaos": "a campaign's folder",
    "report runs/trouble": "the tutorial's, run here",
}


def is_run(command: Shown) -> bool:
    words = command.text.split("#")[0].removeprefix("headland ").strip()
    exact = [
        word for word in RUN if "--" in word or " " in word or word in ("dbc", "list", "doctor")
    ]
    if "--running" in words:
        return False
    return any(words == word or words.startswith(f"{word} ") for word in exact)


@pytest.mark.parametrize("command", shown(), ids=lambda c: f"{c.where}: {c.text[:60]}")
def test_b2_every_documented_command_is_sorted_and_parses(command: Shown) -> None:
    words = command.words
    if words[0] == "python":
        assert find_spec(words[2]) is not None, f"no module {words[2]}"
        return
    if (
        "--install-completion" in words
        or "--show-completion" in words
        or {"--help", "-h"} & {*words}
    ):
        return
    parse(words, command.whole)
    assert is_run(command) or any(part in command.text for part in PARSED), (
        f"{command}: neither run here nor listed with a reason"
    )


def installed_by(extras: set[str]) -> set[str]:
    """These extras of ours, and the ones that they bring along."""
    table = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    found, left = set[str](), set(extras)
    while left:
        extra = left.pop()
        found.add(extra)
        named = re.findall(r"headland\[([\w,]+)\]", " ".join(table[extra]))
        left |= {word for words in named for word in words.split(",")} - found
    return found


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "use").glob("*.md")), ids=lambda p: p.stem)
def test_what_a_block_installs_is_enough_for_its_commands(page: Path) -> None:
    """Found: six pages that begin from nothing ended at their second command, for want of numpy."""
    for _, block in blocks(f"use/{page.name}"):
        installs = re.findall(r"^pip install '?headland(?:\[([\w,]+)\])?'?", block, re.M)
        if installs:
            commands = set(re.findall(r"^headland (\w+)", block, re.M))
            has = installed_by({word for words in installs for word in words.split(",") if word})
            assert not commands & NEED_SIM or "sim" in has, (page.name, commands & NEED_SIM, has)


@pytest.mark.slow
def test_b2_what_works_on_a_run_works_as_documented(tmp_path: Path) -> None:
    done = _headland(["run", "small"], tmp_path)
    assert done.returncode == 0, done.stderr
    tried = 0
    once = {command.text: command for command in shown() if is_run(command)}
    commands = sorted(once.values(), key=_turn)
    for command in commands:
        words = command.words[1:]
        if words[:2] == ["keys", "new"]:
            folder = words[2] if len(words) > 2 else "keys"
            if (tmp_path / folder).exists():  # several examples make a folder of the same name
                folder = f"keys{tried}"
            words = [*words[:2], folder, *words[3:]]
        if words[0] == "coverage" and words[1] == "replay":
            words = ["0" if w == "0.03" else w for w in words]
        done = _headland(words, tmp_path)
        assert done.returncode == 0, (command, done.stdout[-500:], done.stderr[-2000:])
        assert "Traceback" not in done.stderr, command
        tried += 1
    assert tried > 15


def _turn(command: Shown) -> int:
    words = command.text.removeprefix("headland ")
    return next(k for k, word in enumerate(RUN) if words.startswith(word))


def _headland(words: list[str], folder: Path) -> "subprocess.CompletedProcess[str]":
    """In bash, because `--show-completion` asks for the shell that calls it."""
    command = [sys.executable, "-m", "tools.cli.headland", *words]
    return subprocess.run(
        ["bash", "-c", '"$@"; exit $?', "bash", *command], cwd=folder, capture_output=True, text=True,
        check=False, timeout=RUN_S, env=ENVIRONMENT, stdin=subprocess.DEVNULL,
    )  # fmt: skip


@pytest.mark.slow
def test_b2_the_tutorial_works_as_written_in_an_empty_folder(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "use" / "tutorial.md").read_text()
    makefile = (ROOT / "Makefile").read_text()
    (recipe,) = re.findall(r"^demo: .*\n\t\$\(BIN\)/(headland .*) \$\(OPTIONS\)$", makefile, re.M)
    (scenario,) = re.findall(r"Write `(\w+\.toml)`", text)
    ran = 0
    for language, block in blocks("use/tutorial.md"):
        if language == "toml":
            (tmp_path / scenario).write_text(block)
            continue
        joined = block.replace("\\\n", " ")
        lines = [told for line in joined.splitlines() if (told := line.split("#")[0].strip())]
        lines = [recipe if line == "make demo" else line for line in lines]
        if lines[0].startswith("headland launch"):
            asyncio.run(_beside_a_launch(tmp_path, lines))
            ran += len(lines)
            continue
        for line in lines:
            words = Shown("tutorial.md", line).words
            extra = ["--page-port", "0"] if "--map" in words else []  # 8700 may be another test's
            done = _headland([*words[1:], *extra], tmp_path)
            assert done.returncode == 0, (line, done.stdout[-1000:], done.stderr[-2000:])
            ran += 1
    assert ran >= 9, "a block was not found"
    assert (tmp_path / "runs/trouble/report.html").exists()
    assert (tmp_path / "TASKDATA/TASKDATA.XML").exists()


async def _beside_a_launch(folder: Path, lines: list[str]) -> None:
    launched, *others = (Shown("tutorial.md", line).words[1:] for line in lines)
    launch: Process = await start(folder, *launched, "--page-port", "0")
    try:
        await robots_up(launch, 6)
        reading = asyncio.create_task(_read(launch))
        for words in others:
            other = await asyncio.create_subprocess_exec(
                sys.executable, "-m", "tools.cli.headland", *words, cwd=folder, stdin=DEVNULL,
                stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT, env=ENVIRONMENT,
            )  # fmt: skip
            async with asyncio.timeout(WAIT_S):
                out, _ = await other.communicate()
            assert other.returncode == 0, (words, out.decode()[-2000:])
        launch.send_signal(signal.SIGINT)
        async with asyncio.timeout(WAIT_S):
            await launch.wait()
            await reading
    finally:
        if launch.returncode is None:
            os.kill(launch.pid, signal.SIGKILL)
            await launch.wait()


async def _read(launch: Process) -> None:
    assert launch.stdout is not None
    async for _ in launch.stdout:
        pass
