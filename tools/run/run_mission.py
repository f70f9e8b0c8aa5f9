"""The body that all kinds of `headland run` share: a run, its folder, report, and table.

Each mission is a small subclass of `MissionCommand`. It says how its outcome is shown and drawn.
"""

import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from shlex import quote
from time import perf_counter
from typing import Any, Generic, TypeVar

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from agent.exploration.exploration_task import FleetFullError
from sim.files.can_log import open_log
from sim.files.strict_json import dumps
from sim.files.whole_file import write_whole
from sim.record.recording import Recording
from sim.runs.run import MissionRun, RunProgress
from sim.scenarios.scenario import ScenarioError
from tools.build.kernel_cache import WAIT, kernels_kept, told_compiling
from tools.common.exit_codes import code_of, wrong
from tools.common.progress import shows_progress
from tools.common.result_table import Fact, run_table
from tools.common.run_folder import RUNS, FolderError, folder_for
from tools.common.verbosity import Verbosity
from tools.livemap.command import MapThread, ServerError
from tools.run.film import write_told_film
from tools.run.run_recorder import RunRecorder

FILM = "film.gif"  # of `--film`
UNFINISHED = 1  # exit code of a run with a flaw
RunT = TypeVar("RunT", bound=MissionRun[Any, Any, Any])


class RunError(Exception):
    """A run that could not take place: one line for the person."""


class MissionCommand(ABC, Generic[RunT]):
    """What differs between missions on the command line: the rows of the table, what is drawn, and
    the exit code."""

    unit = ""  # of which progress is counted
    follow_up: tuple[tuple[str, str], ...] = ()  # commands for what this mission leaves, and why
    # Compiles what its runs need, where nothing is compiled yet. None: the run does, as it goes on.
    warm: Callable[[], None] | None = None

    def __init__(self, run: RunT) -> None:
        self.run = run

    @abstractmethod
    def facts(self, outcome: Any) -> list[Fact]:
        """The rows of the table between its first and the last ones, which all tables have."""

    @abstractmethod
    def draw(self, outcome: Any, folder: Path, log_hash: str) -> list[str]:
        """Write what this mission leaves besides the report and the logs; returns the names."""

    def report(self, outcome: Any) -> dict[str, Any]:
        """Further keys of `report.json`: what was done to the fleet."""
        return {"faults": self.run.told_faults}

    def play(self, console: Console, folder: Path, recorder: RunRecorder) -> Any:
        """Run to the end; returns the outcome."""
        return self.run.run()

    def exit_code(self, outcome: Any) -> int:
        """0 for a run without a flaw, else 1."""
        return 0 if outcome.success else UNFINISHED


def run_mission(
    make: Callable[[], MissionCommand[Any]], out: Path | None, as_json: bool,
    logs: Sequence[Path] = (), page_port: int | None = None, film: bool = False,
) -> int:  # fmt: skip
    """Run a mission to its end; returns the exit code.

    `make` may raise ScenarioError. `page_port`: of a map that shows the run, and at a terminal stays
    after its end. `film`: also film.gif, what `headland export --film` makes.
    """
    with ExitStack() as held:
        return _run_mission(held, make, out, as_json, logs, page_port, film)


def _run_mission(
    held: ExitStack, make: Callable[[], MissionCommand[Any]], out: Path | None, as_json: bool,
    logs: Sequence[Path], page_port: int | None, film: bool,
) -> int:  # fmt: skip
    """`held`: what ends with the run, as the lock of its folder."""
    console = Console(stderr=as_json, quiet=Verbosity.quiet)
    shown = None
    try:
        command = make()
        setting = command.run.setting
        name = setting.scenario.name
        for log in logs:
            open_log(log).close()  # so that a wrong argument is reported before the run
        folder = held.enter_context(folder_for(out, name))
        if page_port is not None:
            shown = MapThread(Recording(), setting.field.name, page_port)
        recording = shown.server.recording if shown is not None else Recording() if film else None
        recorder = RunRecorder(setting, folder, recording)
    except (ScenarioError, ServerError, FolderError) as problem:
        return wrong(problem)
    except (OSError, ValueError) as problem:
        return wrong(f"{'--out or --log' if logs else '--out'}: {problem}", code_of(problem))
    if shown is not None:
        console.print(f"map: {shown.url}")
    if kernels_kept() == 0:
        _compile(console, command.warm)
    command.run.out, command.run.logs, command.run.attach = folder, logs, recorder
    try:
        with ProgressBar(console, name, command.run, command.unit), told_compiling(console.print):
            outcome = command.play(console, folder, recorder)
    except (RunError, FleetFullError) as problem:
        return wrong(problem)
    finally:
        recorder.close()
    report = {**outcome.to_dict(), "log_hash": recorder.log_hash, **command.report(outcome)}
    write_whole(folder / "report.json", dumps(report, indent=1) + "\n")
    drawn = command.draw(outcome, folder, recorder.log_hash)
    if film and recording is not None:
        write_told_film(console, recording, folder / FILM)
        drawn.append(FILM)
    if as_json:
        print(dumps(report), flush=True)
    else:
        console.print(run_table(outcome, command.facts(outcome)))
        written = ", ".join(["report.json", *drawn, "trace.jsonl", recorder.logs])
        console.print(escape(f"{written} are in {folder}"))
        tell_next(console, next_commands(folder, command.follow_up))
    if shown is not None and sys.stdout.isatty():  # without a person it would never end
        console.print(f"the map stays at {shown.url} until Ctrl-C")
        held.close()  # all is written, and another run may have the folder
        shown.join()
    return command.exit_code(outcome)


def _compile(console: Console, warm: Callable[[], None] | None) -> None:
    """Say what is waited for and how long it takes, also while the page is already served."""
    console.print(WAIT)
    if warm is None:
        return
    begun_s = perf_counter()
    with console.status("compiling kernels ..."):
        warm()
    console.print(f"compiled in {perf_counter() - begun_s:.0f} s")


LOOKS = (
    ("report {}", "one page: tracks, stops, bus load"),
    ("map {}", "the run in a browser"),
    ("inspect {}", "states, sections, which robot knew what"),
)


def next_commands(folder: Path, further: Sequence[tuple[str, str]] = ()) -> str:
    """The commands that look at this run; the newest is shorter to name."""
    latest = RUNS / "latest"
    name = quote(
        str(latest if latest.exists() and latest.resolve() == folder.resolve() else folder)
    )
    rows = [(f"headland {words.format(name)}", why) for words, why in (*LOOKS, *further)]
    width = max(len(words) for words, _ in rows)
    return "next:\n" + "\n".join(f"  {words:<{width}}  # {why}" for words, why in rows)


def tell_next(console: Console, following: str) -> None:
    """Print it as it is: a comment on a line of its own is a command of its own where it is pasted."""
    console.print(following, highlight=False, markup=False, soft_wrap=True)


class ProgressBar(Progress):
    """How far a run is: a bar, the simulated seconds, what is done, and what the robots do."""

    def __init__(
        self, console: Console, title: str, run: MissionRun[Any, Any, Any], unit: str
    ) -> None:
        super().__init__(
            TextColumn("{task.description}", markup=False), BarColumn(),
            TextColumn("{task.percentage:>5.1f} %"),
            TextColumn("{task.fields[note]}"), TimeElapsedColumn(), console=console,
            transient=True, disable=not shows_progress(console),
        )  # fmt: skip
        self._bar, self._unit = self.add_task(title, total=1.0, note=""), unit
        run.told = self._tell

    def _tell(self, now: RunProgress) -> None:
        note = f"{now.simulated_s:.0f} s, {now.done}/{now.total} {self._unit}, {now.note}"
        self.update(self._bar, completed=now.share, note=note)
