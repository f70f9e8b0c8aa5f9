"""The folder of a fleet's key files, as its owner changes them while the fleet works.

A change is written down before any robot hears of it (`next.json`), and the key files are replaced when
the robots have switched. So a tool that dies in between is simply called again: it goes on with the same
secret.
"""

import contextlib
import json
import re
from pathlib import Path
from secrets import token_bytes
from typing import NamedTuple

from agent.runtime.files.given_file import KEY_BYTES_MAX, GivenFileError, read_json
from agent.runtime.files.key_file import (
    FLEET,
    NAMES,
    OPERATOR,
    KeyFile,
    KeyFileError,
    create,
    given_path,
    operator_text,
    read,
    replace,
    robot_path,
    texts,
)
from protocol.authentication import KEY_SIZE
from protocol.rekeying import ALWAYS_S, GENERATION_MAX, NOBODY, SLOTS, Rekeying

NEXT, GENERATION = "next.json", "generation"
OF_PERSON = re.compile(r"operator-(\d{3})\.json")
OF_ROBOT = re.compile(r"robot(0|[1-9][0-9]{0,2})\.json")


class KeyFolder(NamedTuple):
    """The owner's files of one fleet."""

    folder: Path
    root: bytes
    device: int
    generation: int
    slots: frozenset[int]  # robots that have a file here

    @property
    def begun(self) -> Rekeying | None:
        """A change that was begun and not finished; None also where later keys have replaced it. Raises
        KeyFileError."""
        found = self._noted
        return None if isinstance(found, int) or found.generation < self.generation else found

    @property
    def spent(self) -> int:
        """The newest generation that was used or begun. Raises KeyFileError."""
        found = self._noted
        return max(self.generation, found if isinstance(found, int) else found.generation)

    @property
    def _noted(self) -> Rekeying | int:
        """The newest change, or the generation of one that was dropped; 0: there is none."""
        path = self.folder / NEXT
        if not path.exists():
            return 0
        found: Rekeying | None = None
        try:
            said = read_json(path, KEY_BYTES_MAX)
            if said.keys() == {GENERATION} and 0 < int(said[GENERATION]) <= GENERATION_MAX:
                return int(said[GENERATION])
            found = Rekeying(
                int(said[GENERATION]), bytes.fromhex(said["secret"]), int(said["revoked"]),
                int(said["void_for_s"]),
            )  # fmt: skip
        except (
            GivenFileError, OSError, AttributeError, KeyError, TypeError, ValueError, OverflowError,
        ):  # fmt: skip
            pass
        if found is None or not found.is_sayable:
            raise KeyFileError(f"{path}: damaged: delete it and begin again")
        return found

    def begin(self, revoked: int = NOBODY, void_for_s: int = ALWAYS_S) -> Rekeying:
        """The change to make: the one that was begun, if it is the same, or a new one.

        `revoked`: slot, or NOBODY. `void_for_s`: what it said up to this long ago is void. Raises
        KeyFileError, also if another one was begun, and OSError."""
        begun = self.begun
        if begun is not None:
            if begun.revoked != revoked:
                raise KeyFileError(
                    f"{self.folder}: 'headland keys {named(begun)}' was begun: finish it first"
                )
            if begun.void_for_s != void_for_s:
                raise KeyFileError(
                    f"{self.folder}: 'headland keys {named(begun)}' was begun: finish it first, and then "
                    "revoke again, by which other words become void"
                )
            return begun
        spent = self.spent
        if spent >= GENERATION_MAX:
            raise KeyFileError(f"{self.folder}: too many generations: make new keys")
        made = Rekeying(spent + 1, token_bytes(KEY_SIZE), revoked, void_for_s)
        plain = {**made._asdict(), "secret": made.secret.hex()}
        self.forget()
        create(self.folder / NEXT, json.dumps(plain))
        return made

    def drop(self, begun: Rekeying) -> None:
        """No robot was told to use these keys. Robots may hold them all the same, and a thief may tell
        them to use them. So the next change has a higher number. Raises OSError."""
        replace({self.folder / NEXT: json.dumps({GENERATION: begun.generation})})

    def forget(self) -> None:
        """What was begun is void: it is finished, or later keys have replaced it. Raises OSError."""
        (self.folder / NEXT).unlink(missing_ok=True)

    def finish(self, done: Rekeying) -> None:
        """The robots have switched: the files are those of the new keys. Raises OSError."""
        slots = self.slots - {done.revoked}
        fleet, operator = (self.folder / NAMES[kind] for kind in (FLEET, OPERATOR))
        made = texts(fleet, operator, done.keys, self.device, sorted(slots), self.root)
        made |= people_texts(self.folder, KeyFile(operator, OPERATOR, done.keys, root=self.root))
        replace(made)
        if done.revoked != NOBODY:
            robot_path(self.folder, done.revoked).unlink(missing_ok=True)
        free_numbers(self.folder)
        self.forget()


def free_numbers(folder: Path) -> None:
    """The keys are other ones now: a number whose file is not here any more may be given to somebody
    else. Raises OSError."""
    for path in folder.glob(given_path(folder, "*").name):
        if not path.with_suffix(".json").exists():
            path.unlink()


def named(begun: Rekeying) -> str:
    """The command that began a change, without "headland keys"."""
    if begun.revoked == NOBODY:
        return "rotate --running"
    since = "" if begun.void_for_s == ALWAYS_S else f" --since {begun.void_for_s}"
    return f"revoke {begun.revoked}{since}"


def people_texts(folder: Path, owner: KeyFile) -> dict[Path, str]:
    """The files of the people in this folder, under the owner's keys. What cannot be read is left out."""
    made: dict[Path, str] = {}
    for path in sorted(folder.iterdir()):
        if OF_PERSON.fullmatch(path.name):
            with contextlib.suppress(KeyFileError):
                found = read(path, OPERATOR)
                if found.badge is not None:
                    made[path] = operator_text(owner, found.badge, found.person)
    return made


def unread_people(folder: Path) -> list[str]:
    """What is wrong with each file of a person in this folder that cannot be read."""
    found = []
    for path in sorted(folder.iterdir()):
        if OF_PERSON.fullmatch(path.name):
            try:
                read(path, OPERATOR)
            except KeyFileError as problem:
                found.append(str(problem))
    return found


def owned(folder: Path) -> KeyFolder:
    """The folder of the owner of a fleet. Raises KeyFileError."""
    operator, fleet = read(folder, OPERATOR), read(folder, FLEET)
    if operator.root is None:
        raise KeyFileError(
            f"{operator.path}: made by an older version, without a key for each robot: "
            "make new keys with 'headland keys new'"
        )
    assert operator.device is not None
    found = [OF_ROBOT.fullmatch(path.name) for path in folder.iterdir()]
    # Of another name, as robot300.json or robot07.json, there is no robot.
    slots = frozenset(int(match[1]) for match in found if match and int(match[1]) < SLOTS)
    return KeyFolder(folder, operator.root, operator.device, fleet.keys.generation, slots)
