"""The launch that runs here, for a tool that joins its bus: where that is, whose keys, which robots.

The map and the node of ROS 2 both read it, and both hear what the robots of a launch intend.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from agent.runtime.files.given_file import GivenFileError
from sim.record.intent_stream import IntentListener
from tools.common.bus_address import LAUNCH, said_by
from tools.common.launch_keys import keys_in


class RunningLaunch(NamedTuple):
    """What a launch has written of itself."""

    host: str
    port: int
    channel: str
    folder: Path  # of its run, where the scene is
    keys: Path | None  # the folder of its keys; None: it has none, or they are not for this user
    bodies: Path | None  # where robots tell what they intend


def running_launch(file: Path = LAUNCH) -> RunningLaunch | None:
    """The launch that has written this file; None if there is none, or it does not say where its bus is.

    Raises AttachError where it is another user's.
    """
    try:
        where: dict[str, Any] = dict(said_by(file))
        host, port, channel = str(where["host"]), int(where["port"]), str(where["channel"])
    except (GivenFileError, KeyError, TypeError, ValueError):
        return None
    bodies = where.get("bodies")
    return RunningLaunch(
        host, port, channel, Path(str(where.get("folder", "."))), keys_in(file, where),
        Path(str(bodies)) if bodies else None,
    )  # fmt: skip


async def watch_intents(bodies: Path, intend: Callable[[dict[str, Any]], None]) -> None:
    """Pass on what the robots of a launch intend, until it is cancelled.

    It returns where the launch has ended, or is another user's: frames are heard all the same.
    """
    watching = IntentListener(intend)
    try:
        await watching.connect(bodies)
        await watching.run()
    except OSError:
        return
    finally:
        watching.end()
