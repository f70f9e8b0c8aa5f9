"""What one robot can honestly say in its time: units that its speed allows, epochs, stops.

A robot that says more is broken, or somebody has its key. It is counted and named; nothing is refused,
because replicas must become equal. All that one robot sends is counted for it: its own work, and what it
repeats of others in sync answers. What can be true at all is judged in `agent/peer/work_admission.py`. A
member that is named is taken out with `headland keys revoke`.

News of the first minute do not count: a robot that was switched on, or an inspector, learns all that was
done before. So it is after a revocation, and after another robot than the sender came onto the bus.
"""

from collections import Counter
from typing import Final

from agent.interface.config import S

# A unit is about 5 m. A machine at 10 m/s, with two units in parallel, covers 4 a second.
UNITS_A_S: Final = 8
UNITS_BURST: Final = 160  # four blocks: what is announced late, after frames were lost
# Work of a robot that was cut off, which it tells at once: ten minutes.
UNITS_SAVED_MAX: Final = UNITS_A_S * 600
EPOCH_JUMP_MAX: Final = 16  # hand-overs of one section that were missed: as `EPOCH_BURST`
# Claims in the name of a live robot from which we have not heard them. Honest robots repeat those of
# which we missed the frame: one in a hundred on a bad bus, and a robot makes one in ten seconds.
FOREIGN_BURST: Final = 16
FOREIGN_EVERY_S: Final = 10
STOPS_BURST: Final = 16  # presses of one robot: a hand that hits the button again and again
STOP_EVERY_S: Final = 5
LEARNING_US: Final = 60 * S
TOLD_EVERY_US: Final = 10 * S  # of one robot and one matter


class SenderLimits:
    """Counts what each robot says, and names those that say too much."""

    def __init__(self, now_us: int) -> None:
        # Slot and matter -> how often it was too much.
        self.found: Counter[tuple[int, str]] = Counter()
        self._counts_at_us = now_us + LEARNING_US
        self._units: dict[int, tuple[float, int]] = {}  # slot -> units left, at what time
        self._stops: dict[int, tuple[float, int]] = {}
        self._foreign: dict[int, tuple[float, int]] = {}
        # Members that came onto the bus in the last minute.
        self._appeared_at_us: dict[int, int] = {}
        self._told_at_us: dict[tuple[int, str], int] = {}

    def learn(self, now_us: int) -> None:
        """All robots tell what they know, for a minute from now."""
        self._counts_at_us = max(self._counts_at_us, now_us + LEARNING_US)

    def appeared(self, slot: int, now_us: int) -> None:
        """A member came onto the bus: others may tell what it has done in the meantime."""
        recent = {s: at for s, at in self._appeared_at_us.items() if now_us - at < LEARNING_US}
        self._appeared_at_us = recent | {slot: now_us}

    def _learning(self, sender: int, now_us: int) -> bool:
        if now_us < self._counts_at_us:
            return True
        return any(
            now_us - at_us < LEARNING_US
            for slot, at_us in self._appeared_at_us.items() if slot != sender
        )  # fmt: skip

    def progress(self, slot: int, units: int, now_us: int) -> str | None:
        """Units of any section that a robot has told and that are new; what is wrong with them."""
        if not units or self._learning(slot, now_us):
            return None
        left, at_us = self._units.get(slot, (float(UNITS_BURST), now_us))
        left = min(left + UNITS_A_S * (now_us - at_us) / S, UNITS_SAVED_MAX) - units
        self._units[slot] = max(left, 0.0), now_us
        return None if left >= 0 else self._tell(slot, "units", now_us)

    def claim(self, slot: int, epoch: int, known_epoch: int, now_us: int) -> str | None:
        """A claim or sync answer of a robot, and the epoch that was known of the section."""
        if epoch - known_epoch <= EPOCH_JUMP_MAX or self._learning(slot, now_us):
            return None
        return self._tell(slot, "epoch", now_us)

    def foreign(self, slot: int, ours: bool, now_us: int) -> str | None:
        """A claim in the name of a live robot from which we did not hear it. `ours`: that robot is we."""
        if self._learning(slot, now_us):
            return None
        if ours:
            return self._tell(slot, "invented", now_us)
        left, at_us = self._foreign.get(slot, (float(FOREIGN_BURST), now_us))
        left = min(left + (now_us - at_us) / S / FOREIGN_EVERY_S, FOREIGN_BURST) - 1
        self._foreign[slot] = max(left, 0.0), now_us
        return None if left >= 0 else self._tell(slot, "foreign", now_us)

    def stop(self, slot: int, now_us: int) -> str | None:
        """A stop with a new name from a robot."""
        left, at_us = self._stops.get(slot, (float(STOPS_BURST), now_us))
        left = min(left + (now_us - at_us) / S / STOP_EVERY_S, STOPS_BURST) - 1
        self._stops[slot] = max(left, 0.0), now_us
        return None if left >= 0 else self._tell(slot, "stops", now_us)

    @property
    def named(self) -> list[str]:
        """Robots that have said too much, for people."""
        return [
            f"robot {slot}: {WORDS[what]}, {n} times"
            for (slot, what), n in sorted(self.found.items())
        ]

    def _tell(self, slot: int, what: str, now_us: int) -> str | None:
        self.found[slot, what] += 1
        if now_us - self._told_at_us.get((slot, what), -TOLD_EVERY_US) < TOLD_EVERY_US:
            return None
        self._told_at_us[slot, what] = now_us
        return f"robot {slot} {WORDS[what]}"


WORDS: Final = {
    "units": f"told more than {UNITS_A_S} units a second",
    "epoch": f"raised an epoch by more than {EPOCH_JUMP_MAX}",
    "invented": "told a claim in our name that we did not make",
    "foreign": f"told more than {FOREIGN_BURST} claims in the name of robots that did not make them",
    "stops": f"named more than {STOPS_BURST} stops within a minute",
}
