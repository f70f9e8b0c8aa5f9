"""The causes for which another robot stands or creeps, as it reports them: one a frame, in turn."""

from typing import Final

from agent.interface.config import S
from agent.safety.stop_cause import Severity, cause_of, sentence
from protocol.frames.fleet_frames import Standstill

# A robot reports one cause each 1 to 1.4 s, several in rotation; two frames may be lost.
FORGET_US: Final = 4 * S


class ToldCauses:
    """The causes reported by one robot."""

    def __init__(self) -> None:
        self._told: dict[int, tuple[Standstill, int]] = {}  # cause -> its newest frame, and when
        self._number = 0  # number of its causes now, from the newest frame

    def hear(self, m: Standstill, now_us: int) -> None:
        """A frame of this robot about one of its causes."""
        self._number = m.causes
        self._told = {cause: seen for cause, seen in self._told.items() if seen[0].place < m.causes}
        if m.causes == 1:
            self._told.clear()
        self._told[m.cause] = m, now_us

    def moves(self) -> None:
        """Its heartbeat reports that it may move, so only causes that slow it down remain."""
        if self._told:
            self._told = {
                cause: seen for cause, seen in self._told.items()
                if (known := cause_of(cause)) is not None and known.severity is Severity.SLOW
            }  # fmt: skip
        self._number = len(self._told)

    def forget(self) -> None:
        """Forget all causes; only later frames count."""
        self._told.clear()
        self._number = 0

    def fresh(self, now_us: int) -> list[Standstill]:
        """The newest frame of each cause that it still reports, worst first."""
        known_for_us = FORGET_US * max(1, len(self._told), self._number)
        known = [
            m for m, heard_at_us in self._told.values() if now_us - heard_at_us <= known_for_us
        ]
        return sorted(known, key=lambda m: m.place)

    def missing(self, now_us: int) -> int:
        """How many of its causes we have not received yet."""
        known = len(self.fresh(now_us))
        return max(0, self._number - known) if known else 0

    def sentences(self, now_us: int) -> list[str]:
        """For people, a line for each cause: its name, and what a person can do about it."""
        said = [sentence(m.cause, m.about, m.number) for m in self.fresh(now_us)]
        missing = self.missing(now_us)
        if missing:
            said.append(f"and for {missing} more, which it tells one a second: listen longer")
        return said
