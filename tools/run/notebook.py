"""A run from Python, for notebooks and scripts: play a scenario, look at what came of it.

    run = play("oxted", robots=8, seed=3, faults=[{"kind": "estop", "at_s": 60, "robot": 2}])
    run.coverage, run.makespan_s, run.rmse_m
    run.picture("sections")

It is the run of `headland run`, with the same trace hash. Nothing is written unless it is asked for.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.fleet.outcome import FieldOutcome
from sim.fleet.simulated_fleet import Cluster
from sim.record.recorder_script import watch
from sim.record.recording import Recording
from sim.record.scene_builder import scene_of
from sim.runs.field_run import FieldRun
from sim.runs.navigation_run import NavigationOutcome, NavigationRun
from sim.scenarios.delivery_scenario import is_warehouse
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.navigation_scenario import NavigationScenario, load_mission, setting_of
from sim.scenarios.navigation_setup import NavigationSetup
from sim.scenarios.scenario import Scenario, ScenarioError
from tools.report.chapter import Chapter, chapters
from tools.report.command import write
from tools.report.page import table_of
from tools.report.run_data import RunEvidence


class Picture:
    """A PNG that shows itself where a notebook asks for it."""

    def __init__(self, png: bytes) -> None:
        self.png = png

    def _repr_png_(self) -> bytes:
        return self.png

    def save(self, path: str | Path) -> None:
        """Write the PNG. Raises OSError."""
        Path(path).write_bytes(self.png)


class Run:
    """What came of a scenario. Every field of its outcome is an attribute: `run.coverage`."""

    def __init__(
        self, outcome: FieldOutcome | NavigationOutcome, recording: Recording,
        tracks: dict[int, NDArray[np.float64]], faults: list[dict[str, Any]],
    ) -> None:  # fmt: skip
        """`tracks`: where each robot truly was, (n, 3): seconds, metres east, metres north."""
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
        """All values of a chapter as a pandas DataFrame. Raises ImportError without pandas."""
        import pandas

        return pandas.DataFrame(self.table(chapter))

    def plot(self, ax: Any = None) -> Any:
        """Draw the outline and where each robot truly was, metres; returns the axes.

        `ax`: axes of matplotlib; None: new ones.
        """
        if ax is None:
            from matplotlib import pyplot

            ax = pyplot.subplots()[1]
        for ring in (self.recording.scene or {}).get("rings") or []:
            closed = [*ring, ring[0]]
            ax.plot([x for x, _ in closed], [y for _, y in closed], color="black", linewidth=1)
        for slot, track in sorted(self.tracks.items()):
            ax.plot(track[:, 1], track[:, 2], linewidth=0.8, label=f"robot {slot}")
        ax.set_aspect("equal")
        ax.set_xlabel("m east")
        ax.set_ylabel("m north")
        ax.legend(fontsize="small")
        return ax

    def picture(self, chapter: str = "tracks") -> Picture:
        """The picture of a chapter of the report. Raises ValueError if the chapter has none, or is
        not there."""
        found = self._chapter(chapter)
        if found.picture is None:
            raise ValueError(found.missing or f"{chapter} is a table: run.table({chapter!r})")
        return Picture(found.picture)

    def report(self, path: str | Path) -> Path:
        """The page of `headland report`, and the folder of its name. Returns where it is."""
        out = Path(path).with_suffix(".html")
        write(out, self._evidence, list(self.chapters.values()))
        return out

    def _chapter(self, name: str) -> Chapter:
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
    faults: Sequence[Mapping[str, Any]] | None = None,
    time_limit_s: float | None = None,
    drive: str | None = None,
) -> Run:
    """Run a field or a building to its end, in virtual time. ScenarioError where it cannot be.

    `scenario`: a file, or one that ships. `faults`: tables as in a scenario file, instead of its own.
    """
    if is_warehouse(scenario):
        raise ScenarioError(f"{scenario}: a warehouse: headland run {scenario}")
    changed = load_mission(scenario).changed(
        robots, seed, None, None, drive, faults, time_limit_s
    )  # fmt: skip
    recording = Recording()

    def attach(cluster: Cluster) -> None:
        cluster.segment.taps.append(recording.write)
        watch(cluster, [recording])

    run = _errands(changed, recording, attach) if isinstance(changed, NavigationScenario) else None
    return run or _field(changed, recording, attach)


def _field(scenario: Scenario, recording: Recording, attach: Any) -> Run:
    setting = FieldSetup(scenario)
    recording.scene = scene_of(setting)
    expedition = FieldRun(setting, attach=attach)
    outcome = expedition.run()
    recording.close()
    tracks = {
        slot: np.array([(t_us / 1e6, x, y) for t_us, x, y, _ in track])
        for slot, track in expedition.tracks.items()
    }
    return Run(outcome, recording, tracks, expedition.told_faults)


def _errands(scenario: NavigationScenario, recording: Recording, attach: Any) -> Run:
    setting: NavigationSetup = setting_of(scenario)
    recording.scene = scene_of(setting)
    outing = NavigationRun(setting, attach=attach)
    outcome = outing.run()
    recording.close()
    tracks = {slot: rows[:, :3] * (1e-6, 1.0, 1.0) for slot, rows in outing.tracks.items()}
    return Run(outcome, recording, tracks, [])
