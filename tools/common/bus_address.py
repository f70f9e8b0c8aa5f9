"""Where a bus is: as options say it, or that of the newest launch in this folder.

It is read before anything is imported that a bus needs: a tool that finds no launch says so at once.
"""

from pathlib import Path
from typing import Any

from agent.runtime.files.given_file import SETTINGS_BYTES_MAX, GivenFileError, read_json
from tools.common.file_owner import is_own
from tools.common.process_identity import lives

LAUNCH = Path("runs/launch/bus.json")  # where a launch leaves the address of its bus
CHANNEL = "can0"  # of the bus of a launch
LOCAL_NAMES = {"127.0.0.1", "localhost"}  # of one and the same host
Attached = tuple[str, str, int, str, int]  # interface, channel, bit rate, host, port


class AttachError(Exception):
    """One line for the person: what is wrong and what to do."""


def said_by(launch: Path) -> Any:
    """What a launch has written in this file of where its bus is.

    Raises GivenFileError, and AttachError where another user may have written it: a stop would go to a
    bus of that user's choice.
    """
    where = read_json(launch, SETTINGS_BYTES_MAX)
    if not is_own(launch):
        port = where.get("port") if isinstance(where, dict) else None
        named = f" --port {port}" if isinstance(port, int) else ""
        raise AttachError(
            f"the launch in {launch.parent} is another user's, or others may write its {launch.name}: "
            f"name its bus if you trust it:{named or ' --host and --port'}"
        )
    return where


def _believed(launch: Path) -> Any:
    """The same, where it is only a hint. Raises ValueError."""
    try:
        return said_by(launch)
    except AttachError as problem:
        raise ValueError(str(problem)) from None


def address_of_launch() -> tuple[str, int, str]:
    """Host, port and channel of the newest launch in this folder. Raises AttachError if there is
    none, if it has ended, or if it is another user's."""
    try:
        where = said_by(LAUNCH)
        host, port, channel = str(where["host"]), int(where["port"]), str(where["channel"])
        pid, since = int(where["pid"]), str(where.get("started", ""))
    except (GivenFileError, TypeError, ValueError, KeyError, AttributeError):
        raise AttachError(
            f"no bus given and no launch found in {LAUNCH.parent}: "
            "start one with 'headland launch', or name a bus with -i and -c"
        ) from None
    if not lives(pid, since):
        raise AttachError(
            f"the launch in {LAUNCH.parent} was killed (process {pid} is gone): start it again, or name "
            f"its bus if that still runs: --port {port}"
        )
    return host, port, channel


def is_at(where: Any, host: str, port: int) -> bool:
    """Whether the bus of a launch has this address. A launch listens on 127.0.0.1, which people call
    localhost.

    `where`: what is in the file of the launch. Raises KeyError and TypeError if that is no address."""
    there = where["host"]
    same_host = host == there or {host, there} <= LOCAL_NAMES
    return same_host and bool(port == where["port"])


def find_launch(interface: str, port: int) -> None:
    """Raises AttachError if no bus is named and no launch is running here."""
    if interface == "socketcand" and port == 0:
        address_of_launch()


def robots_of_launch(interface: str, host: str, port: int, keys: Path | None = None) -> list[int]:
    """Slots of the robots of a launch, where the bus is that launch's; none where it is another one.

    It is the newest launch in this folder, or the one that made `keys`, a file or its folder. So a
    person that calls a tool from another folder is told of its dead robots, too.
    """
    if interface != "socketcand":
        return []
    beside = []
    if keys is not None:
        folder = keys if keys.is_dir() else keys.parent
        beside.append(folder.absolute().parent / LAUNCH.name)
    for file in (LAUNCH, *beside):
        try:
            where = _believed(file)
            if is_at(where, host, port) or (port == 0 and file is LAUNCH):
                return [int(slot) for slot in where["robots"]]
        except (ValueError, KeyError, TypeError):  # of them GivenFileError
            continue
    return []


def scenario_of_launch(interface: str, host: str, port: int) -> str | None:
    """The scenario of the newest launch in this folder, as a tool here can load it; None: another bus."""
    return _said_of_bus("scenario", interface, host, port)


def folder_of_launch(interface: str, host: str, port: int) -> Path | None:
    """The folder of the newest launch here, where the bus is that launch's; None: another bus."""
    folder = _said_of_bus("folder", interface, host, port)
    return None if folder is None else Path(folder)


def _said_of_bus(key: str, interface: str, host: str, port: int) -> str | None:
    """What the newest launch here says under this key, where the bus is that launch's."""
    try:
        where = _believed(LAUNCH)
        same = port == 0 or is_at(where, host, port)
        said = str(where[key])
    except (ValueError, KeyError, TypeError):  # of them GivenFileError
        return None
    return said if interface == "socketcand" and same else None


def absolute(scenario: str) -> str:
    """The name of a scenario as another process can load it: a file by its absolute path."""
    path = Path(scenario)
    return str(path.absolute()) if path.exists() else scenario
