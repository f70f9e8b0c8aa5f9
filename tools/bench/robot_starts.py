"""How long a robot takes to start on a field, and its memory: one robot with the body `nmea`, warm.

    python -m tools.bench.robot_starts FIELD.geojson --feature NAME --robots 6 --implement 3

The robot runs on a simulated machine in this process. `headland bench robot` has the meadow of the
tutorial and the field of its trials.
"""

import argparse
import asyncio
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from pyproj import Transformer

from agent.runtime.files.field_file import plane, read_boundary
from agent.runtime.ready_kernels import are_ready
from tools.bench.figure import Figure
from tools.bench.robot import process_figures, start_alone


def figures(
    file: Path, feature: str | None, robots: int, implement_width_m: float, seed: int = 1
) -> Iterator[Figure]:
    """`robots`: of the fleet, so that many sections are planned; one of them runs."""
    boundary = read_boundary(file, feature)
    to_degrees = Transformer.from_crs(plane(boundary.origin), "EPSG:4326", always_xy=True).transform
    corners = [to_degrees(x_m, y_m) for x_m, y_m, *_ in boundary.polygon.exterior.coords]
    with tempfile.TemporaryDirectory() as folder:
        yard, memory_mb = asyncio.run(
            start_alone(Path(folder), seed, corners, robots, implement_width_m)
        )
    scope = (
        f"alone of {robots}, implement {implement_width_m:g} m; load {os.getloadavg()[0]:.1f}; "
        f"{'kernels ready' if are_ready() else 'kernels by numba'}"
    )
    name = f"{feature or file.stem}, {boundary.polygon.area / 1e4:.3g} ha"
    yield from process_figures(name, yard, memory_mb, scope)


def main() -> None:
    """Prints the figures of one field."""
    parser = argparse.ArgumentParser(description=figures.__doc__)
    parser.add_argument("field", type=Path)
    parser.add_argument("--feature")
    parser.add_argument("--robots", type=int, default=1)
    parser.add_argument("--implement", type=float, default=3.0, help="width, metres")
    parser.add_argument("--json", action="store_true")
    words = parser.parse_args()
    for each in figures(words.field, words.feature, words.robots, words.implement):
        print(each.to_json() if words.json else f"{each.figure}: {each.value:.3g} {each.unit}")


if __name__ == "__main__":
    main()
