"""Which order became which task of the fleet, on the disk before the fleet hears of it.

The fleet keeps its tasks whatever happens to this program. The book is what makes an order one task also
over a restart: a record is written before the first frame, and a recalled order is said again under its
own number, which robots that know it take for the same.
"""

import json
import os
from errno import ENOSPC
from pathlib import Path
from typing import Any, NamedTuple

from agent.delivery.task_registry import TransportTask
from agent.runtime.files.file_lock import lock as take_lock
from agent.runtime.vda5050.messages import MasterOrder

# An order comes in 256 KiB at most, and in the book a character of it may be an escape of six.
LINE_BYTES_MAX = 16 * 1024 * 1024


class BookError(ValueError):
    """One line: why a book cannot be used."""


class BookedOrder(NamedTuple):
    """The newest order of one vehicle."""

    slot: int
    order: MasterOrder
    number: int | None  # of its task; None: a part of it is hidden, or it was cancelled before
    task: TransportTask | None
    cancelled: bool = False


class OrderBook:
    """The newest order of each vehicle, and the task of every order, by the number that it has."""

    def __init__(self, path: Path) -> None:
        """Read what is there. Raises BookError, also where another gateway keeps this book, and
        OSError."""
        self.path = path
        self.orders: dict[int, BookedOrder] = {}
        self.tasks: dict[int, TransportTask] = {}
        path.parent.mkdir(parents=True, exist_ok=True)
        self._lock = path.with_name(f"{path.name}.lock").open("w")
        try:
            if not take_lock(self._lock, wait=False):
                raise BookError(
                    f"--book {path}: another headland vda5050 keeps it: end that one first"
                )
            self._open()
        except (BookError, OSError):
            self._lock.close()
            raise

    def _open(self) -> None:
        path, whole = self.path, 0
        if path.exists():
            with path.open("rb") as file:
                while line := file.readline(LINE_BYTES_MAX):
                    if not line.endswith(b"\n"):
                        if len(line) == LINE_BYTES_MAX:
                            raise BookError(f"{path}: a line is no record of an order: too long")
                        break  # the last write was cut off by a crash; nothing followed from it
                    self._read(line)
                    whole += len(line)
        self._file = path.open("ab", buffering=0)
        self._file.truncate(whole)
        self._whole = whole  # bytes of whole records

    def _read(self, line: bytes) -> None:
        try:
            said = json.loads(line)
            order = MasterOrder.model_validate(said["order"])
            task = None if said["task"] is None else TransportTask(*map(int, said["task"]))
            number = None if said["number"] is None else int(said["number"])
            self._take(BookedOrder(int(said["slot"]), order, number, task, bool(said["cancelled"])))
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as problem:
            raise BookError(f"{self.path}: a line is no record of an order: {problem}") from None

    def _take(self, booked: BookedOrder) -> None:
        before = self.orders.get(booked.slot)
        if (
            before is not None
            and before.number is not None
            and before.order.order_id == booked.order.order_id
        ):
            # Another device's order may have that number now. Recalled under it, too, this one would be
            # ordered twice.
            self.tasks.pop(before.number, None)
        self.orders[booked.slot] = booked
        if booked.number is not None and booked.task is not None:
            self.tasks[booked.number] = booked.task

    def write(self, booked: BookedOrder) -> None:
        """Make a record durable. Raises OSError; then the book is as it was."""
        plain = booked.order.model_dump(mode="json", by_alias=True, exclude_none=True)
        said: dict[str, Any] = {**booked._asdict(), "order": plain}
        line = json.dumps(said).encode() + b"\n"
        try:
            if self._file.write(line) != len(line):  # what fitted on the disk; there is no error
                raise OSError(ENOSPC, os.strerror(ENOSPC))
            os.fsync(self._file.fileno())
        except OSError:  # a part of it may be there, and the next record would follow on its line
            self._file.truncate(self._whole)
            raise
        self._whole = self._file.tell()
        self._take(booked)

    def close(self) -> None:
        """Close the file, for another gateway too; every record is on the disk already."""
        self._file.close()
        self._lock.close()
