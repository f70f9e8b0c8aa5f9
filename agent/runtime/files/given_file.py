"""The only way to read files from users: regular files of limited size, parsed within limits.

Every error of such a file is a `GivenFileError` with one line. The line does not name the file,
because the caller knows its purpose. A FIFO never blocks, a device never fills the memory, and deep
or quadratic text is rejected before it takes more than a second.
"""

import json
import os
import re
import stat
from pathlib import Path
from typing import Any

from agent.runtime.files.printable_text import one_line

KIB, MIB = 1 << 10, 1 << 20
# Upper limits for a file of each kind, bytes; the comment gives the size of the largest real one.
SCENARIO_BYTES_MAX = 512 * KIB  # 30 kB: 100 faults of a campaign
DRAWING_BYTES_MAX = 8 * MIB  # 4 MB: a floor of 2000 x 2000 characters
TASKS_BYTES_MAX = 4 * MIB  # 100 kB: 2,000 transports
KEY_BYTES_MAX = 64 * KIB  # 300 bytes
REPORT_BYTES_MAX = 64 * MIB  # 1 MB: report.json of a day
PLAN_BYTES_MAX = 64 * MIB  # 10 MB: a coverage plan of 100 robots
SETTINGS_BYTES_MAX = 1 * MIB  # 10 kB: places, addresses, queues
DOTS_MAX = 32  # in one key of TOML; time and memory of the parser grow with their square
REASON_MAX = 200  # characters


class GivenFileError(ValueError):
    """One line for the user, without the file's name."""

    def __init__(self, reason: str) -> None:
        super().__init__(one_line(reason, REASON_MAX))


def read_bytes(path: Path, bytes_max: int) -> bytes:
    """The contents of a regular file of at most `bytes_max` bytes. Raises GivenFileError."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as problem:
        raise GivenFileError(f"cannot be read: {problem.strerror}") from None
    except ValueError:  # a NUL in the name
        raise GivenFileError("cannot be read: that is no file name") from None
    if stat.S_ISDIR(os.fstat(handle).st_mode):  # Python does not open a folder as a file
        os.close(handle)
        raise GivenFileError("cannot be read: not a regular file")
    with os.fdopen(handle, "rb") as file:
        about = os.fstat(handle)
        if not stat.S_ISREG(about.st_mode):
            raise GivenFileError("cannot be read: not a regular file")
        if about.st_size > bytes_max:
            raise GivenFileError(f"larger than {size_text(bytes_max)}")
        try:
            content = file.read(bytes_max + 1)
        except OSError as problem:
            raise GivenFileError(f"cannot be read: {problem.strerror}") from None
    if len(content) > bytes_max:
        raise GivenFileError(f"larger than {size_text(bytes_max)}")
    return content


def check_regular(path: Path) -> None:
    """Raises GivenFileError if a path is no regular file; for files that another library opens."""
    try:
        mode = path.stat().st_mode
    except OSError as problem:
        raise GivenFileError(f"cannot be read: {problem.strerror}") from None
    except ValueError:
        raise GivenFileError("cannot be read: that is no file name") from None
    if not stat.S_ISREG(mode):
        raise GivenFileError("cannot be read: not a regular file")


def read_text(path: Path, bytes_max: int) -> str:
    """The text of a UTF-8 file, with or without the mark at its begin that editors of Windows write.
    Raises GivenFileError."""
    try:
        return read_bytes(path, bytes_max).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise GivenFileError("not a text file") from None


def read_json(path: Path, bytes_max: int) -> Any:
    """The contents of a JSON file, as `parse_json` gives them. Raises GivenFileError."""
    return parse_json(read_text(path, bytes_max))


def read_toml(path: Path, bytes_max: int) -> dict[str, Any]:
    """The contents of a TOML file, as `parse_toml` gives them. Raises GivenFileError."""
    return parse_toml(read_text(path, bytes_max))


def parse_json(text: str) -> Any:
    """The value of a JSON text.

    Raises GivenFileError if it is not JSON, is nested too deep, has NaN or infinite numbers, or half of
    a character, which no file and no terminal could be given.
    """
    try:
        value = json.loads(text, parse_constant=_no_number)
        if _HALVES.search(text):
            json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        raise GivenFileError("not JSON: half of a character (a lone surrogate)") from None
    except (ValueError, RecursionError) as problem:
        raise GivenFileError(f"not JSON: {_told(problem)}") from None
    return value


def parse_toml(text: str) -> dict[str, Any]:
    """The table of a TOML text.

    Raises GivenFileError if it is not TOML, is nested too deep, or has a key of too many parts.
    """
    import tomllib  # files of TOML are fewer than those of JSON, which every tool of the bus reads

    if any(run.group().count(".") > DOTS_MAX for run in _DOTTED.finditer(_STRINGS.sub("q", text))):
        raise GivenFileError(f"not TOML of ours: a key of more than {DOTS_MAX} parts")
    try:
        return tomllib.loads(text)
    except (
        ValueError,
        RecursionError,
    ) as problem:  # a number of 5,000 digits is a plain ValueError
        raise GivenFileError(f"not TOML: {_told(problem)}") from None


def size_text(count: int) -> str:
    """A size in bytes for people, in KiB or MiB, rounded down."""
    return f"{count // MIB} MiB" if count >= MIB else f"{count // KIB} KiB"


_STRINGS = re.compile(
    r'''"""(?:[^\\]|\\.)*?"""|\'{3}.*?\'{3}|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'|#[^\n]*''', re.S
)
_HALVES = re.compile(r"\\u[dD][89a-fA-F]")  # escapes of which two make one character
_DOTTED = re.compile(r"[\w\-. \t]+")


def _told(problem: Exception) -> str:
    return "nested too deep" if isinstance(problem, RecursionError) else str(problem)


def _no_number(name: str) -> float:
    raise ValueError(f"{name} is no number")
