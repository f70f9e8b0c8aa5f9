"""Which work the records of a journal are of. Those of another field are put by, and come back with it.

Registers, units and patches of a map are kept by their numbers, and each field has a section 0. A robot
that is given another field must not take the sections that it has finished for sections of the new one.
Stops, counters and orders of transports are not of one field, and stay.
"""

from collections.abc import Mapping
from struct import Struct
from typing import Final

from agent.interface.effects import Persist
from agent.peer.durable_records import MAP, PROGRESS, REGISTER
from agent.runtime.sqlite_journal import SqliteJournal

WORK_KEY: Final = "work"  # the record that names the work; journals of earlier versions have none
WORK: Final = Struct("<I")
OF_WORK: Final = (REGISTER, PROGRESS, MAP)
# The name of transports: a fleet keeps what it has carried also where its building is changed.
TRANSPORTS: Final = 1 << 24


def of_work(
    journal: SqliteJournal, recalled: Mapping[str, bytes], work: int
) -> tuple[Mapping[str, bytes], int]:
    """What a robot remembers that does this work, and how many records of other work were put by.

    `recalled`: all records of its journal. `work`: the u24 hash of its field, or `TRANSPORTS`. A journal
    that does not say of which work it is counts as one of this work. Raises OSError."""
    records = {key: raw for key, raw in recalled.items() if key != WORK_KEY}
    named = recalled.get(WORK_KEY, b"")
    was = WORK.unpack(named)[0] if len(named) == WORK.size else work
    put_by = {} if was == work else {k: v for k, v in records.items() if k.startswith(OF_WORK)}
    mine = _prefix(work)
    back = {} if was == work else {k: v for k, v in records.items() if k.startswith(mine)}
    if named != WORK.pack(work):
        told = [Persist(_prefix(was) + key, raw) for key, raw in put_by.items()]
        told += [Persist(key.removeprefix(mine), raw) for key, raw in back.items()]
        journal.exchange([*put_by, *back], [*told, Persist(WORK_KEY, WORK.pack(work))])
    kept = {k: v for k, v in records.items() if k not in put_by and k not in back}
    return kept | {key.removeprefix(mine): raw for key, raw in back.items()}, len(put_by)


def _prefix(work: int) -> str:
    return f"of {work:07x}/"
