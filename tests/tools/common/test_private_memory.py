"""Memories of robots, which may hold the fleet's secrets, are for their user alone."""

import os
from pathlib import Path

import pytest

from agent.interface.effects import Persist
from agent.runtime.sqlite_journal import SqliteJournal
from tools.common.launch_keys import is_private
from tools.common.private_memory import keep_private


@pytest.mark.parametrize("left", [False, True], ids=["new", "of an earlier version"])
def test_others_cannot_read_the_secrets_of_a_fleet_in_the_memory_of_a_robot(
    left: bool, tmp_path: Path
) -> None:
    memory, old = tmp_path / "robot0.sqlite", os.umask(0)
    try:
        if left:
            SqliteJournal(memory).close()
            assert not is_private(memory)
        keep_private(memory)
        journal, recalled = SqliteJournal.opened(memory)
        assert not recalled
        journal.write([Persist("keys", bytes(34))])
        found = sorted(tmp_path.iterdir())
        assert len(found) > 1 and all(map(is_private, found)), found
        journal.close()
        assert SqliteJournal.opened(memory)[1] == {"keys": bytes(34)}
    finally:
        os.umask(old)


def test_a_link_in_place_of_a_memory_changes_nothing_behind_it(tmp_path: Path) -> None:
    other, memory = tmp_path / "other", tmp_path / "robot0.sqlite"
    other.touch()
    other.chmod(0o644)
    memory.symlink_to(other)
    keep_private(memory)
    assert other.stat().st_mode & 0o777 == 0o644
