"""The hot modules of a simulation as machine code, made by mypyc from the very same sources.

Extension modules under `build/core/NAME`, where NAME has digests of every source that a result depends
on, of how they are compiled, and of the interpreter. A stale core has another name, so it is never found.
Nothing needs a core: a program that finds none runs interpreted. A native class cannot be changed from
outside, so planted bugs, and tests that replace something in a class, run without a core. Robots run
without one, too.
"""

import os
import sys
import sysconfig
from collections.abc import Sequence
from hashlib import sha256
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from types import ModuleType

from tools.common.compiled_caches import beside_sources
from tools.common.fingerprint import ROOT, fingerprint

FOLDER = ROOT / "build" / "core"
SUFFIX: str = sysconfig.get_config_var("EXT_SUFFIX")
OFF = "HEADLAND_INTERPRETED"  # set in the environment: no core is used

# What decides how the sources are compiled.
MADE_BY = ("compile.py", "inline_caches.h")


def place() -> Path:
    """Where a core of these sources for this interpreter is, or would be."""
    files = [Path(__file__).with_name(name) for name in MADE_BY]
    # A wheel has no C, and no core is made there.
    made_by = sha256(b"".join(file.read_bytes() for file in files if file.is_file())).hexdigest()[
        :6
    ]
    return FOLDER / f"{fingerprint()}-{made_by}-{sys.implementation.cache_tag}"


class Finder:
    """Finds the modules of a core before anybody looks for their sources."""

    def __init__(self, folder: Path) -> None:
        self.files = {
            ".".join(file.relative_to(folder).parts).removesuffix(SUFFIX): file
            for file in folder.glob(f"**/*{SUFFIX}")
        }

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Where the compiled module of that name lies; None for modules that are not compiled (the
        import system calls it)."""
        file = self.files.get(name)
        return None if file is None else spec_from_file_location(name, file)


def use(folder: Path | None = None) -> bool:
    """Import from the core from now on. False: there is none, or this process has begun without.

    `folder`: another one than that of these sources.
    """
    if OFF in os.environ:
        return False
    if any(isinstance(finder, Finder) for finder in sys.meta_path):
        return True
    folder = folder or place()
    writable = beside_sources(folder) if folder.is_dir() else None
    if writable is not None:
        print(f"headland: others can write {writable}: no compiled core is used", file=sys.stderr)
        return False
    finder = Finder(folder)
    if not finder.files or any(name in sys.modules for name in finder.files):
        return False
    sys.meta_path.insert(0, finder)
    return True
