"""Goals that wait for an idle robot: first come, first served, in a file that outlives the command.

One command at a time delivers (a lock of the operating system, free again when its owner dies). A goal
leaves the file when a robot has said that it goes there. A command that dies between that answer and
the write leaves the goal with the robot's number. Then the same robot is sent to the same place again,
and no second robot is sent.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from agent.runtime.files.file_lock import lock as take_lock
from agent.runtime.files.given_file import SETTINGS_BYTES_MAX, GivenFileError, read_bytes
from sim.files.whole_file import write_whole
from tools.language.intent import Metres, Slot

QUEUE_MAX = 100  # more goals than a person can keep in mind


class QueueError(Exception):
    """One line for the person."""


class Queued(BaseModel):
    """One goal of the file, and which robot it was given to."""

    model_config = ConfigDict(extra="forbid")
    number: int
    name: str
    x_m: Metres
    y_m: Metres
    given_to: Slot | None = None  # sent, and not yet confirmed

    @property
    def place(self) -> tuple[float, float]:
        """Metres east and north."""
        return self.x_m, self.y_m


_LIST: TypeAdapter[list[Queued]] = TypeAdapter(
    Annotated[list[Queued], Field(max_length=QUEUE_MAX)], config=ConfigDict(defer_build=True)
)


class GoalQueue:
    """Reads the file each time: other commands write it, too."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __len__(self) -> int:
        return len(self.goals)

    @property
    def goals(self) -> list[Queued]:
        """Raises QueueError."""
        try:
            if not self.path.exists():
                return []
            return _LIST.validate_json(read_bytes(self.path, SETTINGS_BYTES_MAX))
        except (GivenFileError, ValidationError):
            raise QueueError(f"{self.path}: is no queue of goals: delete it") from None

    @property
    def names(self) -> list[str]:
        """Names of the places that wait, first come first."""
        return [goal.name for goal in self.goals]

    def add(self, name: str, place: tuple[float, float]) -> int:
        """Put a goal at the end; `place` is metres east and north. Returns its number. Raises
        QueueError if the file is full or unreadable."""
        with self._locked("edit"):
            goals = self.goals
            if len(goals) >= QUEUE_MAX:
                raise QueueError(f"{QUEUE_MAX} goals are queued already; say: clear the queue")
            number = 1 + max((goal.number for goal in goals), default=0)
            self._write([*goals, Queued(number=number, name=name, x_m=place[0], y_m=place[1])])
        return number

    def clear(self) -> int:
        """Remove all goals and return their number. Raises QueueError."""
        with self._locked("edit"):
            count = len(self.goals)
            self._write([])
        return count

    def give(self, number: int, slot: int) -> None:
        """About to be sent to this robot."""
        with self._locked("edit"):
            self._write([
                goal.model_copy(update={"given_to": slot}) if goal.number == number else goal
                for goal in self.goals
            ])  # fmt: skip

    def done(self, number: int) -> None:
        """Remove the goal with this number, because its robot has confirmed it. Raises QueueError."""
        with self._locked("edit"):
            self._write([goal for goal in self.goals if goal.number != number])

    @contextmanager
    def delivering(self) -> Iterator[bool]:
        """False where another command delivers."""
        with self._locked("deliver", wait=False) as held:
            yield held

    @contextmanager
    def _locked(self, what: str, wait: bool = True) -> Iterator[bool]:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            lock = self.path.with_name(f"{self.path.name}.{what}").open("w")
        except OSError as problem:
            raise QueueError(f"{self.path}: cannot be written: {problem.strerror}") from None
        with lock:
            yield take_lock(lock, wait)

    def _write(self, goals: list[Queued]) -> None:
        write_whole(self.path, _LIST.dump_json(goals))
