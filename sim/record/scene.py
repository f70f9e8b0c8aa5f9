"""The static objects of a run as plain values: a map draws them first, and recordings store them.

`sim.record.scene_builder` makes one of a scenario. A tool that only shows a scene needs no simulator.
"""

from pathlib import Path
from typing import Any

Scene = dict[str, Any]
FILE = "scene.json"  # in the folder of a run


def in_folder(source: Path) -> Path:
    """The path of a run's scene: in its folder, or beside its log."""
    return (source if source.is_dir() else source.parent) / FILE
