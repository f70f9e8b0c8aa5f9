"""In a checkout the layers are folders beside this package; here they get the names of the wheel.

`headland.agent.peer` is then the very module `agent.peer`: one module with two names, not two copies
of it. A wheel has the layers inside and not this module.
"""

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec
from importlib.util import find_spec, spec_from_loader
from types import CodeType, ModuleType
from typing import Any

PREFIX = "headland."
LAYERS = ("crdt", "protocol", "agent", "sim", "tools")


class SameModule:
    """A loader that gives a module which has another name already.

    Not an `importlib.abc.InspectLoader` by name: importing that takes a tenth of a tool's start.
    """

    def __init__(self, spec: ModuleSpec) -> None:
        self.spec = spec

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """The module itself, imported under its own name."""
        return import_module(self.spec.name)

    def exec_module(self, module: ModuleType) -> None:
        """It has been executed. The import system has just given it the spec of its second name."""
        module.__spec__ = self.spec

    def is_package(self, fullname: str) -> bool:
        """True where it has submodules."""
        return self.spec.submodule_search_locations is not None

    def get_source(self, fullname: str) -> str | None:
        """For tracebacks; None where its own loader has none."""
        loader: Any = self.spec.loader
        return loader.get_source(self.spec.name) if hasattr(loader, "get_source") else None

    def get_code(self, fullname: str) -> CodeType | None:
        """For `python -m`; None where its own loader has none."""
        loader: Any = self.spec.loader
        return loader.get_code(self.spec.name) if hasattr(loader, "get_code") else None


class LayerFinder:
    """Looks for `headland.agent.peer` under its own name."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """None for modules that are not of a layer (the import system calls it)."""
        own = name.removeprefix(PREFIX)
        if own == name or own.split(".")[0] not in LAYERS:
            return None
        spec = find_spec(own)
        if spec is None:
            return None
        loader: Any = SameModule(spec)  # by its methods
        return spec_from_loader(name, loader, origin=spec.origin)


def find_layers() -> None:
    """From now on the layers are found under their names in the wheel, too."""
    if not any(isinstance(finder, LayerFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, LayerFinder())  # before the one that would load a second copy
