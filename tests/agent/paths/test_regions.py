"""Regions are those of scipy.ndimage, number by number."""

import numpy as np
import pytest
import scipy

from agent.paths.regions import regions_of


@pytest.mark.parametrize("seed", range(20))
def test_regions_are_numbered_as_scipy_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(1, 40, 2)
    blocked = rng.random((rows, columns)) < rng.uniform(0.1, 0.9)
    expected, _ = scipy.ndimage.label(~blocked)
    found = regions_of(blocked)
    assert found.dtype == np.int32 and np.array_equal(found, expected), f"seed {seed}"
