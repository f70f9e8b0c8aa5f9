"""What `Inspector.to_dict` tells, as text: a table of robots, and lines below it."""

from typing import TYPE_CHECKING, Any

from agent.peer.self_health import POOR
from tools.common.counted import counted
from tools.inspect.inspector import NO_KEYS, latched_words

if TYPE_CHECKING:  # slow to import, and `--json` does without
    from rich.console import Console
    from rich.table import Table

# What is heard here is not proven, so that somebody without a key can make any robot a suspect.
SUSPECT = (
    "broken, or its key is stolen, or somebody speaks in its name: see what other robots trace "
    "(headland inspect --traces N) before headland keys revoke"
)
RELEASE_ASKED = "a release is asked for at its terminal; with a key: headland release"
UNKNOWN_SHOWN = 12  # groups of other devices in the text; --json has all


def table_of(seen: dict[str, Any]) -> "Table":
    """The robots, a row each."""
    from rich.table import Table

    table = Table(
        title=f"{counted(len(seen['robots']), '{} robot{s}')}, {seen['seconds']:.1f} s of the bus"
    )
    for column in (
        "robot",
        "address",
        "state",
        "peers",
        "sections",
        "vector clock",
        "replica",
        "path of states",
    ):
        table.add_column(column, overflow="fold", no_wrap=column in ("robot", "state"))
    for robot in seen["robots"]:
        state = (
            robot["state"]
            + (" (silent)" if robot["silent"] else "")
            + (" (left)" if robot["left"] else "")
            + ("" if robot["health"] == 1.0 else f" {robot['health']:.0%}")
        )
        clock = " ".join(f"{slot}:{count}" for slot, count in robot["clock"].items())
        replica = robot["replica"]
        if replica == "differs":
            replica += f": {robot['digest']}"
        path = " > ".join(f"{t['to']}@{t['t_s']:.1f}" for t in robot["transitions"][-6:])
        table.add_row(
            str(robot["slot"]), str(robot["address"]), state,
            " ".join(map(str, robot["peers"])),
            " ".join(robot["sections"]), clock, replica, path,
        )  # fmt: skip
    return table


def show(seen: dict[str, Any], console: "Console | None" = None) -> None:
    """To the terminal: the table, then what is wrong or strange, a line each."""
    from rich.console import Console

    console = console or Console()
    console.print(table_of(seen))
    done = sum(1 for s in seen["sections"].values() if s["phase"] == "DONE")
    console.print(f"sections heard of: {len(seen['sections'])}, done: {done}")
    if seen["leader"] is not None:
        console.print(f"leader: robot {seen['leader']} answers for the fleet", highlight=False)
    for robot in seen["robots"]:
        if robot["health"] <= POOR and not robot["left"]:
            ask = f"headland inspect --traces {robot['slot']} asks it why"
            console.print(
                f"robot {robot['slot']} health {robot['health']:.0%}: {ask}", highlight=False
            )
        if robot["release_asked"]:
            console.print(f"robot {robot['slot']}: {RELEASE_ASKED}", highlight=False)
        for why in robot["stands"]:
            console.print(f"robot {robot['slot']} stands: {why}", highlight=False)
        if "itinerary" in robot:
            stops, battery = ", ".join(robot["itinerary"]), robot["battery"]
            console.print(
                f"robot {robot['slot']}: \\[{stops}]  battery {battery:.0%}", highlight=False
            )
    console.print(f"frames: {', '.join(f'{n} {k}' for k, n in seen['frames'].items())}")
    console.print(f"bus load at worst-case stuffing: {seen['bus_load_worst_case']:.1%}")
    if seen["keyed"] is False:
        console.print(f"[bold red]{NO_KEYS}")
    for suspect in seen["suspects"]:
        console.print(f"[bold red]{suspect}: {SUSPECT}")
    if words := latched_words(seen):
        console.print(f"[bold red]EMERGENCY STOP latched: {words}")
    for key, whose in (
        ("unknown", "not of Headland"),
        ("other_makers", "of other makers, not read"),
    ):
        if seen[key]:
            groups = [f"{n} {name}" for name, n in seen[key].items()]
            beyond = len(groups) - UNKNOWN_SHOWN
            more = f" and {beyond} more groups" if beyond > 0 else ""
            console.print(f"{whose}: {', '.join(groups[:UNKNOWN_SHOWN])}{more}")
    if seen["other_frames"]:
        console.print(
            f"{seen['other_frames']} remote or error frames, or with an 11-bit identifier"
        )
    if seen["malformed"]:
        console.print(f"malformed: {seen['malformed']}")
