"""Where a bus is: as options say it, or that of the newest launch in this folder.

It is read before anything is imported that a bus needs: a tool that finds no launch says so at once.
"""

from pathlib import Path

from agent.runtime.files.given_file import SETTINGS_BYTES_MAX, GivenFileError, read_json
from tools.common.process_identity import lives

LAUNCH = Path("runs/launch/bus.json")  # where a launch leaves the address of its bus
CHANNEL = "can0"  # of the bus of a launch
Attached = tuple[str, str, int, str, int]  # interface, channel, bit rate, host, port


class AttachError(Exception):
    """One line for the person: what is wrong and what to do."""


def address_of_launch() -> tuple[str, int, str]:
    """Host, port and channel of the newest launch in this folder. Raises AttachError if there is
    none, or if it has ended."""
    try:
        where = read_json(LAUNCH, SETTINGS_BYTES_MAX)
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
            where = read_json(file, SETTINGS_BYTES_MAX)
            named = host == where["host"] and port == where["port"]
            if named or (port == 0 and file is LAUNCH):
                return [int(slot) for slot in where["robots"]]
        except (ValueError, KeyError, TypeError):  # of them GivenFileError
            continue
    return []


def scenario_of_launch(interface: str, host: str, port: int) -> str | None:
    """The scenario of the newest launch in this folder, as a tool here can load it; None: another bus."""
    try:
        where = read_json(LAUNCH, SETTINGS_BYTES_MAX)
        same = port == 0 or (host == where["host"] and port == where["port"])
        scenario = str(where["scenario"])
    except (ValueError, KeyError, TypeError):  # of them GivenFileError
        return None
    return scenario if interface == "socketcand" and same else None


def folder_of_launch(interface: str, host: str, port: int) -> Path | None:
    """The folder of the newest launch here, where the bus is that launch's; None: another bus."""
    try:
        where = read_json(LAUNCH, SETTINGS_BYTES_MAX)
        same = port == 0 or (host == where["host"] and port == where["port"])
        folder = Path(str(where["folder"]))
    except (ValueError, KeyError, TypeError):  # of them GivenFileError
        return None
    return folder if interface == "socketcand" and same else None


def absolute(scenario: str) -> str:
    """The name of a scenario as another process can load it: a file by its absolute path."""
    path = Path(scenario)
    return str(path.absolute()) if path.exists() else scenario
