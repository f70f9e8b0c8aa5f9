"""`headland run` of a scenario with `mission = "errands"`: robots go to places in a building."""

from math import isfinite
from pathlib import Path
from statistics import fmean, median
from typing import Self

from sim.runs.navigation_run import NavigationOutcome, NavigationRun
from sim.scenarios.navigation_scenario import NavigationScenario, setting_of
from tools.common.result_table import NO_KEYS, Fact
from tools.run.path_picture import draw_paths
from tools.run.run_mission import MissionCommand


class NavigationCommand(MissionCommand[NavigationRun]):
    """Errands in virtual time, with a picture of each robot's path."""

    unit = "goals"

    @classmethod
    def of(cls, scenario: NavigationScenario) -> Self:
        """For the scenario as it was read."""
        return cls(NavigationRun(setting_of(scenario)))

    def draw(self, outcome: NavigationOutcome, folder: Path, log_hash: str) -> list[str]:
        return [f"{len(draw_paths(self.run, outcome, folder))} pictures of paths"]

    def facts(self, outcome: NavigationOutcome) -> list[Fact]:
        reached = [leg for leg in outcome.legs if isfinite(leg.arrived_s)]
        errors_m = [leg.rmse_m for leg in reached if isfinite(leg.rmse_m)]
        last_s = [t_s for t_s in outcome.arrived_s if isfinite(t_s)]
        ends = (
            f"; last goals after {median(last_s):.0f} s (median), {max(last_s):.0f} s"
            if last_s
            else ""
        )
        planned = f"{sum(leg.replans for leg in outcome.legs)} paths planned again on the way"
        return [
            ("goals", f"{len(reached)} of {len(outcome.legs)} reached{ends}"),
            ("contacts", f"{outcome.contacts} (closest {outcome.closest_m:.2f} m)"),
            ("paths", f"RMSE {fmean(errors_m) if errors_m else 0.0:.3f} m; {planned}"),
            ("agreement", f"{outcome.rounds} rounds, {outcome.unsolved} of them without a plan"),
            ("boxes", f"{outcome.obstacles} came and went"),
            ("replicas", "equal" if outcome.replicas_equal else "[red]differ[/red]"),
            ("driven", f"{outcome.travel_m:.0f} m in {outcome.simulated_s:.0f} s simulated"),
            ("bus load", f"{outcome.bus_load:.1%}"),
            ("malformed frames", str(outcome.malformed)),
            ("authentication", "keys" if outcome.authenticated else NO_KEYS),
        ]
