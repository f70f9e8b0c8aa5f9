"""What `headland say` was told, and where goals of its launch wait."""

from pathlib import Path
from typing import NamedTuple

from tools.common.bus_address import Attached, folder_of_launch
from tools.common.run_folder import QUEUE, RUNS


class Options(NamedTuple):
    """As given on the command line."""

    bus: Attached
    key: Path | None = None
    places: Path | None = None
    queue: Path | None = None  # None: in the folder of the launch whose bus it is
    by: str | None = None
    endpoint: str | None = None
    model: str = "default"
    timeout_s: float = 5.0
    wait: bool = True  # until goals that are queued were given
    yes: bool = False
    read_only: bool = False  # show how phrases are read, and do nothing
    log: Path | None = None
    as_json: bool = False


def own_queue(bus: Attached) -> Path:
    """Goals of a launch are in its folder: the next fleet, on another field, does not get them."""
    interface, _, _, host, port = bus
    return (folder_of_launch(interface, host, port) or RUNS) / QUEUE
