"""Machine code that others could have written is not loaded."""

import subprocess
import sys
from pathlib import Path

import pytest

from tools.build import compiled_core
from tools.common.compiled_caches import CACHE, ROOT, foreign_writer, guard_kernels


@pytest.mark.parametrize(
    ("mode", "ours"), [(0o700, True), (0o755, True), (0o777, False), (0o1777, False)]
)
def test_a_folder_that_others_can_write_is_told(tmp_path: Path, mode: int, ours: bool) -> None:
    folder = tmp_path / "cache"
    folder.mkdir()
    folder.chmod(mode)
    assert foreign_writer(folder) == (None if ours else folder)


def test_a_folder_above_counts_unless_it_is_sticky(tmp_path: Path) -> None:
    folder = tmp_path / "above" / "cache"
    folder.mkdir(parents=True)
    folder.parent.chmod(0o777)
    assert foreign_writer(folder) == folder.parent
    folder.parent.chmod(0o1777)
    assert foreign_writer(folder) is None


def test_numba_is_led_to_a_folder_of_its_own(tmp_path: Path) -> None:
    folder = tmp_path / "kernels"
    folder.mkdir()
    environment = {CACHE: str(folder)}
    assert guard_kernels(environment) is None and environment[CACHE] == str(folder)
    folder.chmod(0o777)
    assert guard_kernels(environment) == folder
    own = Path(environment[CACHE])
    assert own != folder and not own.stat().st_mode & 0o077
    own.rmdir()


def test_kernels_beside_the_sources_count(tmp_path: Path) -> None:
    beside = tmp_path / "agent" / "paths" / "__pycache__"
    beside.mkdir(parents=True)
    environment: dict[str, str] = {}
    assert guard_kernels(environment, tmp_path) is None and not environment
    beside.chmod(0o777)
    assert guard_kernels(environment, tmp_path) == beside
    Path(environment[CACHE]).rmdir()


@pytest.mark.skipif(foreign_writer(ROOT) is not None, reason="others can write these sources")
def test_a_core_that_others_can_write_is_not_used(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "core"
    folder.mkdir()
    (folder / f"nothing{compiled_core.SUFFIX}").touch()
    folder.chmod(0o777)
    assert not compiled_core.use(folder)
    assert "others can write" in capfd.readouterr().err


def test_the_command_says_it_in_one_line(tmp_path: Path) -> None:
    tmp_path.chmod(0o777)
    done = subprocess.run(
        [sys.executable, "-m", "tools.cli.headland", "--version"], capture_output=True, text=True,
        check=False, timeout=120, env={"PATH": "/usr/bin:/bin", CACHE: str(tmp_path)},
        cwd=Path(__file__).parents[3],
    )  # fmt: skip
    assert done.returncode == 0 and done.stderr.count("others can write") == 1, done.stderr
