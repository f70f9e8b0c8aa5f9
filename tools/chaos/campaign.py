"""Where the runs of a campaign run: processes of this machine, or the workers of a Dask cluster.

A run is a pure function of its seed, so where it ran does not show in its result.
"""

import os
import signal
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing import parent_process
from multiprocessing.connection import wait
from threading import Thread
from typing import Any

CONNECT_S = "5s"


class ClusterError(Exception):
    """One line for the person: what is wrong and what to do."""


@contextmanager
def workers(jobs: int = 0, cluster: str = "") -> Iterator[Executor]:
    """`cluster`: address of a Dask scheduler, tcp/HOST:PORT or tcp://HOST:PORT; none: processes here.

    Raises ClusterError.
    """
    if not cluster:
        with ProcessPoolExecutor(jobs or os.cpu_count() or 1, initializer=end_with_parent) as pool:
            try:
                yield pool
            except BrokenProcessPool:
                raise ClusterError(
                    "a process of the campaign was killed; where memory is short, fewer --jobs need less"
                ) from None
            except BaseException:  # Ctrl-C too: what they compute is of no use any more
                for worker in list((pool._processes or {}).values()):
                    worker.terminate()
                # Waits for the thread of the pool: it closes a pipe that the interpreter writes to when
                # it ends, and printed a traceback where both came together.
                pool.shutdown(wait=True, cancel_futures=True)
                raise
        return
    try:
        from distributed import Client
    except ImportError:
        raise ClusterError("--cluster needs the package distributed: headland[backbone]") from None
    address = cluster.replace("tcp/", "tcp://", 1) if cluster.startswith("tcp/") else cluster
    try:
        client: Any = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError):
        raise ClusterError(
            f"no Dask scheduler answers at {cluster}: start one with 'dask scheduler', and workers "
            f"where headland is installed with 'dask worker {address}'"
        ) from None
    try:
        yield client.get_executor(pure=False)
    finally:
        with suppress(OSError, TimeoutError):
            client.close()


def end_with_parent() -> None:
    """Called in a worker: signals end it without a word, and so does the end of its parent, even by
    SIGKILL."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    parent = parent_process()
    assert parent is not None, "this is a process of its own"
    sentinel = parent.sentinel

    def watch() -> None:
        wait([sentinel])
        os._exit(1)

    Thread(target=watch, daemon=True).start()


def room(jobs: int = 0, cluster: str = "") -> int:
    """How many runs to hand out at a time."""
    return 2 * (jobs or os.cpu_count() or 1) if not cluster else 64
