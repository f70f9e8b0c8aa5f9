"""One robot of a run that is over: `run.robots[2].track`."""

from typing import Any

from tools.run.played_run import PlayedRun


class PlayedRobot:
    """What one robot truly did, in metres and seconds."""

    def __init__(self, run: PlayedRun, slot: int) -> None:
        self._run, self.slot = run, slot

    @property
    def track(self) -> Any:
        """Where it truly was: a pandas DataFrame with `t_s`, `x_m`, `y_m`. Raises ImportError without
        pandas."""
        import pandas

        return pandas.DataFrame(self._run.tracks[self.slot], columns=["t_s", "x_m", "y_m"])

    @property
    def driven_m(self) -> float:
        """How far it drove."""
        import numpy as np

        steps = np.diff(self._run.tracks[self.slot][:, 1:3], axis=0)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

    @property
    def rmse_m(self) -> float:
        """Root mean square distance to the lines that it planned; nan where it planned none."""
        return self._run.rmse_m.get(self.slot, float("nan"))

    @property
    def sections(self) -> list[str]:
        """The sections that it began to work, in this order: `["S3", "S7"]`."""
        rows = self._run.table("sections")
        own = [row for row in rows if row["owner"] == self.slot and row["phase"] == "STARTED"]
        return list(
            dict.fromkeys(row["section"] for row in sorted(own, key=lambda row: row["from_s"]))
        )

    def __repr__(self) -> str:
        return (
            f"Robot({self.slot}: {self.driven_m:.0f} m, sections {' '.join(self.sections) or '-'})"
        )
