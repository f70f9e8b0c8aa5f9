"""A test whose counterpart cannot be had is skipped, with the reason."""

from pathlib import Path

import pytest

from tools.bench.systems import CounterpartAbsent
from tools.bench.vda5050.counterparts import Mosquitto, node_folder


def node_of(tmp: Path) -> Path:
    """Where node finds vda-5050-lib; mosquitto must be there, too."""
    try:
        Mosquitto(tmp)
        return node_folder(tmp)
    except CounterpartAbsent as absent:
        pytest.skip(str(absent))
