"""The release log of one robot: what let it drive again, when, and under whose key.

A line is appended when the robot has cleared a stop, and in a fleet with keys when an operator has
started it, or let it go on without a silent member. It is never changed. Each names the hash of the line
before it, and has an HMAC-SHA256 under a key that only this robot and the owner of the fleet can make. So
the owner finds a line that was changed, added, moved or taken out. The last lines can be cut off without
a trace in one log; the logs of the other robots show that. A fleet without keys has the hashes alone.
"""

import hmac
import json
import logging
import os
import re
import time
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Final, NamedTuple

from agent.interface.effects import Effect, Trace
from agent.runtime.files.given_file import check_regular, parse_json, read_text
from protocol.authentication import Keys

log = logging.getLogger(__name__)

START: Final = "0" * 64  # what the first line names as the hash before it
LOG_BYTES_MAX: Final = 64 * 1024 * 1024  # 200,000 releases
LINE_BYTES_MAX: Final = 4096  # read back at a start, to go on after the last line
AT_MAX_S: Final = 253_402_300_800.0  # the year 10000, which no calendar here has
# A pipe at the place of the log is an error, and not a robot that waits for a reader.
FLAGS: Final = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_NONBLOCK", 0)
KEPT: Final = frozenset(("CLEARED", "PERMITTED"))  # events of traces
OF_ONE: Final = ("start", "go on without ")  # words about one robot, which others need not have
BY: Final = re.compile(r"^(?P<what>.*) by (?P<who>\d+)$")
NAME: Final = re.compile(r"robot(\d{1,3})\.releases\.jsonl")


class LoggedRelease(NamedTuple):
    """One line: a stop that one robot has cleared, or what an operator has permitted to it."""

    number: int  # from 1
    released_at_s: float  # by the computer of the robot
    robot: int
    what: str  # as the robot traced it
    device: int | None  # under whose key; None: it is not said
    before: str  # hash of the line before, 64 hexadecimal digits
    tag: str  # HMAC-SHA256, 64 hexadecimal digits; empty without keys


class ReadLog(NamedTuple):
    """A log that was read, and what is wrong with it."""

    robot: int
    releases: Sequence[LoggedRelease]
    broken: str  # empty: its chain and its tags are right
    signed: bool  # the tags were checked
    shared: bool = False  # a line has the tag of a key that other robots hold, too


def path_of(folder: Path, slot: int) -> Path:
    """The log of a robot in the folder of its durable memory."""
    return folder / f"robot{slot}.releases.jsonl"


def key_of(keys: Keys | None, slot: int) -> bytes | None:
    """The key of a robot's log. `keys`: its own; None in a fleet without keys."""
    if keys is None:
        return None
    secret = keys.own or keys.master
    assert secret is not None, "a robot holds the fleet's secret"
    return own_log_key(secret, slot)


def own_log_key(own: bytes, slot: int) -> bytes:
    """The key of a log from the robot's own key, which the owner can make, too."""
    return hmac.digest(own, b"headland release log" + bytes((slot,)), "sha256")


class ReleaseLog:
    """Appends the releases of one robot."""

    def __init__(self, path: Path, slot: int, key: bytes | None) -> None:
        self.path, self.slot, self._key = path, slot, key
        # The last is what ends a line whose writing was cut off.
        self._number, self._before, self._first = _end_of(path)

    def keep(self, now_us: int, effect: Effect) -> None:
        """Called with each effect of the robot. A disk that fails is logged, and the robot goes on: it
        has released already."""
        if not isinstance(effect, Trace) or effect.event not in KEPT:
            return
        said = BY.match(effect.why)
        what, device = (said["what"], int(said["who"])) if said else (effect.why, None)
        self._number += 1
        at_s = round(time.time(), 3)
        plain = LoggedRelease(self._number, at_s, self.slot, what, device, self._before, "")
        line = _line(plain._replace(tag=_tag(plain, self._key)))
        try:
            handle = os.open(self.path, FLAGS, 0o600)
            with os.fdopen(handle, "ab") as file:
                file.write(self._first + line)
                file.flush()
                os.fsync(handle)
        except OSError as problem:
            log.error("robot %d: the release log failed: %s", self.slot, problem)
            # All of the line, a part of it or nothing may be there.
            self._number, self._before, self._first = _end_of(self.path)
            return
        self._before, self._first = sha256(line).hexdigest(), b""


def read_log(path: Path, key: bytes | None, fleet_secrets: Sequence[bytes] = ()) -> ReadLog:
    """Read a log and check it. `key`: None checks the chain alone. `fleet_secrets`: under which a robot
    writes that was given the file of the fleet, 16 bytes each. Raises GivenFileError, OSError."""
    found = NAME.fullmatch(path.name)
    robot = int(found[1]) if found else -1
    releases: list[LoggedRelease] = []
    before, broken, shared = START, "", False
    others = [own_log_key(secret, robot) for secret in fleet_secrets] if robot >= 0 else []
    for number, text in enumerate(read_text(path, LOG_BYTES_MAX).splitlines(), 1):
        try:
            release = _release_of(text)
            line = _line(release)
        except ValueError:
            broken = broken or f"line {number} cannot be read"
            continue
        releases.append(release)
        if line.decode() != text + "\n" or release.before != before or release.number != number:
            broken = broken or f"line {number} does not follow the line before it"
        elif release.robot != robot:
            broken = broken or f"line {number} is of robot {release.robot}"
        elif key is not None and not _has_tag_of(release, key):
            if any(_has_tag_of(release, other) for other in others):
                shared = True
            else:
                broken = broken or f"line {number} was not written with the key of robot {robot}"
        before = sha256(line).hexdigest()
    return ReadLog(robot, releases, broken, key is not None, shared)


def _has_tag_of(release: LoggedRelease, key: bytes) -> bool:
    return hmac.compare_digest(release.tag.encode(), _tag(release, key).encode())


def _release_of(text: str) -> LoggedRelease:
    """A line that was read. Raises ValueError: a thief of the robot can write anything."""
    document = parse_json(text)
    if not isinstance(document, dict) or document.keys() != set(LoggedRelease._fields):
        raise ValueError("not a line of a release log")
    found = LoggedRelease(**document)
    at_s, device, words = found.released_at_s, found.device, (found.what, found.before, found.tag)
    if not (
        all(type(number) is int for number in (found.number, found.robot))
        and type(at_s) in (int, float) and 0 <= at_s < AT_MAX_S
        and (device is None or type(device) is int)
        and all(type(word) is str and word.isprintable() for word in words)
    ):  # fmt: skip
        raise ValueError("not a line of a release log")
    return found


def lacking(logs: Sequence[ReadLog]) -> dict[int, set[str]]:
    """Stops that some robots have cleared by a person's key, and others have no line about: lines may be
    cut off, or the robot was off or did not know the stop. By robot."""
    said = {
        one.robot: {
            r.what for r in one.releases if r.device is not None and not r.what.startswith(OF_ONE)
        }
        for one in logs
    }
    everything = set().union(*said.values()) if said else set()
    return {robot: everything - had for robot, had in said.items() if everything - had}


def _line(release: LoggedRelease) -> bytes:
    return json.dumps(release._asdict(), sort_keys=True).encode() + b"\n"


def _tag(release: LoggedRelease, key: bytes | None) -> str:
    if key is None:
        return ""
    return hmac.digest(key, _line(release._replace(tag="")), "sha256").hex()


def _end_of(path: Path) -> tuple[int, str, bytes]:
    """Number and hash of the last line, of none if there is no log, and what is to be written before the
    next one. What cannot be read ends the chain: the next line names the hash of nothing, and a check
    says so. A line that lacks only its end is whole."""
    last = b""
    try:
        check_regular(path)
        size = path.stat().st_size
        with path.open("rb") as file:
            file.seek(max(0, size - LINE_BYTES_MAX))
            last = file.read().splitlines(keepends=True)[-1]
        ended = last.removesuffix(b"\n") + b"\n"
        number, before = _release_of(ended.decode()).number, sha256(ended).hexdigest()
    except (OSError, IndexError, ValueError):
        number, before = 0, START
    return number, before, b"\n" if last and not last.endswith(b"\n") else b""
