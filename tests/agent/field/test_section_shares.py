"""The cut: everything is in it once, runs are balanced, and every peer computes the same."""

from hypothesis import given, settings
from hypothesis import strategies as st

from agent.field.section_shares import SectionJob, cut, shares

jobs_of = st.lists(st.floats(0.1, 50), min_size=0, max_size=60).map(
    lambda works: [
        SectionJob(i, w, ((float(i), 0.0), (float(i), 9.0))) for i, w in enumerate(works)
    ]
)


@given(jobs_of, st.integers(1, 12))
def test_a_cut_is_a_partition_in_order(jobs: list[SectionJob], parts: int) -> None:
    runs = cut(jobs, parts)
    assert [job for run in runs for job in run] == jobs
    assert len(runs) == min(parts, len(jobs)) or len(runs) <= parts
    assert all(runs)


@given(jobs_of, st.integers(1, 12))
def test_no_run_is_longer_than_its_share_and_one_job(jobs: list[SectionJob], parts: int) -> None:
    if jobs:
        total_s, longest_s = sum(j.work_for_s for j in jobs), max(j.work_for_s for j in jobs)
        for run in cut(jobs, parts):
            assert sum(j.work_for_s for j in run) <= total_s / parts + longest_s + 1e-6


@settings(deadline=None)  # the kernel of the assignment is compiled at the first
@given(
    jobs_of,
    st.dictionaries(
        st.integers(0, 107), st.tuples(st.floats(-99, 99), st.floats(-99, 99)), min_size=1
    ),
)
def test_everybody_gets_the_same_answer(
    jobs: list[SectionJob], robots: dict[int, tuple[float, float]]
) -> None:
    mine = shares(jobs, robots, 2.0)
    theirs = shares(jobs, dict(reversed(robots.items())), 2.0)
    assert mine == theirs
    assert sorted(job.section for run in mine.values() for job in run) == [
        job.section for job in jobs
    ]


def test_runs_go_to_the_robots_that_are_near() -> None:
    jobs = [SectionJob(i, 10.0, ((10.0 * i, 0.0),)) for i in range(8)]
    robots = {3: (75.0, 0.0), 5: (0.0, 0.0)}
    result = shares(jobs, robots, 2.0)
    assert [job.section for job in result[5]] == [0, 1, 2, 3]
    assert [job.section for job in result[3]] == [7, 6, 5, 4]
