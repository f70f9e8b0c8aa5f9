"""Files that are there whole or not at all: written beside their place, then moved to it.

So a full disk, Ctrl-C or a reader at the wrong moment never finds half a file. What was there before
stays until then.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

TOKEN_BYTES = 6  # two writers of one file never share what they write into


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file, text as UTF-8. Raises OSError, and then the file is as it was before."""
    with whole_file(path) as part:
        part.write_bytes(content.encode() if isinstance(content, str) else content)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Where to write: a file beside `path` with the same suffix, moved to `path` at the end of `with`.

    What fails leaves nothing behind. A pipe, a terminal and a file in a folder that takes no new ones
    are written where they are. Raises OSError, which names `path`.
    """
    place = Path(os.path.realpath(path))  # a link goes on to lead to its file
    there = path.exists()
    if there and not (path.is_file() and os.access(place.parent, os.W_OK)):
        yield path
        return
    part = place.with_name(f".headland-{os.urandom(TOKEN_BYTES).hex()}{place.suffix}")
    try:
        if there:
            with place.open("ab"):
                pass  # what its owner protects from writing is not replaced either
        yield part
        if there and (mode := place.stat().st_mode) != part.stat().st_mode:
            part.chmod(mode)
        part.replace(place)
    except OSError as problem:
        if problem.filename in (None, part, str(part)):
            problem.filename, problem.filename2 = str(path), None
        raise
    finally:
        with suppress(OSError):  # nothing to remove, for example below what is no folder
            part.unlink()
