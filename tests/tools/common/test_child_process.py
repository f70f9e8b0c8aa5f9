"""A process that ends with the one that has started it."""

import subprocess
import sys

from tools.common.child_process import ROOT

DEAF = """
import signal
from tools.common import child_process
came = []
signal.signal(signal.SIGTERM, lambda *_: came.append(0))
child_process.AGAIN_S = 0.01
child_process.end_with_input()
print("ready", flush=True)
while len(came) < 3:
    signal.pause()
print(len(came))
"""


def test_a_process_that_misses_the_signal_to_end_is_told_again() -> None:
    """The map of a launch that was killed in the moment of its start went on, and kept the port of its
    page."""
    words = [sys.executable, "-c", DEAF]
    with subprocess.Popen(words, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None and child.stdin is not None
        assert child.stdout.readline() == b"ready\n"
        child.stdin.close()
        assert child.stdout.readline() == b"3\n"
