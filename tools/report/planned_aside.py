"""Planned ways are read and drawn in a second process, while this one reads and draws the rest.

They come from a file of their own, `run.mcap`, and take as long as all else. The second process is a
fork: it starts in a millisecond. Where that is not safe (other threads run, or the system is no Linux),
or where there is one core, `planned_aside` gives None, and everything is done here.
"""

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tools.report.chapter import Chapter, Planned


@contextmanager
def planned_aside(source: Path) -> "Iterator[Planned | None]":
    """Begin with the planned ways of a run or log. What is given is told the scene and the beginning;
    what that returns waits for the chapters.

    It raises what `gather` raises for a damaged file, and SourceError if the process was ended.
    """
    from tools.livemap.command import notes_file

    alone = threading.active_count() == 1 and sys.platform == "linux"
    if not alone or (os.cpu_count() or 1) < 2 or not notes_file(source).is_file():
        yield None
        return
    from multiprocessing import get_context

    context = get_context("fork")
    here, there = context.Pipe()
    process = context.Process(target=_work, args=(source, there), daemon=True)
    process.start()
    there.close()

    def planned(scene: Any, zero_at_us: int) -> "Callable[[], list[Chapter]]":
        with suppress(OSError):  # it was ended; that is told where its chapters are waited for
            here.send((scene, zero_at_us))
        return chapters

    def chapters() -> "list[Chapter]":
        from tools.inspect.log_frames import SourceError

        try:
            found = here.recv()
        except (EOFError, OSError):
            raise SourceError(
                f"{source}: the process that reads its planned ways was ended"
            ) from None
        if isinstance(found, Exception):
            raise found
        drawn: list[Chapter] = found
        return drawn

    try:
        yield planned
    finally:
        process.kill()
        process.join()
        here.close()


def _work(source: Path, pipe: Any) -> None:
    from tools.livemap.command import recorded_notes

    try:
        recording = recorded_notes(source)
        from tools.report.chapter import planned_chapters

        scene, zero_at_us = pipe.recv()
        pipe.send(list(planned_chapters(recording, scene, zero_at_us)))
    except (EOFError, KeyboardInterrupt):
        pass  # nobody waits for it
    except Exception as problem:  # told where it is waited for
        pipe.send(problem)
