"""Two sprayers of two makers on one field: nothing is left out, and hardly anything is worked twice."""

import pytest

from sim.rigs.implements_rig import two_sprayers


@pytest.mark.slow
def test_one_pass_of_each() -> None:
    found = two_sprayers(passes=1, length_m=60.0)
    assert found.log_in_for_s < 3.0 and found.left_out < 1e-6 and found.twice < 0.02, found
    assert found.nearest_m > 12.0, "they met"


@pytest.mark.slow
@pytest.mark.parametrize(("passes", "speed_m_s"), [(2, 3.0), (4, 3.0), (4, 5.0)])
def test_a_field(passes: int, speed_m_s: float) -> None:
    found = two_sprayers(passes=passes, speed_m_s=speed_m_s)
    assert found.left_out < 1e-6 and found.twice <= 0.01, found


@pytest.mark.slow
@pytest.mark.parametrize("fix_for_us", [200_000, 1_000_000])
def test_a_slow_receiver(fix_for_us: int) -> None:
    """With 1 Hz nothing was painted above 2 m/s, and no section switched for half of each second."""
    found = two_sprayers(passes=2, speed_m_s=3.0, fix_for_us=fix_for_us)
    assert found.left_out < 1e-6 and found.twice <= 0.01, found


@pytest.mark.slow
def test_without_the_shared_map_all_of_it_is_worked_twice() -> None:
    assert two_sprayers(passes=2, shared=False).twice > 0.99
