"""M24: the headline figures of `bench orca` are of what robots run."""

from tools.bench.orca import whole_robot


def test_m24_what_a_robot_runs_is_measured() -> None:
    figures = list(whole_robot(1))
    assert all("what a robot runs" in figure.figure for figure in figures)
    assert figures[0].value > 0.0
