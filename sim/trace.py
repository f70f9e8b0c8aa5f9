"""The trace of a run: what every robot did, as one line of JSON each, and one hash of it all.

The hash is made robot by robot and then joined in slot order, so that it does not depend on the
order in which an event loop ran things inside one instant, only on what each robot did and when.
"""

import json
from hashlib import blake2b
from pathlib import Path
from typing import TextIO

from agent.effects import Drive, Effect, Persist, Send, Trace


class Recorder:
    def __init__(self, path: Path | None = None) -> None:
        self._hashes: dict[int, blake2b] = {}
        self._file: TextIO | None = path.open("w", encoding="utf-8") if path is not None else None
        self.lost = 0  # claims and sections lost to a better claim

    def __call__(self, slot: int, now_us: int, effect: Effect) -> None:
        rolling = self._hashes.get(slot)
        if rolling is None:
            rolling = self._hashes[slot] = blake2b(digest_size=16)
        if isinstance(effect, Send):
            rolling.update(now_us.to_bytes(8, "little") + effect.message.pack())
        elif isinstance(effect, Drive):
            rolling.update(b"D%d,%d" % (round(effect.vx_m_s * 1e4), round(effect.vy_m_s * 1e4)))
        elif isinstance(effect, Persist):
            rolling.update(effect.key.encode() + effect.value)
        elif isinstance(effect, Trace):
            self.lost += effect.event == "LOST"
            if self._file is not None:
                line = {"t_us": now_us, "robot": slot, **effect._asdict()}
                self._file.write(json.dumps(line, ensure_ascii=False) + "\n")

    @property
    def digest(self) -> str:
        total = blake2b(digest_size=8)
        for slot in sorted(self._hashes):
            total.update(slot.to_bytes(2, "little") + self._hashes[slot].digest())
        return total.hexdigest()

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
