"""A fleet as it is declared, before it runs: `Fleet("small", robots=4).play(seed=3)`."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from sim.scenarios.own_mission_setup import MissionMaker
from tools.run.notebook import Run, play
from tools.run.parameter_sweep import sweep
from tools.run.scenario_run import Faults, run_of


@dataclass(frozen=True)
class Fleet:
    """A scenario with what you change of it. None: as the scenario says.

    `robots`: how many. `faults`: tables as in a scenario file. `mission`: what the robots of a field do
    instead of working its swaths; it is made for each robot with a `Site`.
    """

    scenario: str = "small"
    robots: int | None = None
    faults: Faults | None = None
    mission: MissionMaker | None = None
    drive: str | None = None
    time_limit_s: float | None = None

    def __post_init__(self) -> None:
        """Raises ScenarioError here, not in the middle of a sweep."""
        run_of(
            self.scenario, self.robots, None, self.faults, self.time_limit_s, self.drive, self.mission
        )  # fmt: skip

    def play(self, seed: int | None = None, *, progress: bool | None = None) -> Run:
        """Run it to its end in virtual time; the same seed gives the same run."""
        return play(
            self.scenario, self.robots, seed, self.faults, self.time_limit_s, self.drive,
            self.mission, progress,
        )  # fmt: skip

    def sweep(self, seeds: Iterable[int], *, progress: bool = True) -> Any:
        """A run for each seed: a pandas DataFrame with a row for each. Raises ImportError without
        pandas."""
        return sweep(
            self.scenario, (self.robots,), seeds, progress=progress, faults=self.faults,
            time_limit_s=self.time_limit_s, drive=self.drive, mission=self.mission,
        )  # fmt: skip
