"""The truth of a launch's world on disk, so that the next launch of the same fleet goes on from it.

One line of JSON for each look: the instant, where every robot stands, the points of its track that are
new, contacts, and what is true of parcels. A launch that is killed loses the truth since its last look.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, TextIO

from sim.parcels import Parcels
from sim.truth import Contact
from sim.world import World

LINE_BYTES_MAX = 16 * 1024 * 1024  # a line of 100 robots and 1,000 parcels has 200 kB


WRONG = (KeyError, TypeError, ValueError, OverflowError, AttributeError)  # what a line may raise


class WorldMemory:
    def __init__(self, path: Path, world: World, parcels: Parcels | None = None) -> None:
        """Puts the world where the file says it was, then appends to it. Raises OSError.

        A line that is cut off, or no line of ours, ends what is believed, and is cut away.
        """
        self.world, self.parcels = world, parcels
        self._file: TextIO = path.open("a+", encoding="ascii")
        self._file.truncate(self._recall(path))
        begun = self.now_us > 0
        self._told = {slot: len(b.track) if begun else 0 for slot, b in world.robots.items()}
        self._contacts = len(world.contacts)

    @property
    def now_us(self) -> int:
        """The instant from which the world goes on; 0: a new one."""
        return self._now_us

    def look(self) -> None:
        """Write what is new. Raises OSError."""
        world = self.world
        line: dict[str, Any] = {
            "t_us": world.now_us,
            "poses": {s: [*b.position, b.heading_rad] for s, b in world.robots.items()},
            "tracks": {s: b.track.flat_from(self._told[s]) for s, b in world.robots.items()},
            "contacts": [asdict(contact) for contact in world.contacts[self._contacts :]],
        }
        if self.parcels is not None:
            line["parcels"] = self.parcels.to_plain()
        self._told = {slot: len(body.track) for slot, body in world.robots.items()}
        self._contacts = len(world.contacts)
        self._file.write(json.dumps(line, separators=(",", ":")) + "\n")
        self._file.flush()

    def close(self) -> None:
        self._file.close()

    def _recall(self, path: Path) -> int:
        """Returns how many bytes of the file are believed."""
        world, self._now_us, good = self.world, 0, 0
        tracks: dict[int, list[float]] = {slot: [] for slot in world.robots}
        poses: dict[int, tuple[float, float, float]] = {}
        contacts: list[Contact] = []
        of_parcels: dict[str, Any] | None = None
        for line, end in _lines(path):
            try:
                t_us = int(line["t_us"])
                places = {
                    int(s): (float(x), float(y), float(h)) for s, (x, y, h) in line["poses"].items()
                }
                new = {int(s): [float(v) for v in flat] for s, flat in line["tracks"].items()}
                touched = [Contact(**contact) for contact in line["contacts"]]
                if places.keys() != tracks.keys() or new.keys() != tracks.keys():
                    break
                of_parcels = line["parcels"] if self.parcels is not None else None
            except WRONG:
                break
            self._now_us, poses, good = t_us, places, end
            contacts += touched
            for slot, flat in new.items():
                tracks[slot] += flat
        if poses:
            for slot, flat in tracks.items():
                world.robots[slot].track.recall(flat)
            world.contacts = contacts
            world.resume(self._now_us, poses)
            if self.parcels is not None and of_parcels is not None:
                try:
                    self.parcels.recall(of_parcels)
                except WRONG:
                    raise OSError(f"{path}: the parcels in it cannot be read") from None
        self._now_us = world.now_us if poses else 0
        return good


def _lines(path: Path) -> Iterator[tuple[dict[str, Any], int]]:
    """Each whole line as a table, and where it ends."""
    end = 0
    try:
        with path.open("rb") as file:
            while raw := file.readline(LINE_BYTES_MAX):
                line = json.loads(raw)
                if not raw.endswith(b"\n") or not isinstance(line, dict):
                    return
                end += len(raw)
                yield line, end
    except (ValueError, RecursionError):
        return
