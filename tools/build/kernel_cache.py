"""Whether numba has compiled kernels on this machine before: the first run waits for them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from threading import Timer
from time import perf_counter
from types import TracebackType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console  # a robot asks whether there are kernels, and imports no rich

WAIT = "compiling kernels: once on this machine, about 25 s on two idle cores"
MORE = "compiling more kernels: once on this machine, up to two minutes on two idle cores"
TOLD_AFTER_S = 2.0  # shorter waits need no word
COMPILE = "numba:compile"  # numba's event; a kernel that it loads has none


def kernels_kept() -> int | None:
    """How many are in the cache; None: numba is not installed."""
    if find_spec("numba") is None:
        return None
    import numba

    folder = Path(numba.config.CACHE_DIR or "agent")
    root = folder if folder.is_absolute() else Path(__file__).parents[2] / folder
    return sum(1 for _ in root.rglob("*.nbi"))


def is_kept(kernel: Any) -> bool:
    """Whether the cache has code of this kernel that was compiled from its source as it is now.

    True also for one that numba never compiles: from a ready module, or plain Python."""
    cache = getattr(kernel, "_cache", None)  # numba says nothing of it in public
    if cache is None:
        return True
    try:
        return bool(cache._cache_file._load_index())
    except Exception:  # without a cache, or a damaged one: it is compiled
        return False


@contextmanager
def told_compiling(tell: Callable[[str], object]) -> Iterator[None]:
    """Call `tell` once with what is waited for, where the block compiles kernels for two seconds.

    A cache that is not empty may still lack the kernels of another mission, or those of real robots.
    `tell` is called in a thread of its own."""
    if find_spec("numba") is None:
        yield
        return
    from numba.core import event

    class Heard(event.Listener):
        """Adds up how long kernels were compiled; a kernel may compile others that it calls."""

        told, depth, spent_s, begun_s = False, 0, 0.0, 0.0
        timer: Timer | None = None

        def on_start(self, event: object) -> None:
            self.depth += 1
            if self.depth == 1 and not self.told:
                self.begun_s = perf_counter()
                self.timer = Timer(max(TOLD_AFTER_S - self.spent_s, 0.0), self.say)
                self.timer.daemon = True
                self.timer.start()

        def on_end(self, event: object) -> None:
            self.depth -= 1
            if self.depth == 0 and self.timer is not None:
                self.timer.cancel()
                self.spent_s += perf_counter() - self.begun_s

        def say(self) -> None:
            self.told = True
            tell(MORE)

    with event.install_listener(COMPILE, Heard()):
        yield


class Compiling:
    """How far compiling is: a bar at a terminal, elsewhere a line for each part that took long."""

    def __init__(self, console: "Console") -> None:
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
        )

        self.console = console
        self._bar = Progress(
            TextColumn("compiling {task.description}"), BarColumn(), MofNCompleteColumn(),
            TimeElapsedColumn(), console=console, transient=True, disable=not console.is_terminal,
        )  # fmt: skip
        self._task = self._bar.add_task("kernels", total=None)
        self._doing, self._since_s = "", perf_counter()

    def __enter__(self) -> "Compiling":
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        self._bar.stop()

    def step(self, done: int, of: int, name: str) -> None:
        """A part is done and the next one begins."""
        now_s = perf_counter()
        took_s = now_s - self._since_s
        if self._doing and took_s >= TOLD_AFTER_S and not self.console.is_terminal:
            self.console.print(f"compiled {self._doing} in {took_s:.0f} s: {done} of {of}")
        self._doing, self._since_s = name, now_s
        self._bar.update(self._task, completed=done, total=of, description=name)
