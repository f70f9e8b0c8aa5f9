"""Compiled code is loaded only from folders that other people cannot write.

numba's caches and compiled cores are machine code, which a process runs as it finds it. A folder is ours
if it and each folder above it belong to this user or to root, and only they, or the user's own group, may
write it. A folder above with the sticky bit, as /tmp has it, lets others write beside ours but not
replace it. Who can write the sources needs no cache: caches beside such sources are not judged.

A cache that this process cannot write is replaced by a temporary folder: numba refuses a kernel whose
cache has no place, and matplotlib complains.
"""

import atexit
import os
import stat
import sys
from collections.abc import Callable, Iterable, Mapping, MutableMapping, Sequence
from importlib.abc import MetaPathFinder
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import subprocess

CACHE = "NUMBA_CACHE_DIR"  # numba reads it when it is imported
PICTURES = "MPLCONFIGDIR"  # and matplotlib this one
READY = ("kernels.json", "headland_kernels*")  # what `agent/runtime/ready_kernels.py` looks for
_made: set[str] = set()  # temporary folders of this process
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
            environment[CACHE] = temporary("headland-kernels-")
            return writable
    return None


def temporary(prefix: str) -> str:
    """A new folder of this user alone, which is deleted when this process ends.

    Processes that were forked from this one end without deleting it."""
    import tempfile  # rarely needed; its import takes as long as all that is judged here
    from shutil import rmtree

    folder, maker = tempfile.mkdtemp(prefix=prefix), os.getpid()
    _made.add(folder)

    def delete() -> None:
        if os.getpid() == maker:
            rmtree(folder, ignore_errors=True)

    atexit.register(delete)
    return folder


def end_with_temporary(process: "subprocess.Popen[bytes]") -> None:
    """End a process that compiles kernels before their temporary folder is deleted: it would make the
    folder again. Where kernels are kept it goes on."""

    def end() -> None:
        process.kill()
        process.wait()

    if os.environ.get(CACHE) in _made:
        atexit.register(end)  # what is registered later is called earlier


def can_write(folder: Path) -> bool:
    """Whether this process can write a folder, or make it where it does not exist."""
    folder = folder.absolute()
    there = next((each for each in (folder, *folder.parents) if os.path.lexists(each)), folder)
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def user_folder(environment: Mapping[str, str], name: str, beside_home: str) -> Path:
    """A folder of the XDG base directories: of the variable `name`, else below the home folder."""
    home = environment.get("HOME") or os.path.expanduser("~")  # noqa: PTH111 - never raises
    return Path(environment.get(name) or Path(home, beside_home))


def can_keep(environment: Mapping[str, str], root: Path = ROOT) -> bool:
    """Whether numba finds a folder for its caches: the one that is named, those beside the sources, or
    that of the user."""
    if not sys.platform.startswith("linux"):
        return True  # numba keeps them elsewhere there, in folders that every user has
    named = environment.get(CACHE)
    return (
        (bool(named) and can_write(Path(str(named))))
        or all(can_write(folder) for folder in kernel_caches(root))
        or can_write(user_folder(environment, "XDG_CACHE_HOME", ".cache") / "numba")
    )


def place_kernels(environment: MutableMapping[str, str], root: Path = ROOT) -> bool:
    """Lead numba to a temporary folder where it can keep kernels nowhere; True if it was led there.

    Kernels that `headland compile --kernels` has made are found from there too."""
    if can_keep(environment, root):
        return False
    ready = Path(environment.get(CACHE) or root / "agent" / "kernels" / "__pycache__").absolute()
    environment[CACHE] = temporary("headland-kernels-")
    for file in (file for name in READY for file in ready.glob(name)):
        Path(environment[CACHE], file.name).symlink_to(file)
    return True


def place_pictures(environment: MutableMapping[str, str]) -> None:
    """Lead matplotlib to a temporary folder where it cannot write its own."""
    own = (("XDG_CONFIG_HOME", ".config"), ("XDG_CACHE_HOME", ".cache"))
    if not environment.get(PICTURES) and sys.platform.startswith("linux"):
        folders = [user_folder(environment, *each) / "matplotlib" for each in own]
        if not all(map(can_write, folders)):
            environment[PICTURES] = temporary("headland-pictures-")


class BeforeImport(MetaPathFinder):
    """Calls something just before a package is imported for the first time; finds no module itself."""

    def __init__(self, actions: dict[str, Callable[[], object]]) -> None:
        self.actions = actions

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> None:
        """Call the action of this package, once; the other finders find the package."""
        action = self.actions.pop(fullname, None)
        if action is not None:
            action()


NOT_KEPT = (
    "headland: compiled kernels cannot be kept, no folder for them can be written: they are compiled for "
    f"this command alone (25 s). {CACHE} names a folder for them"
)


class _Kernels:
    """Whether this process can keep kernels, and whether a person was told that it cannot."""

    not_kept, told = False, False

    @classmethod
    def tell(cls) -> None:
        if not cls.told:
            cls.told = True
            print(NOT_KEPT, file=sys.stderr)


def kernels_not_kept() -> bool:
    """Whether `guard` found no folder in which kernels can be kept. The caller tells it: it is not said
    on stderr then."""
    _Kernels.told = True
    return _Kernels.not_kept


def guard() -> None:
    """Caches of this process and of those that it starts; says on stderr what is wrong with them.

    That kernels cannot be kept is said by a process that needs them."""
    actions: dict[str, Callable[[], object]] = {"matplotlib": lambda: place_pictures(os.environ)}
    writable = guard_kernels(os.environ)
    if writable is not None:
        print(
            f"headland: others can write {writable}: its compiled kernels are not used, and compiled "
            f"again (25 s). Mend it with: chmod go-w {writable}", file=sys.stderr,
        )  # fmt: skip
    elif place_kernels(os.environ):
        _Kernels.not_kept = True
        actions["numba"] = _Kernels.tell
    sys.meta_path.insert(0, BeforeImport(actions))
