"""Thousands of power cuts and kills: journals are written from a tape, cut, and read again.

Each generator yields one line for every state in which data was lost, and nothing else; the number
of states is an argument. The expected memory is exact: that after some batch between the last one
that was acknowledged and the last one that was begun.
"""

import os
import select
import signal
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from random import Random

from agent.interface.effects import Persist
from agent.runtime.sqlite_journal import Mark, SqliteJournal
from sim.chaos.durability_rules import Batch, Tape, lost
from sim.chaos.sqlite_vfs_recorder import VfsCall, VfsRecording
from sim.fleet.simulated_disk import Disk, LogJournal, PowerCut, tear

CHECKPOINT_PAGES = 20  # of the recorded journal, so that a tape of a minute has many checkpoints
# States are written there if it exists, because they need not survive a real power cut.
RAM = Path("/dev/shm")
Image = dict[str, bytearray]


def batches(tape: Tape) -> list[Batch]:
    """The batches on a tape. A batch is the only kind of tuple on a tape that is not a message."""
    return [entry for entry in tape if type(entry) is tuple]  # type: ignore[misc]


def memories(tape: Tape) -> list[dict[str, bytes]]:
    """The expected memory after each number of batches."""
    known: list[dict[str, bytes]] = [{}]
    for batch in batches(tape):
        known.append({**known[-1], **dict(batch)})
    return known


def judge(tape: Tape, known: list[dict[str, bytes]], recalled: Mapping[str, bytes],
          acknowledged: int, begun: int) -> str:  # fmt: skip
    """A description of what was lost, or empty. `acknowledged` and `begun` count batches."""
    if recalled in known[acknowledged + 1 : begun + 1]:
        return ""  # newer than the acknowledged batch, of which nothing has been sent yet
    if recalled != known[acknowledged]:
        return f"after batch {acknowledged} of {begun} begun: {len(recalled)} records, other ones"
    seen, revealed = 0, []
    for entry in tape:
        if type(entry) is not tuple:
            revealed.append(entry)
        elif (seen := seen + 1) > acknowledged:
            break  # no frame after an unacknowledged batch was sent
    return lost(revealed, recalled)  # type: ignore[arg-type]


def log_states(tape: Tape, states: int, rng: Random, synced: bool = True) -> Iterator[str]:
    """Cut `LogJournal` before any step of any write, in every way that its disk allows."""
    known, writes = memories(tape), batches(tape)
    for _ in range(states):
        first = rng.randrange(len(writes))
        disk = Disk()
        journal = LogJournal(disk, synced)
        journal.write([Persist(*record) for record in known[first].items()])
        disk.sync()
        last = min(len(writes), first + 3)
        disk.cut_at = disk.steps + rng.randint(1, 2 * (last - first))
        acknowledged = begun = first
        try:
            for batch in writes[first:last]:
                begun += 1
                journal.write(batch)
                acknowledged += 1
        except PowerCut:
            pass
        recalled = LogJournal(disk.after_cut(rng)).load()
        if problem := judge(tape, known, recalled, acknowledged, begun):
            yield problem


class Files:
    """The files of one sqlite journal: what is synced, and what a power cut may still undo.

    With the first sync of a new journal or log, sqlite also syncs the folder (`os_unix.c`,
    DIRSYNC). That makes deletions in it durable.
    """

    def __init__(self) -> None:
        self.synced: Image = {}
        self.unsynced: list[VfsCall] = []

    def take(self, step: VfsCall) -> None:
        """Apply one recorded step. A sync makes the writes to its file durable, and deletions that
        came before them."""
        if step.kind != "sync":
            self.unsynced.append(step)
        if step.kind == "sync" or (step.kind == "delete" and step.at):
            folder = step.kind == "delete" or step.file not in self.synced
            durable = [
                s for s in self.unsynced if s.file == step.file or (folder and s.kind == "delete")
            ]
            for waiting in durable:
                _apply(self.synced, waiting)
            self.unsynced = [waiting for waiting in self.unsynced if waiting not in durable]

    def after_cut(self, rng: Random) -> Image:
        """Apply a first part of the unsynced steps and a torn one; or any subset, as a cache writes
        back."""
        image = {name: bytearray(data) for name, data in self.synced.items()}
        in_order = rng.random() < 0.5
        kept = rng.randint(0, len(self.unsynced))
        for number, step in enumerate(self.unsynced):
            if number < kept if in_order else rng.random() < 0.5:
                _apply(image, step)
            elif step.kind == "write" and (number == kept or not in_order):
                tear(image.setdefault(step.file, bytearray()), step.at, step.data, rng)
        return image


def _apply(image: Image, step: VfsCall) -> None:
    data = image.setdefault(step.file, bytearray())
    if step.kind == "write":
        data.extend(bytes(max(0, step.at - len(data))))
        data[step.at : step.at + len(step.data)] = step.data
    elif step.kind == "truncate":
        del data[step.at :]
    elif step.kind == "delete":
        image.pop(step.file, None)


class RecordedMark(Mark):
    """Records its steps in order among those of sqlite."""

    def __init__(self, path: Path, steps: list[VfsCall]) -> None:
        super().__init__(path)
        self.steps = steps

    def _put(self, at: int, data: bytes) -> None:
        super()._put(at, data)
        self.steps.append(VfsCall(self.path.name, "write", at, data))

    def _sync(self) -> None:
        super()._sync()
        self.steps.append(VfsCall(self.path.name, "sync"))


def record_sqlite(tape: Tape, synchronous: str = "FULL") -> list[VfsCall]:
    """Every step that sqlite takes to write a tape; NORMAL is the planted bug, which does not
    sync."""
    with tempfile.TemporaryDirectory() as folder, VfsRecording() as recording:
        journal = SqliteJournal(Path(folder) / "journal")
        journal.mark = RecordedMark(journal.mark.path, recording.steps)
        journal._database.execute(f"PRAGMA wal_autocheckpoint={CHECKPOINT_PAGES}")
        journal._database.execute(f"PRAGMA synchronous={synchronous}")
        for number, batch in enumerate(batches(tape), start=1):
            recording.steps.append(VfsCall("", "begin", number))
            journal.write(batch)
            recording.acknowledge(number)
        steps = list(recording.steps)
        journal.close()
    return steps


def sqlite_states(tape: Tape, steps: list[VfsCall], states: int, rng: Random) -> Iterator[str]:
    """Cut the real journal between any two steps of sqlite, and open the remains with sqlite."""
    known = memories(tape)
    cuts = sorted(rng.randrange(len(steps)) for _ in range(states))
    files, done, acknowledged, begun = Files(), 0, 0, 0
    with tempfile.TemporaryDirectory(dir=RAM if RAM.is_dir() else None) as folder:
        path = Path(folder) / "journal"
        for cut in cuts:
            for step in steps[done:cut]:
                if step.kind == "ack":
                    acknowledged = step.at
                elif step.kind == "begin":
                    begun = step.at
                else:
                    files.take(step)
            done = cut
            for old in Path(folder).iterdir():
                old.unlink()
            for name, data in files.after_cut(rng).items():
                (Path(folder) / name).write_bytes(data)
            journal, recalled = SqliteJournal.opened(path)
            journal.close()
            if problem := judge(tape, known, recalled, acknowledged, begun):
                yield f"before step {cut}: {problem}"


def kills(tape: Tape, count: int, rng: Random) -> Iterator[str]:
    """SIGKILL a process that writes the real journal, at a random moment; the next one
    continues."""
    writes, memory, number = batches(tape), dict[str, bytes](), 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "journal"
        for _ in range(count):
            acknowledged = _killed_writer(path, writes, number, rng)
            while number < acknowledged:
                memory |= _numbered(writes, number)
                number += 1
            journal, recalled = SqliteJournal.opened(path)
            journal.close()
            # written, but not acknowledged yet.
            if recalled == {**memory, **_numbered(writes, number)}:
                memory, number = dict(recalled), number + 1
            elif recalled != memory:
                yield f"after {acknowledged} acknowledged writes: {len(recalled)} records"
                memory = dict(recalled)


def _numbered(writes: list[Batch], number: int) -> dict[str, bytes]:
    return dict(writes[number % len(writes)]) | {"number": number.to_bytes(8, "little")}


def _killed_writer(path: Path, writes: list[Batch], first: int, rng: Random) -> int:
    """The total number of writes that were acknowledged when the writer died."""
    incoming, outgoing = os.pipe()
    process = os.fork()
    if process == 0:
        _write_for_ever(path, writes, first, outgoing)
    os.close(outgoing)
    acknowledged, wanted = first, first + rng.randint(0, 12)
    while acknowledged < wanted and os.read(incoming, 1):
        acknowledged += 1
    # At some point inside of the next write.
    select.select([incoming], [], [], rng.random() * 0.004)
    os.kill(process, signal.SIGKILL)
    while os.read(incoming, 1):
        acknowledged += 1
    os.waitpid(process, 0)
    os.close(incoming)
    return acknowledged


def _write_for_ever(path: Path, writes: list[Batch], number: int, outgoing: int) -> None:
    """The robot's side: acknowledge each write with a byte; ends only by SIGKILL."""
    try:
        journal = SqliteJournal(path)
        while True:
            journal.write(Persist(*record) for record in _numbered(writes, number).items())
            os.write(outgoing, b".")
            number += 1
    finally:
        os._exit(1)
