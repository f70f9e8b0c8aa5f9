"""What was released in a run, by whom, and whether the logs of the robots are whole."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from agent.runtime.files.given_file import GivenFileError
from agent.runtime.files.key_file import FLEET, NAMES, OPERATOR, KeyFileError, read
from agent.runtime.files.release_log import NAME as LOG_NAME
from agent.runtime.files.release_log import ReadLog, lacking, own_log_key, read_log
from protocol.rekeying import own_key
from tools.common.launch_keys import KEYS


class ReleaseRecords(NamedTuple):
    """The release logs of all robots of a fleet."""

    logs: Sequence[ReadLog]
    people: Mapping[int, str]  # device -> the person that its key was made for
    root: bool  # the owner's file was there, so that tags were checked

    @property
    def broken(self) -> dict[int, str]:
        """Robots whose log is not as the robot wrote it, and why."""
        return {one.robot: one.broken for one in self.logs if one.broken}

    @property
    def shared(self) -> list[int]:
        """Robots whose log has tags that any robot of the fleet could make: they were given the fleet's
        file, and no key of their own."""
        return [one.robot for one in self.logs if one.shared]

    @property
    def lacking(self) -> dict[int, set[str]]:
        """Robots that have no line about what others have."""
        return lacking(self.logs)

    def who(self, device: int | None) -> str:
        """A device as people know it."""
        if device is None:
            return "-"
        person = self.people.get(device)
        return f"{person} ({device})" if person else str(device)


def release_records(folder: Path, keys: Path | None = None) -> ReleaseRecords:
    """Of the folder of a launch, or of robots' memories. `keys`: the owner's folder; None: that of the
    launch, if there is one. Raises GivenFileError, KeyFileError, OSError."""
    owners = folder / KEYS if keys is None else keys
    root, people, secrets = None, dict[int, str](), list[bytes]()
    if keys is not None or (owners / "operator.json").exists():
        root = read(owners, OPERATOR).root
        for path in sorted(owners.glob("operator-*.json")):
            try:
                file = read(path, OPERATOR)
            except KeyFileError:
                continue
            assert file.device is not None, "an operator's file names its device"
            people[file.device] = file.person
        secrets = list(_fleet_secrets(owners))
    logs = []
    for path in sorted(folder.iterdir()):
        found = LOG_NAME.fullmatch(path.name)
        if found:
            slot = int(found[1])
            key = None if root is None else own_log_key(own_key(root, slot), slot)
            logs.append(read_log(path, key, secrets))
    return ReleaseRecords(logs, people, root is not None)


def _fleet_secrets(owners: Path) -> Iterator[bytes]:
    """Of the fleet's file in the owner's folder, and of those that a rotation has left beside it."""
    for path in sorted(owners.glob(f"{NAMES[FLEET]}*")):
        with suppress(KeyFileError):
            master = read(path, FLEET).keys.master
            if master is not None:
                yield master


def records_or_none(folder: Path) -> ReleaseRecords | None:
    """As `release_records`; None where there are no logs, or they cannot be read."""
    try:
        found = release_records(folder)
    except (GivenFileError, KeyFileError, OSError):
        return None
    return found if found.logs else None
