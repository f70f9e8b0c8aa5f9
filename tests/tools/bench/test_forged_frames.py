"""The trial of forged frames: an outsider changes nothing, and its judge finds a fleet that believes."""

import pytest

from agent.peer.proven_frames import NOTHING_HELD
from tools.bench.forged_frames import KINDS, ForgeryTrial, figures, trial


@pytest.mark.parametrize("seed", [3, 4])
def test_an_outsider_changes_no_replica_state_or_motion(seed: int) -> None:
    played = trial(700, seed)
    assert not played.broken, f"tools.bench.forged_frames.trial(700, {seed}): {played.broken}"
    assert set(played.tried) == set(KINDS)


def test_the_judge_finds_a_fleet_that_believes_unproven_frames() -> None:
    """An outsider's frame that fits is rare, so one of a few attackers has to find it."""
    seeds = range(1, 6)
    for seed in seeds:
        played = ForgeryTrial(seed)
        for peer in played.rig.peers.values():
            peer.proven.kinds = peer._held = NOTHING_HELD
        played.run(5_000)
        if played.broken:
            return
    raise AssertionError(f"none of the seeds {seeds} was noticed")


def test_the_figure() -> None:
    (figure,) = figures(True, seed=5, frames=300)
    assert figure.holds and "300" in figure.figure
