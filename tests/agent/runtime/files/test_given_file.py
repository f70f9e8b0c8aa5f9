"""A folder where a file is wanted is one line, also for those that then look into the folder."""

from pathlib import Path

import pytest

from agent.runtime.files.given_file import GivenFileError, parse_toml, read_bytes


def test_f_a_folder_is_no_regular_file(tmp_path: Path) -> None:
    with pytest.raises(GivenFileError, match="not a regular file"):
        read_bytes(tmp_path, 100)


def test_a_row_of_a_drawing_is_no_key_of_many_parts() -> None:
    """Found: a hall of 40 free cells in a row, drawn in the scenario, was refused."""
    row = "." * 40
    assert parse_toml(f"map = '''\n{row}\n'''\n")["map"] == f"{row}\n"
    assert parse_toml(f'map = """\n{row}\n"""\n')["map"] == f"{row}\n"
    key = ".".join(["a"] * 40)
    for text in (
        f"{key} = 1\n",
        f"# '''\n{key} = 1\n# '''\n",
        f"b = \"'''\"\n{key} = 1\nc = \"'''\"\n",
    ):
        with pytest.raises(GivenFileError, match="parts"):
            parse_toml(text)
