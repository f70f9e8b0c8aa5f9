"""Pictures of a run on axes of matplotlib, for notebooks and papers; metres, seconds, shares."""

from collections.abc import Callable, Mapping
from typing import Any

from sim.files.palette import colour_of
from tools.run.played_run import PlayedRun


def _tracks(run: PlayedRun, ax: Any) -> None:
    scene = run.recording.scene or {}
    for ring in scene.get("rings") or []:
        closed = [*ring, ring[0]]
        ax.plot([x for x, _ in closed], [y for _, y in closed], color="black", linewidth=1)
    for slot, track in sorted(run.tracks.items()):
        ax.plot(
            track[:, 1], track[:, 2], linewidth=0.8, color=colour_of(slot), label=f"robot {slot}"
        )
    ax.set_aspect("equal")
    ax.set_xlabel("m east")
    ax.set_ylabel("m north")
    ax.legend(fontsize="small")


def _sections(run: PlayedRun, ax: Any) -> None:
    for row in run.table("sections"):
        if row["phase"] == "STARTED" and row["owner"] is not None:
            begin_s, end_s = row["from_s"], row["until_s"]
            ax.barh(row["owner"], end_s - begin_s, left=begin_s, color=colour_of(row["owner"]),
                    edgecolor="white", linewidth=0.5)  # fmt: skip
    _of_robots(run, ax)


def _states(run: PlayedRun, ax: Any) -> None:
    rows = run.table("states")
    names = sorted({row["state"] for row in rows})
    for number, name in enumerate(names):
        own = [row for row in rows if row["state"] == name]
        widths = [row["until_s"] - row["from_s"] for row in own]
        ax.barh([row["robot"] for row in own], widths, left=[row["from_s"] for row in own],
                color=colour_of(number), label=name)  # fmt: skip
    ax.legend(fontsize="small")
    _of_robots(run, ax)


def _of_robots(run: PlayedRun, ax: Any) -> None:
    ax.set_xlabel("s")
    ax.set_ylabel("robot")
    ax.set_yticks(sorted(run.tracks))
    ax.invert_yaxis()


def _load(run: PlayedRun, ax: Any) -> None:
    rows = run.table("load")
    ax.plot([row["t_s"] for row in rows], [row["all"] for row in rows], linewidth=0.8)
    ax.set_ylim(bottom=0)
    ax.set_xlabel("s")
    ax.set_ylabel("share of the bus")


def _errors(run: PlayedRun, ax: Any) -> None:
    told = run.table("errors")
    for slot in sorted(run.tracks):
        rows = [row for row in told if row["robot"] == slot]
        ax.plot([row["t_s"] for row in rows], [row["off_m"] for row in rows],
                linewidth=0.6, color=colour_of(slot), label=f"robot {slot}")  # fmt: skip
    ax.set_xlabel("s")
    ax.set_ylabel("m off the line")
    ax.legend(fontsize="small")


PLOTS: Mapping[str, Callable[[PlayedRun, Any], None]] = {
    "tracks": _tracks, "sections": _sections, "states": _states, "load": _load, "errors": _errors,
}  # fmt: skip
