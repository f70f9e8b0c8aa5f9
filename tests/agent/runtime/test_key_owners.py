"""Whose key files and folders are believed: the user's own and root's, as ssh does it."""

import grp
import os
import pwd
from collections.abc import Callable
from pathlib import Path

import pytest

from agent.runtime.files import private_file
from agent.runtime.files.key_file import OPERATOR, KeyFileError, fresh, read, write
from agent.runtime.files.private_file import trusted_users, weakness

SOMEBODY = 4711
Own = Callable[[Path, int], None]


@pytest.fixture
def own(monkeypatch: pytest.MonkeyPatch) -> Own:
    """Gives a file or a folder to a user, as far as `Path.stat` shows it: only root can do it really."""
    given, stat = dict[Path, int](), Path.stat

    def shown(path: Path, *, follow_symlinks: bool = True) -> os.stat_result:
        found = stat(path, follow_symlinks=follow_symlinks)
        user = given.get(path, found.st_uid)
        return os.stat_result([*found[:4], user, *found[5:]])

    monkeypatch.setattr(Path, "stat", shown)
    return given.__setitem__


@pytest.fixture
def key(tmp_path: Path) -> Path:
    folder = tmp_path / "farm" / "keys"
    folder.mkdir(parents=True)
    for each in (folder, folder.parent):
        each.chmod(0o755)
    write(folder / "fleet.json", folder / "operator.json", fresh(), 249)
    return folder / "operator.json"


def refused(path: Path) -> str:
    with pytest.raises(KeyFileError) as problem:
        read(path, OPERATOR)
    assert "\n" not in str(problem.value) and str(path) in str(problem.value)
    return str(problem.value)


def test_a_key_file_of_another_user_is_refused_in_one_line(key: Path, own: Own) -> None:
    """Its user may exchange it for one of a fleet that obeys him."""
    read(key, OPERATOR)
    own(key, SOMEBODY)
    assert f"it belongs to user {SOMEBODY}" in refused(key)


def test_a_key_file_of_root_is_believed(key: Path, own: Own) -> None:
    own(key, 0)
    assert read(key).device == 249


def test_a_key_file_below_a_folder_of_another_user_is_refused(key: Path, own: Own) -> None:
    own(key.parent.parent, SOMEBODY)
    assert f"user {SOMEBODY} owns {key.parent.parent} and may replace it" in refused(key)


@pytest.mark.parametrize("above", [0, 1])
def test_a_key_file_below_a_folder_that_others_can_write_is_refused(key: Path, above: int) -> None:
    folder = key.parents[above]
    folder.chmod(0o777)
    assert f"others may replace it: chmod go-w {folder}" in refused(key)
    folder.chmod(0o1777)  # as /tmp: nobody renames what is another user's
    assert read(key).device == 249


def test_a_link_is_as_weak_as_the_place_that_it_leads_to(key: Path, tmp_path: Path) -> None:
    link = tmp_path / "operator.json"
    link.symlink_to(key)
    assert read(link).device == 249
    key.parent.parent.chmod(0o777)
    assert f"chmod go-w {key.parent.parent}" in refused(link)


def test_a_folder_above_that_the_users_own_group_can_write_is_safe(
    key: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Debian and Fedora make such groups, of one user each."""
    key.parent.parent.chmod(0o775)
    user, group = pwd.getpwuid(os.geteuid()), key.parent.parent.stat().st_gid
    alone = grp.struct_group((user.pw_name, "x", group, []))
    monkeypatch.setattr(grp, "getgrgid", lambda gid: alone)
    assert not weakness(key) or user.pw_gid != group
    monkeypatch.setattr(
        grp, "getgrgid", lambda gid: grp.struct_group(("farm", "x", group, ["eve"]))
    )
    assert "others may replace it" in weakness(key)


def test_under_sudo_the_files_of_who_called_it_are_believed(
    key: Path, own: Own, monkeypatch: pytest.MonkeyPatch
) -> None:
    own(key, SOMEBODY)
    monkeypatch.setenv("SUDO_UID", str(SOMEBODY))
    monkeypatch.setattr(os, "geteuid", lambda: SOMEBODY - 1)
    assert trusted_users() == {0, SOMEBODY - 1}, "a user may set any variable"
    assert f"user {SOMEBODY}" in refused(key)
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert trusted_users() == {0, SOMEBODY}
    monkeypatch.setattr(private_file, "MODES", False)  # Windows has no users in this sense
    assert read(key).device == 249
