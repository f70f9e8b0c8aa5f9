"""The truth of a launch's world on disk, from which the next launch of the same fleet continues.

Each line of JSON is a snapshot: the instant, the pose of every robot, the new points of its track,
contacts, and the truth about parcels. A launch that is killed loses the truth since its last
snapshot. A snapshot replaces the one before, except one in every `KEEP_US`, so days of snapshots
fit on a disk.
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

KEEP_US = 20_000_000  # 4,320 lines a day; the new data in a line, of 100 robots, is some 10 kB
# Decimals of a number: tracks are to 0.1 mm, a two-hundredth of what their thinning leaves out, and a
# number in full has 18 digits; poses, in which robots continue, are to a micrometre.
TRACK_DIGITS, POSE_DIGITS = 4, 6
LINE_BYTES_MAX = 16 * 1024 * 1024  # a line of 100 robots and 1,000 parcels has 200 kB


# Exceptions that a malformed line may raise.
WRONG = (KeyError, TypeError, ValueError, OverflowError, AttributeError)


class WorldMemory:
    """A file with a line for each change of the world that a later launch must know."""

    def __init__(self, path: Path, world: World, parcels: Parcels | None = None) -> None:
        """Set the world to the state in the file, then append to the file. Raises OSError.

        A truncated or foreign line ends the data that is used; it and the rest are removed.
        """
        self.world, self.parcels = world, parcels
        path.touch()
        self._file = path.open("r+b", buffering=0)
        self._kept_bytes = self._recall(path)  # size of the lines that stay
        self._file.truncate(self._kept_bytes)
        self._kept_at_us = self._now_us
        begun = self.now_us > 0
        self._told = {s: len(b.track) - 1 if begun else 0 for s, b in world.robots.items()}
        self._contacts = len(world.contacts)

    @property
    def now_us(self) -> int:
        """The instant from which the world continues; 0 for a new one."""
        return self._now_us

    def look(self) -> None:
        """Write what is new since the last line that stays. Raises OSError."""
        world = self.world
        line: dict[str, Any] = {
            "t_us": world.now_us,
            "poses": {
                s: [round(v, POSE_DIGITS) for v in (*b.position, b.heading_rad)]
                for s, b in world.robots.items()
            },
            "tracks": {
                s: _short(b.track.settled_from(self._told[s])) for s, b in world.robots.items()
            },
            "newest": {s: _short(b.track.newest) for s, b in world.robots.items()},
            "contacts": [_kept(contact) for contact in world.contacts[self._contacts :]],
        }
        if self.parcels is not None:
            line["parcels"] = self.parcels.to_plain()
        data = json.dumps(line, separators=(",", ":")).encode("ascii") + b"\n"
        self._file.seek(self._kept_bytes)
        if self._file.write(data) != len(data):
            raise OSError(ENOSPC, strerror(ENOSPC))
        # Remove the rest of a longer line, in case we stop before the next write.
        self._file.truncate()
        if world.now_us - self._kept_at_us >= KEEP_US:
            self._kept_at_us, self._kept_bytes = world.now_us, self._kept_bytes + len(data)
            self._told = {slot: len(body.track) - 1 for slot, body in world.robots.items()}
            self._contacts = len(world.contacts)

    def close(self) -> None:
        """Close the file. What was written is kept."""
        self._file.close()

    def _recall(self, path: Path) -> int:
        """Read the file; returns how many of its bytes are valid."""
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
                touched = [_contact(kept) for kept in line["contacts"]]
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
    """Each complete line as a table, and the offset of its end."""
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


def _short(flat: list[float]) -> list[float]:
    """Points of a track, four numbers each, with as many decimals as count."""
    rounded = (round(value, TRACK_DIGITS) for value in flat)
    return [int(value) if value.is_integer() else value for value in rounded]


def _kept(contact: Contact) -> dict[str, Any]:
    """A contact with the keys of the file."""
    kept = asdict(contact)
    kept["until_us"] = kept.pop("last_at_us")
    return kept


def _contact(kept: dict[str, Any]) -> Contact:
    """KeyError or TypeError if `kept` is not what `_kept` returns."""
    return Contact(
        **{k: v for k, v in kept.items() if k != "until_us"}, last_at_us=kept["until_us"]
    )
