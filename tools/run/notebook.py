"""A run from Python, for notebooks and scripts: play a scenario, look at what came of it.

    run = play("oxted", robots=8, seed=3, faults=[{"kind": "estop", "at_s": 60, "robot": 2}])
    run.coverage, run.makespan_s, run.rmse_m
    run.picture("sections")

It is the run of `headland run`, with the same trace hash. Nothing is written unless it is asked for.
"""

import re
from collections.abc import Callable
from contextlib import nullcontext
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from agent.interface.config import S
from sim.files.whole_file import whole_file, write_whole
from sim.fleet.scheduler import Script
from sim.fleet.simulated_fleet import Cluster
from sim.record.recorder_script import watch
from sim.record.recording import Recording
from sim.record.scene_builder import scene_of
from sim.runs.coverage_run import CoverageRun
from sim.scenarios.own_mission_setup import MissionMaker
from tools.report.chapter import COLUMNS, Chapter, chapters
from tools.report.command import write
from tools.report.page import table_of
from tools.report.run_data import RunEvidence
from tools.run.played_robot import PlayedRobot
from tools.run.run_mission import ProgressBar
from tools.run.run_plots import PLOTS
from tools.run.scenario_run import Faults, run_of


class Picture:
    """An SVG that shows itself where a notebook asks for it."""

    def __init__(self, svg: bytes, plot: Callable[[], Any] | None = None) -> None:
        """`plot`: draws the same values on axes of matplotlib, for other formats."""
        self.svg, self._plot = svg, plot

    def _repr_svg_(self) -> str:
        return self.svg.decode()

    def save(self, path: str | Path) -> None:
        """Write an `.svg`, or what matplotlib draws of the same values (`.png`, `.pdf`).

        Raises ValueError for another format, or if only an `.svg` is to be had, and OSError.
        """
        path = Path(path)
        if path.suffix == ".svg":
            write_whole(path, self.svg)
        elif self._plot is None:
            raise ValueError(f"{path}: this picture is an .svg")
        else:
            figure = self._plot().figure
            with whole_file(path if path.suffix else path.with_suffix(".png")) as part:
                figure.savefig(part)
            figure.clear()


def column_name(title: str) -> str:
    """The title of a column as a name: "RMSE, m" is `rmse_m`."""
    return re.sub(r"\W+", "_", title).strip("_").lower()


class Run:
    """What came of a scenario. Every field of its outcome is an attribute: `run.coverage`."""

    def __init__(
        self, outcome: Any, recording: Recording, tracks: dict[int, NDArray[np.float64]],
        faults: list[dict[str, Any]],
    ) -> None:  # fmt: skip
        """`outcome`: of the mission. `tracks`: where each robot truly was, (n, 3): seconds, metres
        east, metres north."""
        self.outcome, self.recording, self.tracks = outcome, recording, tracks
        self.figures = {
            **outcome.to_dict(), "faults": faults, "log_hash": recording.digest.hex
        }  # fmt: skip

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or "figures" not in self.__dict__:
            raise AttributeError(name)
        try:
            return self.figures[name]
        except KeyError:
            known = ", ".join([*self.figures, *self.chapters])
            raise AttributeError(f"a run has no {name}; it has {known}") from None

    def __dir__(self) -> list[str]:
        """Also the figures, so that a notebook completes them."""
        return sorted({*super().__dir__(), *self.figures})

    @property
    def robots(self) -> list[PlayedRobot]:
        """Each robot, by its slot."""
        return [PlayedRobot(self, slot) for slot in sorted(self.tracks)]

    @cached_property
    def chapters(self) -> dict[str, Chapter]:
        """Of its report, by name: tracks, planned, errors, sections, load, states, stops, events."""
        return {chapter.name: chapter for chapter in chapters(self._evidence)}

    @property
    def _evidence(self) -> RunEvidence:
        return RunEvidence(Path(), self.recording, self.figures, {}, 0)

    @property
    def rmse_m(self) -> dict[int, float]:
        """Of each robot, to the lines that it planned; nan where it drove none."""
        return {
            int(row["robot"]): float("nan") if row["RMSE, m"] is None else row["RMSE, m"]
            for row in self.table("planned")
        }

    def table(self, chapter: str) -> list[dict[str, Any]]:
        """All values of a chapter, a row each: ready for `pandas.DataFrame`.

        Numbers are numbers; None where there is none.
        """
        values = self._chapter(chapter).values
        if values is None:
            return []
        return [dict(zip(values[0], row, strict=True)) for row in values[1]]

    def frame(self, chapter: str) -> Any:
        """All values of a chapter as a pandas DataFrame; numbers have their unit in the name of the
        column, as `rmse_m`. Without values it has its columns and no rows. Raises ImportError without
        pandas."""
        import pandas

        rows = self.table(chapter)
        frame = pandas.DataFrame(rows, columns=None if rows else COLUMNS.get(chapter))
        return frame.rename(columns={name: column_name(name) for name in frame})

    def plot(self, what: str = "tracks", ax: Any = None) -> Any:
        """Draw on axes of matplotlib, and return them.

        `what`: tracks (where each robot truly was), sections, states, load, errors. `ax`: None: new axes.
        Raises ValueError for another word.
        """
        if what not in PLOTS:
            raise ValueError(f"no plot {what!r}: choose one of {', '.join(PLOTS)}")
        if ax is None:
            from matplotlib import pyplot

            ax = pyplot.subplots()[1]
        PLOTS[what](self, ax)
        return ax

    def picture(self, chapter: str = "tracks") -> Picture:
        """The picture of a chapter of the report. Raises ValueError if the chapter has none, or is
        not there."""
        found = self._chapter(chapter)
        if found.picture is None:
            raise ValueError(found.missing or f"{chapter} is a table: run.table({chapter!r})")
        return Picture(found.picture.svg, partial(self.plot, chapter) if chapter in PLOTS else None)

    def report(self, path: str | Path) -> Path:
        """The page of `headland report`, and the folder of its name. Returns where it is."""
        out = Path(path)
        if out.suffix != ".html":  # "field.v2" is a name without one
            out = out.with_name(f"{out.name}.html")
        write(out, self._evidence, list(self.chapters.values()))
        return out

    def _chapter(self, name: str) -> Chapter:
        if name == "errors" and name not in self.chapters:
            name = "planned"  # it says why there are none
        if name not in self.chapters:
            raise ValueError(f"no chapter {name}: choose one of {', '.join(self.chapters)}")
        return self.chapters[name]

    def _rows(self) -> list[tuple[str, Any]]:
        plain = (str, int, float, bool)
        return [(key, v) for key, v in self.figures.items() if isinstance(v, plain)]

    def __repr__(self) -> str:
        told = ", ".join(f"{key}={value!r}" for key, value in self._rows())
        return f"Run({told})"

    def _repr_html_(self) -> str:
        rows = self._rows()
        return table_of((("figure", "value"), rows), len(rows))


def play(
    scenario: str = "oxted",
    robots: int | None = None,
    seed: int | None = None,
    faults: Faults | None = None,
    time_limit_s: float | None = None,
    drive: str | None = None,
    mission: MissionMaker | None = None,
    progress: bool | None = None,
) -> Run:
    """Run a scenario to its end, in virtual time. ScenarioError where it cannot be.

    `scenario`: one that ships (`headland list`), or a file: .toml, a field, or a grid .map. `faults`:
    tables as in a scenario file, instead of its own. `mission`: what the robots of a field do instead of
    working its swaths, made for each with a `Site`. `progress`: a bar; None: where a person sees it.
    """
    run = run_of(scenario, robots, seed, faults, time_limit_s, drive, mission)
    recording = Recording()
    recording.scene = scene_of(run.setting)

    sampled: dict[int, list[tuple[float, float, float]]] = {}  # bodies on a grid keep no track

    def attach(cluster: Cluster) -> None:
        cluster.segment.taps.append(recording.write)
        watch(cluster, [recording])
        if isinstance(run, CoverageRun):
            cluster.host.spawn(_sample(cluster, sampled))

    run.attach = attach
    console = Console(stderr=True)
    seen = console.is_terminal or console.is_jupyter if progress is None else progress
    with ProgressBar(console, run.setting.scenario.name, run, "done") if seen else nullcontext():
        outcome = run.run()
    recording.close()
    cluster = run.cluster
    assert cluster is not None
    tracks = {slot: np.array(points) for slot, points in sampled.items()} or {
        slot: body.track.to_array()[:, :3] * (1e-6, 1.0, 1.0)
        for slot, body in cluster.world.robots.items()
    }
    return Run(outcome, recording, tracks, run.told_faults)


def _sample(cluster: Cluster, to: dict[int, list[tuple[float, float, float]]]) -> Script[None]:
    """Where each body is, twice a second."""
    while True:
        now_us = cluster.host.now_us()
        for slot, body in cluster.world.robots.items():
            to.setdefault(slot, []).append((now_us / S, *body.position))
        yield now_us + S // 2
