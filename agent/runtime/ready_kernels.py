"""Kernels that `headland compile --kernels` has made: an extension module, and a table beside it.

They lie where numba keeps its own caches: in `NUMBA_CACHE_DIR`, or beside the sources. The table has a
digest of each source that a kernel depends on, so kernels of other sources are not used. The machine code
runs on every processor of this architecture. A process that finds none uses numba.
"""

import json
import logging
import os
import sysconfig
from collections.abc import Callable, Mapping
from hashlib import sha256
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from agent.kernels.kernel import Entries, Kernel, Kinds, take_from

log = logging.getLogger(__name__)
MODULE: Final = "headland_kernels"  # of the extension; its init function has this name
TABLE: Final = "kernels.json"
# In the table: file below the layers -> digest; kernel -> [[kinds, function of the extension], ...]
SOURCES: Final = "sources"
ENTRIES: Final = "entries"
OFF: Final = "HEADLAND_NUMBA"  # set in the environment: kernels are compiled by numba
LAYERS: Final = Path(__file__).parents[2]  # the folder of `agent`, also in a wheel
CACHE: Final = "NUMBA_CACHE_DIR"


def use_ready_kernels(folder: Path | None = None) -> bool:
    """Take the kernels of modules that are imported from now on from the ready module. False: there is
    none of these sources, so they come from numba. `folder`: another one than `place()`."""
    if OFF in os.environ:
        return False
    folder = folder or place()
    try:
        table = _table(folder)
        module = _loaded(extension_in(folder))
    except (OSError, ValueError, KeyError, ImportError):
        return False
    take_from(ReadyKernels(module, table[ENTRIES]))
    return True


def are_ready() -> bool:
    """Whether `use_ready_kernels` would find kernels of these sources. Loads nothing."""
    try:
        _table(place())
    except (OSError, ValueError, KeyError):
        return False
    return OFF not in os.environ and extension_in(place()).exists()


def _table(folder: Path) -> dict[str, Any]:
    """Raises ValueError where the kernels are of other sources, and as reading a file and JSON do."""
    table: dict[str, Any] = json.loads((folder / TABLE).read_text())
    if any(digest(LAYERS / file) != known for file, known in table[SOURCES].items()):
        raise ValueError("kernels of other sources")
    return table


def place() -> Path:
    """The folder of the ready module of this interpreter."""
    named = os.environ.get(CACHE)
    return Path(named) if named else LAYERS / "agent" / "kernels" / "__pycache__"


def extension_in(folder: Path) -> Path:
    """The extension module in such a folder; its name has the version of Python and the architecture."""
    return folder / f"{MODULE}{sysconfig.get_config_var('EXT_SUFFIX')}"


def digest(file: Path) -> str:
    """Of one source. Raises OSError."""
    return sha256(file.read_bytes()).hexdigest()


def _loaded(file: Path) -> ModuleType:
    loader = ExtensionFileLoader(MODULE, str(file))
    spec = spec_from_loader(MODULE, loader)
    assert spec is not None
    module = module_from_spec(spec)
    loader.exec_module(module)
    return module


class ReadyKernels:
    """A loaded extension module as the source of kernels."""

    def __init__(self, module: ModuleType, table: Mapping[str, list[list[Any]]]) -> None:
        self._functions: dict[str, dict[Kinds, Callable[..., Any]]] = {
            name: {_frozen(kinds): getattr(module, function) for kinds, function in entries}
            for name, entries in table.items()
        }

    def entries(self, name: str) -> Entries:
        """Of a kernel; empty where no rehearsal has called it."""
        return self._functions.get(name, {})

    def on_missing(self, kernel: Kernel, kinds: Kinds, values: tuple[Any, ...]) -> None:
        """numba is imported and compiles: seconds, in which a robot stops."""
        log.warning("no ready kernel %s%s: numba compiles it", kernel.name, kinds)


def _frozen(kinds: list[Any]) -> tuple[Any, ...]:
    """Lists of JSON as the tuples that they were."""
    return tuple(_frozen(each) if isinstance(each, list) else each for each in kinds)
