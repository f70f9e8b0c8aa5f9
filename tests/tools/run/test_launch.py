"""A launch with real processes: one killed, all stopped from outside, released, and none left over."""

import asyncio
import contextlib
import json
import os
import signal
from pathlib import Path
from socket import socket

import pytest

from tests.tools.complaint import Complaints
from tests.tools.launching import WAIT_S, call, robots_up, said, start, states

HANG_S, TRIES = 1.5, 10  # longer than any silence is tolerated; looks until all are back


async def gone(pids: list[int]) -> None:
    """The kernel tells when a process has ended, ours or not."""
    async with asyncio.timeout(WAIT_S):
        for pid in pids:
            await ended(pid)


async def ended(pid: int) -> None:
    loop, over = asyncio.get_running_loop(), asyncio.Event()
    try:
        descriptor = os.pidfd_open(pid)
    except ProcessLookupError:
        return
    loop.add_reader(descriptor, over.set)
    try:
        await over.wait()
    finally:
        loop.remove_reader(descriptor)
        os.close(descriptor)


async def orders(folder: Path) -> None:
    """Robots obey what they can obey, and say so."""
    for words, code, answer in (
        (("1", "set-goal", "20,-10"), 0, "UNDER_WAY"),
        (("1", "continue"), 0, "WORKING"),
        (("1", "continue"), 1, "REFUSED"),
        (("1", "set-goal", "3000,0"), 1, "REFUSED"),
        (("0", "stop"), 0, "STOPPED"),
        (("0", "start"), 0, None),
    ):
        got, text = await call(folder, "order", *words, "--json")
        told = json.loads(text)
        assert (got, told["answer"]) in ((code, answer), (code, "ARRIVED")), (words, text)
        assert told["obeyed"] is (code == 0) and told["signed"], (
            "a launch has keys, which its user's tools take"
        )
    got, text = await call(folder, "say", "where is robot 1", "--by", "0", "--json")
    told = json.loads(text)
    assert got == 0 and told["told_by"] == "robot 0" and told["answers"][0][0]["slot"] == 1, text
    got, text = await call(folder, "say", "stop robot 7", "--json")
    assert got == 3 and json.loads(text)["asked_back"]["reason"] == "unknown robot", text
    got, text = await call(folder, "order", "9", "wait")
    assert got == 1 and "robot 9 is not heard" in text and text.count("\n") == 1


async def hangs(folder: Path, pid: int) -> None:
    """A process stands still longer than silence is tolerated, and goes on: a robot, whose silence the
    others notice, or the one that is the bus, where all fall silent. Then all are members again."""
    os.kill(pid, signal.SIGSTOP)
    try:
        async with asyncio.timeout(HANG_S):
            await asyncio.Event().wait()
    except TimeoutError:
        os.kill(pid, signal.SIGCONT)
    for _ in range(TRIES):
        if set((now := await states(folder)).values()) <= {"IDLE", "WORKING"} and len(now) == 3:
            return
    raise AssertionError(f"after SIGSTOP and SIGCONT of {pid}: {now}")


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="orphans are watched by pidfd, of Linux")
def test_kill_stop_release_and_leave_no_orphans(tmp_path: Path) -> None:
    async def story() -> None:
        launch = await start(tmp_path, "launch", "small")
        pids = await robots_up(launch, 3)
        try:
            again, text = await call(tmp_path, "launch", "small")
            assert again == 2 and "another run or launch" in text and text.count("\n") == 1
            await orders(tmp_path)
            await hangs(tmp_path, pids[1])
            await hangs(tmp_path, launch.pid)
            os.kill(pids[2], signal.SIGKILL)
            code, text = await call(tmp_path, "estop", "--json")
            told = json.loads(text)  # who was killed has confirmed nothing
            assert code == 1 and told["not_heard"] == [2] and not told["not_stopped"], text
            assert set(told["stopped"]) == {0, 1}
            after = await states(tmp_path)
            assert after == {0: "EMERGENCY_STOP", 1: "EMERGENCY_STOP"}
            code, text = await call(tmp_path, "reset", "--start", "--json")
            told = json.loads(text)
            assert code == 1 and told["not_heard"] == [2] and not told["not_released"], text
            assert len(told["cleared"]) >= 1
            assert set((await states(tmp_path)).values()) <= {"IDLE", "WORKING"}
            launch.send_signal(signal.SIGINT)
            async with asyncio.timeout(WAIT_S):
                await launch.wait()
            await gone(pids)
        finally:
            if launch.returncode is None:
                launch.kill()
                await launch.wait()

    asyncio.run(story())


@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="orphans are watched by pidfd, of Linux")
def test_robots_end_when_the_launcher_is_killed(tmp_path: Path) -> None:
    async def story() -> None:
        launch = await start(tmp_path, "launch", "small", "--robots", "2")
        pids = await robots_up(launch, 2)
        launch.kill()
        await launch.wait()
        await gone(pids)

    asyncio.run(story())


@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="orphans are watched by pidfd, of Linux")
def test_the_map_ends_when_the_launcher_is_killed(tmp_path: Path) -> None:
    """It kept the port of its page, so that the next launch could not have it."""

    async def story() -> None:
        launch = await start(
            tmp_path, "launch", "small", "--robots", "1", "--map", "--page-port", "0"
        )
        await said(launch, "^map: (http.*)   ")
        children = children_of(launch.pid)
        launch.kill()
        try:
            await gone(children)
        finally:
            for pid in children:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            await launch.wait()
        assert len(children) == 2, "a robot and the map"

    asyncio.run(story())


def children_of(parent: int) -> list[int]:
    """Processes whose parent is this one: the fourth field of their status, behind a name in brackets."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            if int(status.read_text().rpartition(")")[2].split()[1]) == parent:
                found.append(int(status.parent.name))
    return found


def test_a_port_in_use_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    with socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        words = f"launch small --port {taken.getsockname()[1]}"
        told = Complaints(monkeypatch, capfd).of(words, tmp_path)
    assert told.code == 2 and "--port" in told.line
