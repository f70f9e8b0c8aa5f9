"""The same campaign on a Dask cluster and here: the same results by seed."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from sim.rigs.segments_rig import SegmentFleet
from tools.chaos.campaign import ClusterError, workers
from tools.chaos.chaos import chaos

distributed = pytest.importorskip("distributed", reason="the extra `backbone` is not installed")


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    make: Any = distributed.LocalCluster
    with make(n_workers=1, threads_per_worker=1, dashboard_address=None, processes=True) as cluster:
        yield str(cluster.scheduler_address)


def trace(seed: int) -> tuple[int, int, int]:
    """A short run of two segments: bits on each wire, messages between them."""
    fleet = SegmentFleet(2, 2, seed)
    fleet.run(3_000_000)
    found = fleet.bits[1], fleet.bits[2], fleet.backbone.messages
    fleet.end()
    return found


@pytest.mark.slow
def test_results_do_not_depend_on_where_they_ran(scheduler: str) -> None:
    seeds = range(3)
    with workers(cluster=scheduler) as far:
        there = list(far.map(trace, seeds))
    assert there == [trace(seed) for seed in seeds]
    assert len(set(there)) > 1


@pytest.mark.slow
def test_chaos_on_a_cluster(scheduler: str, tmp_path: Path) -> None:
    assert chaos("3", "crash", 1, None, tmp_path / "far", False, True, scheduler) == 0
    assert (tmp_path / "far" / "chaos.json").exists()


@pytest.mark.slow
def test_no_scheduler_is_told_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tools.chaos.campaign.CONNECT_S", "1s")
    with pytest.raises(ClusterError), workers(cluster="tcp/127.0.0.1:1"):
        pass
    assert chaos("3", "crash", 1, None, tmp_path, False, True, "tcp/127.0.0.1:1") == 2
    assert "dask scheduler" in capsys.readouterr().err
