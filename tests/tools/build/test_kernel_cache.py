"""A run that has to compile its kernels first says so."""

from pathlib import Path

import pytest

from tools.build.kernel_cache import kernels_kept


def test_an_empty_cache_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    numba = pytest.importorskip("numba", reason="the extra `sim` is not installed")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert kernels_kept() == 0
    (tmp_path / "agent").mkdir()
    (tmp_path / "agent" / "kernel.nbi").write_bytes(b"")
    assert kernels_kept() == 1
