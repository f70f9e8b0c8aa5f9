"""What pictures and robots of a run need to know of it."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sim.record.recording import Recording


class PlayedRun(Protocol):
    """A run that is over."""

    recording: Recording
    tracks: dict[int, NDArray[np.float64]]  # (n, 3): seconds, metres east, metres north

    @property
    def rmse_m(self) -> dict[int, float]:
        """Of each robot, to the lines that it planned."""
        ...

    def table(self, chapter: str) -> list[dict[str, Any]]:
        """All values of a chapter of its report, a row each."""
        ...
