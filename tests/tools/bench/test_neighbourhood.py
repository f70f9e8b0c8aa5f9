"""Neighbours carried from step to step are those of a search from scratch, ties included."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.examples import examples
from tools.bench.kernels import agent_table as column
from tools.bench.kernels.orca_fleet import OrcaFleet

COUNT = 60


def agents(rng: np.random.Generator, spread: float, step: float) -> column.Agents:
    """On a lattice of `step`, where many are equally far from each other; 0: anywhere."""
    made = np.zeros((COUNT, column.AGENT_COLUMNS), dtype=np.float32)
    places = rng.uniform(-spread, spread, (COUNT, 2))
    made[:, : column.Y + 1] = np.round(places / step) * step if step else places
    made[:, column.VX : column.WANT_Y + 1] = rng.uniform(-2.0, 2.0, (COUNT, 4))
    made[:, column.RADIUS], made[:, column.SPEED_MAX] = 0.5, 2.0
    made[:, column.RANGE] = rng.uniform(2.0, 15.0, COUNT)
    made[:, column.NEIGHBOURS] = rng.integers(0, 11, COUNT)
    made[0, column.NEIGHBOURS] = 10
    made[:, column.HORIZON] = made[:, column.WALL_HORIZON] = 3.0
    return made


@pytest.mark.slow
@settings(max_examples=examples(60), deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([4.0, 20.0, 60.0]), st.sampled_from([0.0, 1.0]))
def test_what_is_kept_changes_nothing(seed: int, spread: float, step: float) -> None:
    rng = np.random.default_rng(seed)
    fleet = OrcaFleet(agents(rng, spread, step), 0.25)
    for round_ in range(6):
        fresh = OrcaFleet(fleet.agents.copy(), 0.25)
        fresh._order[:] = fleet._order
        fresh.step(move=False)
        fleet.step(move=round_ % 2 == 0)
        chosen = fleet.agents[:, column.NEW_VX : column.NEW_VY + 1]
        assert np.array_equal(chosen, fresh.agents[:, column.NEW_VX : column.NEW_VY + 1])
        if round_ == 3:  # somebody else moves them: nobody who was near is near now
            fleet.agents[:, : column.Y + 1] = rng.permutation(fleet.agents[:, : column.Y + 1])
            fleet.agents[1:, column.NEIGHBOURS] = rng.integers(0, 11, COUNT - 1)


def test_far_from_everybody() -> None:
    made = agents(np.random.default_rng(1), 4.0, 1.0)
    fleet = OrcaFleet(made, 0.25)
    fleet.step()
    made[:, column.X] = np.arange(COUNT) * 100.0
    fleet.step()
    wanted = made[:, column.WANT_X : column.WANT_Y + 1]
    fast = np.hypot(wanted[:, 0], wanted[:, 1]) <= 2.0
    chosen = made[:, column.NEW_VX : column.NEW_VY + 1]
    assert np.array_equal(chosen[fast], wanted[fast])
