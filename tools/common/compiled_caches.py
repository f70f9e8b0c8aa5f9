"""Compiled code is loaded only from folders that other people cannot write.

numba's caches and compiled cores are machine code, which a process runs as it finds it. A folder is ours
if it and each folder above it belong to this user or to root, and only they, or the user's own group, may
write it. A folder above with the sticky bit, as /tmp has it, lets others write beside ours but not
replace it. Who can write the sources needs no cache: caches beside such sources are not judged.
"""

import os
import stat
import sys
from collections.abc import Iterable, MutableMapping
from pathlib import Path

CACHE = "NUMBA_CACHE_DIR"  # numba reads it when it is imported
ROOT = Path(__file__).parents[2]


def foreign_writer(path: Path) -> Path | None:
    """The folder or file, this one or one above it, that other people can write; None: there is none.

    What does not exist is made by its owner, so it is judged by what is above it."""
    if not hasattr(os, "getuid"):
        return None  # modes say nothing there
    path = path.absolute()
    for each in (path, *path.parents):
        try:
            found = each.stat()
        except OSError:
            continue
        shared = found.st_mode & stat.S_ISVTX and each != path
        others = found.st_mode & stat.S_IWOTH and not shared
        group = found.st_mode & stat.S_IWGRP and not shared and found.st_gid not in (0, os.getgid())
        if others or group or found.st_uid not in (0, os.getuid()):
            return each
    return None


def beside_sources(folder: Path, root: Path = ROOT) -> Path | None:
    """As `foreign_writer`, for a folder within the sources; None also if others can write those."""
    return None if foreign_writer(root) is not None else foreign_writer(folder)


def kernel_caches(root: Path = ROOT) -> Iterable[Path]:
    """The folders beside the sources in which numba keeps kernels."""
    return (package / "__pycache__" for package in (root / "agent").glob("*/"))


def guard_kernels(environment: MutableMapping[str, str], root: Path = ROOT) -> Path | None:
    """Lead numba to a folder of this process alone if others can write those that it would use.

    To be called before numba is imported. Returns what others can write. The folder is new, so kernels
    are compiled once more."""
    named = environment.get(CACHE)
    if named:
        found = [foreign_writer(Path(named))]
    else:
        found = [beside_sources(folder, root) for folder in kernel_caches(root)]
    for writable in found:
        if writable is not None:
            import tempfile  # rarely needed; its import takes as long as all that is judged here

            environment[CACHE] = tempfile.mkdtemp(prefix="headland-kernels-")
            return writable
    return None


def guard() -> None:
    """`guard_kernels` for this process and those that it starts; says on stderr what is wrong."""
    writable = guard_kernels(os.environ)
    if writable is not None:
        print(
            f"headland: others can write {writable}: its compiled kernels are not used, and compiled "
            f"again (25 s). Mend it with: chmod go-w {writable}", file=sys.stderr,
        )  # fmt: skip
