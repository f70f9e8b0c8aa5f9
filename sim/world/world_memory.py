"""The truth of a launch's world on disk, so that the next launch of the same fleet goes on from it.

Each line of JSON is a look: the instant, where every robot stands, the points of its track that are new,
contacts, and what is true of parcels. A launch that is killed loses the truth since its last look. A look
takes the place of the one before, but for one in `KEEP_US`: days of looks fit a disk.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict
from errno import ENOSPC
from os import strerror
from pathlib import Path
from typing import Any

from sim.world.ground_truth import Contact
from sim.world.parcel_truth import Parcels
from sim.world.world import World

KEEP_US = 20_000_000  # 4,320 lines a day; what is new in it, of 100 robots, is some 10 kB
LINE_BYTES_MAX = 16 * 1024 * 1024  # a line of 100 robots and 1,000 parcels has 200 kB


WRONG = (KeyError, TypeError, ValueError, OverflowError, AttributeError)  # what a line may raise


class WorldMemory:
    def __init__(self, path: Path, world: World, parcels: Parcels | None = None) -> None:
        """Puts the world where the file says it was, then appends to it. Raises OSError.

        A line that is cut off, or no line of ours, ends what is believed, and is cut away.
        """
        self.world, self.parcels = world, parcels
        path.touch()
        self._file = path.open("r+b", buffering=0)
        self._kept_bytes = self._recall(path)  # of lines that stay
        self._file.truncate(self._kept_bytes)
        self._kept_us = self._now_us
        begun = self.now_us > 0
        self._told = {s: len(b.track) - 1 if begun else 0 for s, b in world.robots.items()}
        self._contacts = len(world.contacts)

    @property
    def now_us(self) -> int:
        """The instant from which the world goes on; 0: a new one."""
        return self._now_us

    def look(self) -> None:
        """Write what is new since the last line that stays. Raises OSError."""
        world = self.world
        line: dict[str, Any] = {
            "t_us": world.now_us,
            "poses": {s: [*b.position, b.heading_rad] for s, b in world.robots.items()},
            "tracks": {s: b.track.settled_from(self._told[s]) for s, b in world.robots.items()},
            "newest": {s: b.track.newest for s, b in world.robots.items()},
            "contacts": [asdict(contact) for contact in world.contacts[self._contacts :]],
        }
        if self.parcels is not None:
            line["parcels"] = self.parcels.to_plain()
        data = json.dumps(line, separators=(",", ":")).encode("ascii") + b"\n"
        self._file.seek(self._kept_bytes)
        if self._file.write(data) != len(data):
            raise OSError(ENOSPC, strerror(ENOSPC))
        self._file.truncate()  # what is left of a longer line is no line, should we end before this
        if world.now_us - self._kept_us >= KEEP_US:
            self._kept_us, self._kept_bytes = world.now_us, self._kept_bytes + len(data)
            self._told = {slot: len(body.track) - 1 for slot, body in world.robots.items()}
            self._contacts = len(world.contacts)

    def close(self) -> None:
        self._file.close()

    def _recall(self, path: Path) -> int:
        """Returns how many bytes of the file are believed."""
        world, self._now_us, good = self.world, 0, 0
        tracks: dict[int, list[float]] = {slot: [] for slot in world.robots}
        poses: dict[int, tuple[float, float, float]] = {}
        contacts: list[Contact] = []
        newest: dict[int, list[float]] = {}
        of_parcels: dict[str, Any] | None = None
        for line, end in _lines(path):
            try:
                t_us = int(line["t_us"])
                places = {
                    int(s): (float(x), float(y), float(h)) for s, (x, y, h) in line["poses"].items()
                }
                new = {int(s): [float(v) for v in flat] for s, flat in line["tracks"].items()}
                last = {int(s): [float(v) for v in flat] for s, flat in line["newest"].items()}
                touched = [Contact(**contact) for contact in line["contacts"]]
                if not places.keys() == new.keys() == last.keys() == tracks.keys():
                    break
                of_parcels = line["parcels"] if self.parcels is not None else None
            except WRONG:
                break
            self._now_us, poses, newest, good = t_us, places, last, end
            contacts += touched
            for slot, flat in new.items():
                tracks[slot] += flat
        if poses:
            for slot, flat in tracks.items():
                world.robots[slot].track.recall([*flat, *newest[slot]])
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
