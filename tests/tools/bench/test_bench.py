"""The benches run and their scales are right; how fast things are is for the benches to say."""

from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import label

from sim.runs.exploration_fleet import Sharing
from tools.bench import crowd, exploration, sync, theta
from tools.bench.map_kinds import KINDS, read, small_maps
from tools.bench.optimum import Judge


def test_every_kind_of_map_has_somewhere_to_go() -> None:
    for kind, _, blocked in small_maps(1, 40):
        regions, _ = label(~blocked)
        largest = np.bincount(regions[regions > 0]).max()
        assert 0.02 < blocked.mean() < 0.75, kind
        assert largest > 0.2 * blocked.size, kind
    assert len(KINDS) == 9


def test_the_judge_knows_a_shortest_path_and_a_gap() -> None:
    blocked = np.zeros((5, 5), dtype=np.bool_)
    blocked[2, :3] = True
    judge = Judge(blocked)
    straight = np.array([[[0.0, 0.0], [4.0, 0.0]], [[0.0, 4.0], [4.0, 4.0]]])
    assert judge.through(straight).tolist() == [True, False]
    expected = 2 * np.hypot(1.5, 2.5) + 1.0
    assert judge.lengths(straight).tolist() == pytest.approx([expected, 4.0], abs=1e-3)
    gap = np.zeros((4, 4), dtype=np.bool_)
    gap[:2, :2] = gap[2:, 2:] = True
    assert not np.isfinite(Judge(gap).lengths(np.array([[[3.0, 0.0], [0.0, 3.0]]])))


def test_lengths_are_the_optimum() -> None:
    mean, worst = theta.lengths(14, 6)
    assert mean.holds and worst.holds, (mean, worst)


def test_a_map_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.map"
    path.write_text("type octile\nheight 2\nwidth 3\nmap\n.@T\nGW.\n")
    assert read(path).tolist() == [[False, True, True], [False, True, False]]


def test_the_order_of_merging_maps_does_not_matter() -> None:
    assert exploration.merge_orders(1_000, 3).holds


@pytest.mark.parametrize(
    ("times_s", "holds"),
    [
        ((100.0, 50.0, 100.0, 50.0), True),
        ((100.0, 80.0, 100.0, 50.0), False),
        ((inf, 50.0, 100.0, 50.0), False),  # one robot has not seen 95 %
        ((100.0, inf, 100.0, 50.0), False),
        ((100.0, 50.0, 100.0, inf), False),  # nor has the omniscient fleet
    ],
)
def test_a_speed_up_of_who_has_not_arrived_does_not_hold(
    times_s: tuple[float, ...], holds: bool
) -> None:
    """It held with an infinite speed-up, and divided by zero."""
    keys = [(n, how) for how in (Sharing.FLEET, Sharing.AT_ONCE) for n in (1, 2)]
    runs: Any = {
        key: [SimpleNamespace(time_95_s=time_s)] for key, time_s in zip(keys, times_s, strict=True)
    }
    *_, share = exploration.speed(runs, [1, 2], "nowhere")
    assert share.holds is holds, share


def test_a_hundred_robots_in_rooms_have_a_plan_that_brings_all_to_their_goals() -> None:
    arrived, *_ = crowd.joint(range(2))
    assert arrived.holds, arrived


def test_who_waits_hardly_at_all_does_not_make_the_others_wait_too_long() -> None:
    assert crowd.unfairness([0.0, 0.5, 2.0]) == 2.0
    assert crowd.unfairness([10.0, 20.0, 60.0]) == 3.0


def test_what_is_said_of_the_size_of_an_entry_is_what_its_figure_says() -> None:
    """8.004 bytes held a target of at most 8: they were rounded before they were compared."""
    size = next(figure for figure in sync.merges(1, 1) if figure.figure == "state an entry")
    assert size.target == "<= 8" and size.holds is (size.value <= 8)
