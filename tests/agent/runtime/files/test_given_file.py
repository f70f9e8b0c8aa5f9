"""A folder where a file is wanted is one line, also for those that then look into the folder."""

from pathlib import Path

import pytest

from agent.runtime.files.given_file import (
    GivenFileError,
    parse_json,
    parse_toml,
    read_bytes,
    read_text,
)


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


@pytest.mark.parametrize(
    "text", [r'"\ud800"', r'{"\udFFF": 1}', r'["\ude00\ud83d"]', r'"\uD83D x"']
)
def test_half_of_a_character_is_no_json(text: str) -> None:
    """A field whose name was half of a character ended in a traceback at the first file that named it."""
    with pytest.raises(GivenFileError, match="half of a character"):
        parse_json(text)
    assert parse_json(r'"\ud83d\ude00 \\ud800"') == "\U0001f600 \\ud800"


def test_text_with_the_mark_of_a_windows_editor_is_read(tmp_path: Path) -> None:
    """`{` behind a byte order mark was "Expecting value: line 1 column 1"."""
    (tmp_path / "field.json").write_bytes('\ufeff{"name": "Åker"}'.encode())
    assert parse_json(read_text(tmp_path / "field.json", 100)) == {"name": "Åker"}
