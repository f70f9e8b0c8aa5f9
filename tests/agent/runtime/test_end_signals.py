"""What ends a robot that somebody else's program runs."""

import asyncio
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from agent.runtime.end_signals import on_end
from tests.tools.launching import ENVIRONMENT

LIMIT_S = 60
PROGRAM = """
import asyncio, signal
from agent.runtime.end_signals import on_end

async def main():
    end = asyncio.Event()
    on_end(asyncio.get_running_loop(), end.set)
    print("ready", flush=True)
    await end.wait()
    open("farewell", "w").close()

asyncio.run(main())
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_robot_that_another_program_runs_says_farewell(
    number: signal.Signals, tmp_path: Path
) -> None:
    """`python -m headland.agent.runtime.robot_process` ended by SIGHUP without a farewell, and the
    documents call it the same process as `headland robot`."""
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM], cwd=tmp_path, env=ENVIRONMENT, stdout=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
    )  # fmt: skip
    assert process.stdout is not None and process.stdout.readline() == b"ready\n"
    process.send_signal(number)
    process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0 and (tmp_path / "farewell").exists()


@pytest.mark.parametrize("before", [signal.SIG_IGN, lambda number, frame: None])
def test_a_hang_up_that_is_ignored_or_handled_is_left_alone(before: Any) -> None:
    held = signal.signal(signal.SIGHUP, before)
    loop = asyncio.new_event_loop()
    try:
        on_end(loop, lambda: None)
        assert signal.getsignal(signal.SIGHUP) == before
    finally:
        loop.close()
        signal.signal(signal.SIGHUP, held)
