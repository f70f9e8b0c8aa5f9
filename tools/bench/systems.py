"""Doors to systems that people already run: each against a real counterpart that we did not write.

Each door has a module with `figures(quick)`. A door whose counterpart cannot be had here prints one
figure without a value, and says why in its scope.
"""

from collections.abc import Callable, Iterator
from importlib import import_module

from tools.bench.figure import Figure

# Name of the door -> its module. Doors are measured in this order.
DOORS = {
    "VDA 5050": "tools.bench.vda5050.figures",
    "ROS 2": "tools.bench.ros2_door",
    "ROS 2 bag": "tools.bench.bag_door",
    "Foxglove": "tools.bench.foxglove_door",
    "Prometheus": "tools.bench.prometheus_door",
    "MAPF": "tools.bench.mapf",
}


# The bound of a stop on the bus is in `headland bench stop`; a door may add this.
ADDED_MS = 100.0


class CounterpartAbsent(Exception):
    """One line: why the other side of a door cannot be had on this machine."""


def figures(quick: bool) -> Iterator[Figure]:
    """The figures of all doors."""
    prefix = __name__.removesuffix("tools.bench.systems")  # in a wheel: `headland.`
    for name, module in DOORS.items():
        try:
            measured: Callable[[bool], Iterator[Figure]] = import_module(prefix + module).figures
            yield from measured(quick)
        except CounterpartAbsent as absent:
            yield Figure(f"{name}: not measured", 0.0, "", "", None, "", str(absent))
        except ModuleNotFoundError as absent:
            why = f"{absent.name} is not installed"
            yield Figure(f"{name}: not measured", 0.0, "", "", None, "", why)
