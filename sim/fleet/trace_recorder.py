"""The trace of a run: what every robot did, as one line of JSON each, and one hash of it all.

The hash is made robot by robot and then joined in slot order, so that it does not depend on the
order in which an event loop ran things inside one instant, only on what each robot did and when.
"""

import json
from hashlib import blake2b
from pathlib import Path
from typing import TextIO

from agent.interface.effects import Drive, Effect, Persist, Send, Trace
from protocol.frames.codec import packed

BATCH = 64  # effects that are hashed together


class Recorder:
    """Takes every effect of every robot; hashes it, counts lost claims, and writes it to a file if
    there is one."""

    def __init__(self, path: Path | None = None) -> None:
        self._hashes: dict[int, blake2b] = {}
        self._waiting: dict[int, list[bytes]] = {}  # for the hash, which is fed in batches
        # The newest; most are like the one before.
        self._drives: dict[int, tuple[Drive, bytes]] = {}
        self._file: TextIO | None = path.open("w", encoding="utf-8") if path is not None else None
        self.lost = 0  # claims and sections lost to a better claim

    def __call__(self, slot: int, now_us: int, effect: Effect) -> None:
        waiting = self._waiting.get(slot)
        if waiting is None:
            waiting = self._waiting[slot] = []
        if isinstance(effect, Send):
            at = now_us.to_bytes(
                8, "little", signed=True
            )  # a clock that was set back may be below zero
            waiting.append(at + packed(effect.message))
            if len(waiting) >= BATCH:
                self._feed(slot)
        elif isinstance(effect, Drive):
            waiting.append(self._drive(slot, effect))
        elif isinstance(effect, Persist):
            waiting.append(effect.key.encode() + effect.value)
        elif isinstance(effect, Trace):
            self.lost += effect.event == "LOST"
            if self._file is not None:
                line = {"t_us": now_us, "robot": slot, **effect._asdict()}
                self._file.write(json.dumps(line, ensure_ascii=False) + "\n")

    def _drive(self, slot: int, drive: Drive) -> bytes:
        last = self._drives.get(slot)
        if last is not None and last[0] is drive:
            return last[1]
        data = b"D%d,%d" % (round(drive.vx_m_s * 1e4), round(drive.vy_m_s * 1e4))
        self._drives[slot] = (drive, data)
        return data

    def _feed(self, slot: int) -> None:
        rolling = self._hashes.get(slot)
        if rolling is None:
            rolling = self._hashes[slot] = blake2b(digest_size=16)
        rolling.update(b"".join(self._waiting[slot]))
        self._waiting[slot].clear()

    @property
    def digest(self) -> str:
        """One hash over all robots in slot order, so that the order of events of one instant does
        not count."""
        for slot in self._waiting:
            self._feed(slot)
        total = blake2b(digest_size=8)
        for slot in sorted(self._hashes):
            total.update(slot.to_bytes(2, "little") + self._hashes[slot].digest())
        return total.hexdigest()

    def close(self) -> None:
        """Close the file, if there is one."""
        if self._file is not None:
            self._file.close()
