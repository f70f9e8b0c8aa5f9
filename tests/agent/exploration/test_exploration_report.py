"""The mission's markdown, letter by letter."""

from agent.exploration.exploration_report import FleetMember, FleetStatus, serialize_for_llm
from agent.exploration.exploration_task import FleetTask, Status, TaskKind
from crdt.occupancy import MergeResult

SAMPLE = """\
## Fleet Status (3 robots)
- robot-1: pos=(0.5, -0.3) task: Explore frontier at (1.2, -0.5)
- robot-2: pos=(-1.0, 0.8) task: Explore frontier at (-1.5, 1.2)
- robot-3: pos=(0.0, 0.0) idle

### Active Tasks
- [task-1] Explore frontier at (1.2, -0.5) → robot-1
- [task-2] Explore frontier at (-1.5, 1.2) → robot-2
"""


def status() -> FleetStatus:
    first = FleetTask(1, TaskKind.EXPLORE_FRONTIER, (1.2, -0.5), 1, Status.ACTIVE, 0)
    second = FleetTask(2, TaskKind.EXPLORE_FRONTIER, (-1.5, 1.2), 2, Status.ACTIVE, 0)
    members = (
        FleetMember(1, 0.5, -0.3, 0.0, first, 9_000_000, True),
        FleetMember(2, -1.0, 0.8, 0.0, second, 8_900_000, True),
        FleetMember(3, 0.0, 0.0, 0.0, None, 4_000_000, False),
    )
    return FleetStatus(members, (first, second), MergeResult(0, 2, 0), 40.0, 9_000_000)


def test_it_is_the_sample_of_the_mission() -> None:
    assert serialize_for_llm(status()) == SAMPLE


def test_without_tasks_there_is_no_second_part() -> None:
    idle = status()._replace(tasks=())
    assert "Active" not in serialize_for_llm(idle)


def test_ages_stand_at_the_ends_of_lines() -> None:
    lines, sample = serialize_for_llm(status(), ages=True).splitlines(), SAMPLE.splitlines()
    assert lines[1] == sample[1] + " (0.0 s ago)" and lines[2] == sample[2] + " (0.1 s ago)"
    assert lines[3] == sample[3] + " (5.0 s ago)" and lines[6] == sample[6] + " (0.0 s ago)"
