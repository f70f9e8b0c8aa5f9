"""One measured figure, as `headland bench` prints it: one JSON object a line."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sim.files.strict_json import dumps


class Figure(NamedTuple):
    """One line of a bench: a value, its target, and what it was compared with."""

    figure: str
    value: float
    unit: str
    target: str  # as the documents state it, for example "<= 0.30"
    holds: bool | None  # None: no target
    against: str  # what it is compared with, and its version
    scope: str  # what is and is not inside the measurement, equal on both sides

    def to_json(self) -> str:
        """All fields as one line, as `headland bench --json` prints it."""
        return dumps(self._asdict(), ensure_ascii=False)


def percentile(values: Sequence[float], share: float) -> float:
    """Of `values` by nearest rank: the least one that `share` of them do not exceed."""
    return float(np.quantile(values, share, method="inverted_cdf"))
