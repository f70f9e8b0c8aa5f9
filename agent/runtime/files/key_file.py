"""Key files: one for each robot, one for panels and gateways, one for the operator that owns the fleet.

A robot's file has the fleet's secrets and a key of its own, by which only the owner can give it new ones
(`protocol/rekeying.py`). The file of panels and gateways has the master secret alone: it can stop and
pass work on, and releases nothing. The fleet's file has both secrets, for what verifies operators without
a robot's file: simulations, task controllers, and the desk of a launch. The owner's file has the secret
that all robots' own keys are made of.
The owner makes restricted files for other people; each has roles, and may expire
(`protocol/operator_badges.py`). All are JSON that only the owner can read. An operator's counter must
never go back: it is stored beside its key file and reserved in blocks, so one durable write covers many.
"""

import json
import os
from collections.abc import Iterable, Mapping
from datetime import date, timedelta
from hashlib import sha256
from pathlib import Path
from secrets import token_bytes
from typing import Any, NamedTuple

from agent.runtime.files.file_lock import lock as take_lock
from agent.runtime.files.given_file import KEY_BYTES_MAX, GivenFileError, read_json, read_text
from agent.runtime.files.printable_text import printable
from agent.runtime.files.private_file import weakness
from protocol.authentication import COUNTER_MAX, KEY_SIZE, OPERATOR_FIRST, Keyring, Keys
from protocol.fleet_tags import held_key
from protocol.operator_badges import NEVER, Badge, Role
from protocol.rekeying import GENERATION_MAX, OWN_SIZE, own_key

FLEET, OPERATOR, ROBOT = "headland fleet keys", "headland operator key", "headland robot keys"
PANELS = "headland panel key"
PANEL = 140  # sender of a stop panel that holds the fleet's keys
DEVICE = 249  # the operator device if the file names no other
DEVICE_MAX = 254
RESERVE = 8192  # frames; a reset of a hundred machines that takes 5 s sends 6,000
EPOCH = date(1970, 1, 1)
DAY_MAX = 0xFFFF  # as OPERATOR_BADGE carries it: the year 2149
PERSON_MAX = 60  # characters of a name
NAMES = {FLEET: "fleet.json", PANELS: "panel.json", OPERATOR: "operator.json"}  # in a folder


class KeyFileError(Exception):
    """One line for the user."""


class KeyFile(NamedTuple):
    """A key file that was read: its keys, and what they allow."""

    path: Path
    kind: str  # FLEET, PANELS, ROBOT or OPERATOR
    keys: Keys
    device: int | None = None  # for an operator's file
    slot: int | None = None  # for a robot's file
    root: bytes | None = None  # of the robots' own keys; the owner has it
    badge: Badge | None = None  # of an operator's file that is restricted
    person: str = ""  # for whom it was made

    @property
    def ids(self) -> dict[str, str]:
        """Short ids by which people can compare two files by voice; they reveal nothing of the
        keys.
        """
        named = {"fleet": self.keys.master, "operator": self.keys.operator}
        return {name: key_id(key) for name, key in named.items() if key is not None}

    def keyring(self, frames: int = RESERVE) -> Keyring:
        """The keyring of a device with this file, for at most `frames` frames.

        Raises KeyFileError if an operator's counter cannot be reserved.
        """
        lot = token_bytes(KEY_SIZE)
        if self.kind != OPERATOR:
            return Keyring(self.keys, PANEL, lot)
        assert self.device is not None
        return Keyring(self.keys, self.device, lot, reserve(self, frames), self.badge)

    def may(self, role: Role, today: int) -> str | None:
        """Why this file does not allow what needs one of these roles; None: it does. `today`: days
        since 1970-01-01."""
        if self.badge is None or (self.badge.roles & role and self.badge.valid(today)):
            return None
        if not self.badge.valid(today):
            day = date_of(self.badge.expires_day)
            return f"{self.path}: expired on {day}: ask the owner for a new one"
        needed, held = roles_named(role), roles_named(self.badge.roles)
        return f"{self.path}: it is for {held}, and this needs {needed}"


def key_id(key: bytes) -> str:
    """Eight hexadecimal digits of a hash that identifies a key."""
    return sha256(b"headland key id" + key).hexdigest()[:8]


def date_of(day: int) -> str:
    """A day, counted from 1970-01-01, as year-month-day."""
    return (EPOCH + timedelta(days=day)).isoformat()


def roles_named(roles: Role) -> str:
    """Roles as people write them: "stop, task"."""
    return ", ".join(str(role.name).lower() for role in Role if role & roles)


def operator_path(folder: Path, device: int) -> Path:
    """The file of one person's device in the folder of a fleet's keys."""
    return folder / f"operator-{device}.json"


def given_path(folder: Path, device: int | str) -> Path:
    """Says that a file was made for this device under the present keys, wherever that file is now.
    `device`: its number, or a pattern."""
    return folder / f"operator-{device}.given"


def operator_text(owner: KeyFile, badge: Badge, person: str) -> str:
    """The content of a restricted operator's file. `owner`: the file of the fleet's owner."""
    operators = owner.keys.operator
    assert operators is not None and owner.root is not None, "only the owner makes files for others"
    secret = badge.secret(operators)
    document: dict[str, Any] = {
        "kind": OPERATOR, "device": badge.device, "person": person,
        "roles": [str(role.name).lower() for role in Role if role & badge.roles],
        "expires": None if badge.expires_day == NEVER else date_of(badge.expires_day),
        "generation": owner.keys.generation,
        "operator_id": key_id(secret), "operator_key": secret.hex(),
    }  # fmt: skip
    if badge.roles & Role.RELEASE:
        held = held_key(operators)
        document |= {"held_id": key_id(held), "held_key": held.hex()}
    return json.dumps(document, indent=1)


def fresh() -> Keys:
    """New random keys for a fleet, from the system's secure generator."""
    return Keys(token_bytes(KEY_SIZE), token_bytes(KEY_SIZE))


def write(
    fleet: Path, operator: Path, keys: Keys, device: int, slots: Iterable[int] = (),
    root: bytes | None = None,
) -> None:  # fmt: skip
    """Write the files of a fleet: both that are named, and beside the first one that of panels, and one
    for each robot of `slots`. `device`: the operator device's sender, 192 to 254. `root`: None, a new
    one.

    Raises FileExistsError if one of them exists already, and OSError if one cannot be written.
    """
    root = token_bytes(KEY_SIZE) if root is None else root
    created: list[Path] = []
    try:
        for path, text in texts(fleet, operator, keys, device, slots, root).items():
            create(path, text)
            created.append(path)
    except OSError:  # half of a fleet's files could neither be used nor made again
        for path in created:
            path.unlink(missing_ok=True)
        raise


def replace(made: Mapping[Path, str], kept: str = "") -> None:
    """Give these files new contents, durable, each at one moment. All are written before the first is
    replaced, so a full disk changes none.

    `kept`: what is added to the names under which the old ones stay, with a dot; empty: they do not stay.
    A file that has this content already, because an earlier call was cut short, stays as it is. The
    counter of one that is replaced goes with it, because it counts under the old key. Raises OSError.
    """
    changed = {path: text for path, text in made.items() if not _has(path, text)}
    fresh_ones = {path: path.with_name(path.name + ".new") for path in changed}
    try:
        for path, text in changed.items():
            fresh_ones[path].unlink(missing_ok=True)
            create(fresh_ones[path], text)
            old = path.with_name(f"{path.name}.{kept}")
            if kept and path.exists() and not old.exists():
                create(old, path.read_text().removesuffix("\n"))
    except OSError:
        for new in fresh_ones.values():
            new.unlink(missing_ok=True)
        raise
    for path, new in fresh_ones.items():
        new.replace(path)
        beside = counter_path(path)
        if kept and beside.exists():
            beside.replace(beside.with_name(f"{beside.name}.{kept}"))
        beside.unlink(missing_ok=True)


def _has(path: Path, text: str) -> bool:
    try:
        return read_text(path, KEY_BYTES_MAX) == text + "\n"
    except (GivenFileError, OSError):
        return False


def texts(
    fleet: Path, operator: Path, keys: Keys, device: int, slots: Iterable[int], root: bytes
) -> dict[Path, str]:
    """The contents of all files of a fleet. `device`: the number of the operator's device, 192 to 254."""
    assert keys.master is not None and keys.operator is not None
    operators = {"operator_id": key_id(keys.operator), "operator_key": keys.operator.hex()}
    master = {"id": key_id(keys.master), "key": keys.master.hex()}
    secrets = {**master, **operators}
    number = {"generation": keys.generation}
    made: dict[Path, dict[str, Any]] = {
        fleet: {"kind": FLEET, **number, **secrets},
        panel_path(fleet.parent): {"kind": PANELS, **number, **master},
        operator: {
            "kind": OPERATOR, "device": device, **number, **operators,
            "root_id": key_id(root), "root_key": root.hex(),
        },
    }  # fmt: skip
    for slot in slots:
        own = own_key(root, slot)
        made[robot_path(fleet.parent, slot)] = {
            "kind": ROBOT, "slot": slot, **number, **secrets,
            "own_id": key_id(own), "own_key": own.hex(),
        }  # fmt: skip
    return {path: json.dumps(document, indent=1) for path, document in made.items()}


def panel_path(folder: Path) -> Path:
    """The file of panels and gateways in the folder of a fleet's keys."""
    return folder / NAMES[PANELS]


def robot_path(folder: Path, slot: int) -> Path:
    """The file of one robot in the folder of a fleet's keys."""
    return folder / f"robot{slot}.json"


def create(path: Path, text: str) -> None:
    """A new file that only its owner can read, durable. Raises OSError, also where there is one; then
    there is no new file."""
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(handle, "w") as file:
            file.write(text + "\n")
            file.flush()
            os.fsync(handle)
    except OSError:
        path.unlink(missing_ok=True)
        raise


def read(path: Path, kind: str | None = None) -> KeyFile:
    """Read a key file. `kind`: the only kind to accept, or None. A folder stands for the file of that
    kind in it, as `headland keys new` names it. Raises KeyFileError."""
    if kind is not None and path.is_dir():
        path = path / NAMES[kind]
    try:
        document, weak = read_json(path, KEY_BYTES_MAX), weakness(path)
    except GivenFileError as problem:
        said = str(problem)
        why = "not a key file: not JSON" if said.startswith("not JSON") else said
        raise KeyFileError(f"{path}: {why}") from None
    except OSError as problem:
        raise KeyFileError(f"{path}: cannot be read: {problem.strerror}") from None
    if weak:
        raise KeyFileError(f"{path}: {weak}")
    found = document.get("kind") if isinstance(document, dict) else None
    if found not in (FLEET, PANELS, OPERATOR, ROBOT):
        raise KeyFileError(f"{path}: not a key file; make one with 'headland keys new'")
    if kind not in (None, found):
        raise KeyFileError(f"{path}: {found!r} where {kind!r} is needed")
    number = document.get("generation", 0)
    if not isinstance(number, int) or not 0 <= number <= GENERATION_MAX:
        raise KeyFileError(f"{path}: generation: {number!r} is not 0 to {GENERATION_MAX}")
    if found == PANELS:
        return KeyFile(
            path, found, Keys(_key(path, document, "id", "key"), None, generation=number)
        )
    operator = _key(path, document, "operator_id", "operator_key")
    if found == FLEET:
        keys = Keys(_key(path, document, "id", "key"), operator, generation=number)
        return KeyFile(path, found, keys)
    if found == ROBOT:
        slot, own = document.get("slot"), _key(path, document, "own_id", "own_key", OWN_SIZE)
        keys = Keys(_key(path, document, "id", "key"), operator, own, number)
        return KeyFile(path, found, keys, slot=slot)
    device = document.get("device")
    if not isinstance(device, int) or not OPERATOR_FIRST <= device <= DEVICE_MAX:
        raise KeyFileError(f"{path}: device: {device!r} is not {OPERATOR_FIRST} to {DEVICE_MAX}")
    root = _key(path, document, "root_id", "root_key") if "root_key" in document else None
    held = _key(path, document, "held_id", "held_key") if "held_key" in document else None
    keys, badge = Keys(None, operator, generation=number, held=held), _badge(path, document, device)
    person = printable(str(document.get("person", ""))[:PERSON_MAX])
    return KeyFile(path, found, keys, device, root=root, badge=badge, person=person)


def _badge(path: Path, document: dict[str, Any], device: int) -> Badge | None:
    """What the file allows; None: all, for ever."""
    if "roles" not in document:
        return None
    try:
        roles = Role(0)
        for name in document["roles"]:
            roles |= Role[name.upper()]
        expires = document.get("expires")
        day = NEVER if expires is None else (date.fromisoformat(expires) - EPOCH).days
    except (AttributeError, KeyError, TypeError, ValueError):
        raise KeyFileError(f"{path}: roles or expires: damaged, or edited by hand") from None
    if not roles or not 0 <= day <= DAY_MAX:
        raise KeyFileError(f"{path}: roles or expires: damaged, or edited by hand")
    return Badge(device, roles, day)


def read_panel(path: Path) -> KeyFile:
    """The key of a panel or a gateway, without the operators' secret. A folder stands for the file of
    panels in it, or for that of the fleet in a folder of an older version. Raises KeyFileError."""
    if path.is_dir():
        own = panel_path(path)
        path = own if own.exists() else path / NAMES[FLEET]
    found = read(path)
    if found.keys.master is None:
        raise KeyFileError(f"{path}: {found.kind!r} where {PANELS!r} is needed")
    return found._replace(keys=Keys(found.keys.master, None, generation=found.keys.generation))


def read_robot(path: Path, slot: int) -> KeyFile:
    """The keys of one robot: its own file, or that of the fleet. A folder stands for the file of this
    robot in it. Raises KeyFileError."""
    if path.is_dir():
        own = robot_path(path, slot)
        path = own if own.exists() else path / NAMES[FLEET]
    found = read(path)
    if found.kind in (OPERATOR, PANELS):
        raise KeyFileError(f"{path}: {found.kind!r} where {ROBOT!r} is needed")
    if found.slot not in (None, slot):
        raise KeyFileError(f"{path}: of robot {found.slot}, and this is robot {slot}")
    return found


def _key(
    path: Path, document: dict[str, Any], name: str, field: str, size: int = KEY_SIZE
) -> bytes:
    try:
        key = bytes.fromhex(document[field])
    except (KeyError, TypeError, ValueError):
        raise KeyFileError(f"{path}: {field}: is missing or not hexadecimal") from None
    if len(key) != size or document.get(name) != key_id(key):
        raise KeyFileError(f"{path}: {field}: does not fit its {name}: damaged, or edited by hand")
    return key


def counter_path(path: Path) -> Path:
    """The file that holds the counter of an operator's key file."""
    return path.with_name(path.name + ".counter")


def counter(path: Path) -> int:
    """How many frames an operator's key file may have signed. Raises KeyFileError."""
    beside = counter_path(path)
    try:
        count = int(read_text(beside, KEY_BYTES_MAX)) if beside.exists() else 0
    except (GivenFileError, OSError, ValueError):
        count = -1
    if not 0 <= count <= COUNTER_MAX:
        raise KeyFileError(f"{beside}: unreadable: rotate the keys, or robots may take old frames")
    return count


def reserve(file: KeyFile, frames: int) -> int:
    """The counter to continue from; the reserved range of `frames` is durable before it is used.

    Raises KeyFileError if the counter cannot be read or written, or if the key has signed enough.
    """
    beside = counter_path(file.path)
    new = beside.with_name(beside.name + ".new")
    try:
        with file.path.open() as lock:  # two devices with one file do not share counters
            take_lock(lock)
            count = counter(file.path)
            if count + frames > COUNTER_MAX:
                raise KeyFileError(f"{file.path}: this key has signed enough: rotate the keys")
            new.unlink(missing_ok=True)
            create(new, str(count + frames))
            new.replace(beside)
    except OSError as problem:
        raise KeyFileError(f"{beside}: cannot be written: {problem.strerror}") from None
    return count
