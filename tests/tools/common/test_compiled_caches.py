"""Machine code that others could have written is not loaded."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tools.build import compiled_core
from tools.common.compiled_caches import (
    CACHE,
    ROOT,
    can_keep,
    can_write,
    foreign_writer,
    guard_kernels,
    place_kernels,
)

NOBODY = 65534
AS_NOBODY = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]


def another_user_runs(interpreter: str) -> bool:
    """Whether another user can start it: one below the home of root is closed to them."""
    if not hasattr(os, "getuid") or os.getuid() != 0 or shutil.which("setpriv") is None:
        return False
    started = [*AS_NOBODY, "sh", "-c", 'exec "$1" -S -c ""', "sh", interpreter]
    return subprocess.run(started, capture_output=True, check=False).returncode == 0


by_root = pytest.mark.skipif(
    not another_user_runs(sys.executable),
    reason="only root can be another user, with an interpreter that others can start",
)


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
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(compiled_core.OFF, raising=False)
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


def test_a_folder_for_kernels_is_deleted_when_the_command_ends(tmp_path: Path) -> None:
    shared, temporary = tmp_path / "shared", tmp_path / "temporary"
    shared.mkdir()
    shared.chmod(0o777)
    temporary.mkdir()
    done = subprocess.run(
        [sys.executable, "-m", "tools.cli.headland", "--version"], capture_output=True, text=True,
        check=False, timeout=120, cwd=ROOT,
        env={"PATH": "/usr/bin:/bin", CACHE: str(shared), "TMPDIR": str(temporary)},
    )  # fmt: skip
    assert done.returncode == 0 and "others can write" in done.stderr
    assert not list(temporary.iterdir())


def test_a_folder_that_is_not_there_can_be_written_where_it_can_be_made(tmp_path: Path) -> None:
    assert can_write(tmp_path / "a" / "b")
    (tmp_path / "file").touch()
    assert not can_write(tmp_path / "file") and not can_write(tmp_path / "file" / "a")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other folders elsewhere")
def test_ready_kernels_are_found_where_others_cannot_be_kept(tmp_path: Path) -> None:
    beside = tmp_path / "agent" / "kernels" / "__pycache__"
    beside.parent.mkdir(parents=True)
    beside.touch()  # no folder, so nothing can be written there
    environment = {"HOME": str(beside)}
    assert not can_keep(environment, tmp_path)
    beside.unlink()
    beside.mkdir()
    assert can_keep(environment, tmp_path) and not place_kernels(environment, tmp_path)
    (beside / "kernels.json").write_text("{}")
    (tmp_path / "agent" / "paths").mkdir()
    (tmp_path / "agent" / "paths" / "__pycache__").touch()
    environment["HOME"] = str(beside / "kernels.json")
    assert place_kernels(environment, tmp_path)
    assert Path(environment[CACHE], "kernels.json").read_text() == "{}"


@pytest.mark.parametrize("mode", [0o700, 0o777])
def test_a_compiler_does_not_outlive_its_temporary_folder(tmp_path: Path, mode: int) -> None:
    tmp_path.chmod(mode)
    code = (
        "import subprocess, sys; from tools.common import compiled_caches as c; c.guard()\n"
        "child = subprocess.Popen([sys.executable, '-c', 'input()'], stdin=subprocess.PIPE,"
        " stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)\n"
        "c.end_with_temporary(child)\n"
        "import atexit; atexit._run_exitfuncs(); print(child.poll())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120, cwd=ROOT,
        env={"PATH": "/usr/bin:/bin", "PYTHONPATH": str(ROOT), CACHE: str(tmp_path)},
    )  # fmt: skip
    assert done.stdout.split() == ["None" if mode == 0o700 else "-9"]


@by_root
@pytest.mark.parametrize("wanted", ["numba", "matplotlib", "nothing"])
def test_without_a_writable_cache_there_is_a_temporary_one(wanted: str) -> None:
    code = (
        "import os, sys; sys.path.insert(0, sys.argv[1]); os.chdir('/')\n"
        "from tools.common import compiled_caches as c; c.guard()\n"
        "print(c._Kernels.not_kept, c.CACHE in os.environ, c.PICTURES in os.environ)\n"
        "if sys.argv[2] == 'numba':\n"
        "    import agent.field.plan_kernels\n"
        "elif sys.argv[2] == 'matplotlib': import matplotlib\n"
        "print(c.PICTURES in os.environ)\n"
    )
    with tempfile.TemporaryDirectory() as folder:  # another user reaches none of pytest's
        Path(folder).chmod(0o1777)
        done = subprocess.run(
            [*AS_NOBODY, sys.executable, "-c", code, str(ROOT), wanted], capture_output=True, text=True,
            check=False, timeout=120,
            env={"PATH": "/usr/bin:/bin", "HOME": "/nonexistent", "TMPDIR": folder},
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert done.stdout.split() == ["True", "True", "False", str(wanted == "matplotlib")]
        assert done.stderr.count("\n") == (wanted == "numba"), done.stderr
        assert not list(Path(folder).iterdir())
