"""What any peer can say of the whole exploring fleet, also as markdown for a language model.

There is no coordinator to ask: poses are those last heard, tasks are the claims in the allocation. How
old each line is can be told with it; without ages the text has exactly the mission's shape.
"""

from collections.abc import Sequence
from typing import NamedTuple

from agent.exploration.exploration_mission import ExplorationMission
from agent.exploration.exploration_task import FleetTask, Status, fixed
from agent.interface.config import S
from agent.interface.mission import FleetView
from crdt import Phase
from crdt.occupancy import MergeResult

XY = tuple[float, float]


class FleetMember(NamedTuple):
    slot: int
    x_m: float
    y_m: float
    rotation_rad: float  # for others the course they drive
    assigned_task: FleetTask | None
    last_sync_us: int  # when it was last heard; for ourselves now
    active: bool

    @property
    def device_id(self) -> str:
        return f"robot-{self.slot}"


class FleetStatus(NamedTuple):
    members: tuple[FleetMember, ...]
    tasks: tuple[FleetTask, ...]  # pending and active ones of all
    last_merge: MergeResult
    exploration_progress: float  # percent
    now_us: int


def fleet_status(view: FleetView, mission: ExplorationMission) -> FleetStatus:
    """As one peer knows it at the time of its view."""
    tasks = {task.assigned_to: task for task in _tasks(view, mission)}
    members = []
    for slot in sorted({view.slot, *view.neighbours}):
        task = tasks.get(slot)
        if slot == view.slot:
            here = view.here
            members.append(
                FleetMember(slot, here.x_m, here.y_m, here.heading_rad, task, view.now_us, True)
            )
            continue
        pose, heard_us = view.neighbours[slot]
        members.append(
            FleetMember(
                slot, pose.x_m, pose.y_m, pose.course_rad, task, heard_us, slot in view.live
            )
        )
    return FleetStatus(
        tuple(members), tuple(tasks[slot] for slot in sorted(tasks)), mission.last_merge,
        mission.progress_percent, view.now_us,
    )  # fmt: skip


def _tasks(view: FleetView, mission: ExplorationMission) -> Sequence[FleetTask]:
    """Claims that are not done, the one in work last, so that it stands for its robot."""
    found = []
    for section in view.allocation.sections():
        claim = view.allocation.entry(section)
        if claim.phase in (Phase.CLAIMED, Phase.STARTED):
            status = Status.ACTIVE if claim.phase is Phase.STARTED else Status.PENDING
            created_us = mission.task.created_us if mission.task and claim.owner == view.slot else 0
            found.append(
                FleetTask(section, mission.kind_of(section), mission.place_of(section), claim.owner,
                          status, created_us)
            )  # fmt: skip
    return sorted(found, key=lambda task: (task.status is Status.ACTIVE, task.section))


def serialize_for_llm(status: FleetStatus, ages: bool = False) -> str:
    """`ages`: how long ago each robot was heard, at the end of its lines."""
    heard_us = {member.slot: member.last_sync_us for member in status.members}

    def age(slot: int) -> str:
        if not ages:
            return ""
        if slot not in heard_us:
            return " (never heard)"
        return f" ({fixed((status.now_us - heard_us[slot]) / S)} s ago)"

    lines = [f"## Fleet Status ({len(status.members)} robots)"]
    for m in status.members:
        task = "idle" if m.assigned_task is None else f"task: {m.assigned_task.description}"
        lines.append(f"- {m.device_id}: pos=({fixed(m.x_m)}, {fixed(m.y_m)}) {task}{age(m.slot)}")
    if status.tasks:
        lines += ["", "### Active Tasks"]
        lines += [
            f"- [{t.id}] {t.description} → robot-{t.assigned_to}{age(t.assigned_to)}"
            for t in status.tasks
        ]
    return "\n".join(lines) + "\n"
