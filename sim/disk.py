"""A robot's durable memory in a simulation: what was written is there after a restart."""

from collections.abc import Iterable, Mapping

from agent.effects import Persist


class MemoryJournal:
    """The `Journal` port, kept outside of the robot that dies."""

    def __init__(self) -> None:
        self.records: dict[str, bytes] = {}
        self.writes = 0

    def load(self) -> Mapping[str, bytes]:
        return dict(self.records)

    def write(self, records: Iterable[Persist]) -> None:
        self.writes += 1
        self.records.update(records)
