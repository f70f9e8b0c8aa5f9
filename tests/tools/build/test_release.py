"""A release by one command, tried on a copy: the changelog, the version, the fragments, the tag."""

import subprocess
import tomllib
from datetime import date
from pathlib import Path
from zipfile import ZipFile

import pytest

from tools.build import release as making
from tools.build.release import ReleaseError, check_wheel, checked, release, section, with_section

LOG = "# Changelog\n\nText.\n\n## 0.4.0 (2026-01-01)\n\n* old\n"


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    (tmp_path / "changes").mkdir()
    (tmp_path / "changes" / "README.md").write_text("how")
    (tmp_path / "changes" / "31-map.md").write_text("* The map has a legend.\n")
    (tmp_path / "changes" / "28-keys.md").write_text("* Keys end.\n")
    (tmp_path / "CHANGELOG.md").write_text(LOG)
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "headland"\nversion = "0.4.0"\n')
    (tmp_path / ".gitignore").write_text("dist\n")
    for words in (
        ["init", "-q"], ["config", "user.email", "a@example.org"], ["config", "user.name", "A"],
        ["add", "-A"], ["commit", "-qm", "all"],
    ):  # fmt: skip
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    return tmp_path


def test_a_release_moves_fragments_sets_the_version_and_tags(
    copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = making._run

    def without_pip(root: Path, *words: str) -> str:
        if "pip" not in words:
            return run(root, *words)
        (root / "dist").mkdir()
        with ZipFile(root / "dist" / "headland-0.5.0-py3-none-any.whl", "w") as wheel:
            wheel.writestr("headland/__init__.py", "")
            wheel.writestr("headland-0.5.0.dist-info/METADATA", "")
        return ""

    monkeypatch.setattr(making, "_run", without_pip)
    text = release("0.5.0", copy)
    log = (copy / "CHANGELOG.md").read_text()
    assert text in log and log.index("## 0.5.0") < log.index("## 0.4.0")
    assert "### People\n\n* The map has a legend." in log and "### Trust and keys" in log
    assert tomllib.loads((copy / "pyproject.toml").read_text())["project"]["version"] == "0.5.0"
    assert [path.name for path in (copy / "changes").iterdir()] == ["README.md"]
    assert run(copy, "git", "tag").split() == ["v0.5.0"] and not run(copy, "git", "status", "-s")
    with pytest.raises(ReleaseError, match="nothing to release"):
        release("0.6.0", copy)


def test_a_dry_run_changes_nothing(copy: Path) -> None:
    assert "## 0.5.0" in release("0.5.0", copy, dry=True)
    assert (copy / "CHANGELOG.md").read_text() == LOG


def test_changes_that_are_not_committed_are_refused(copy: Path) -> None:
    (copy / "CHANGELOG.md").write_text(LOG + "* more\n")
    with pytest.raises(ReleaseError, match="not committed"):
        release("0.5.0", copy)


def test_wrong_versions_and_wheels_are_one_line(tmp_path: Path) -> None:
    assert checked("0.5", "0.4.0") == "0.5"
    for wrong in ("0.4.0", "0.3", "five"):
        with pytest.raises(ReleaseError, match=wrong):
            checked(wrong, "0.4.0")
    with ZipFile(tmp_path / "x.whl", "w") as wheel:
        wheel.writestr("tools/__init__.py", "")
    with pytest.raises(ReleaseError, match="installs tools"):
        check_wheel(tmp_path / "x.whl", "0.5.0")
    with pytest.raises(ReleaseError, match="no release"):
        with_section("# Changelog\n", section("1.0", date(2026, 1, 1), {}))
