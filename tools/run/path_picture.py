"""Pictures of how robots followed their paths: one PNG for each robot."""

from collections.abc import Sequence
from pathlib import Path

from agent.mapping.building import Floor
from sim.files.whole_file import whole_file
from sim.runs.navigation_run import NavigationOutcome, NavigationRun


def draw_paths(outing: NavigationRun, outcome: NavigationOutcome, folder: Path) -> list[Path]:
    """`robot_N.png`: walls, the polylines that were followed, the track, and the error."""
    folder.mkdir(parents=True, exist_ok=True)
    return [_draw(outing, outcome, slot, folder) for slot in sorted(outing.tracks)]


def _draw(outing: NavigationRun, outcome: NavigationOutcome, slot: int, folder: Path) -> Path:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 7), dpi=110)
    axes = figure.subplots()
    _walls(axes, outing.setting.floor)
    shown: set[str] = set()
    for path in outing.followed[slot]:
        style = {"goal": "-", "plan": ":"}.get(path.why, "--")
        label = None if path.why in shown else f"planned ({path.why})"
        shown.add(path.why)
        xs, ys = zip(*path.points, strict=True)
        axes.plot(xs, ys, style, color="tab:blue", linewidth=2.5, alpha=0.6, label=label)
    track = outing.tracks[slot]
    axes.plot(track[:, 1], track[:, 2], color="tab:red", linewidth=1.0, label="driven")
    axes.plot(*outing.setting.starts[slot], "ko", markersize=6, label="start")
    for goal in outing.setting.goals[slot]:
        axes.plot(*goal, "k*", markersize=10)
    errors = [leg.rmse_m for leg in outcome.legs if leg.slot == slot]
    axes.set_title(f"robot {slot}: RMSE {', '.join(f'{e:.3f} m' for e in errors)}")
    axes.set_aspect("equal")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    axes.legend(loc="upper right", fontsize=8)
    figure.tight_layout()
    out = folder / f"robot_{slot}.png"
    with whole_file(out) as part:
        figure.savefig(part)
    return out


def _walls(axes, floor: Floor) -> None:  # type: ignore[no-untyped-def]
    rows, columns = floor.walls.shape
    west, south = floor.origin
    east, north = west + columns * floor.cell_m, south + rows * floor.cell_m
    extent: Sequence[float] = (west, east, south, north)
    axes.imshow(floor.walls, origin="lower", extent=extent, cmap="Greys", vmax=2.0)
