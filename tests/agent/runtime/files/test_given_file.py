"""A folder where a file is wanted is one line, also for those that then look into the folder."""

from pathlib import Path

import pytest

from agent.runtime.files.given_file import GivenFileError, read_bytes


def test_f_a_folder_is_no_regular_file(tmp_path: Path) -> None:
    with pytest.raises(GivenFileError, match="not a regular file"):
        read_bytes(tmp_path, 100)
