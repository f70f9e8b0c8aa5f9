"""What any peer can report about the whole exploring fleet, also as Markdown for a language model.

There is no coordinator to ask. Poses are those received last; tasks are the claims in the
allocation. The text can give the age of each line. Without ages it has exactly the shape that the
mission's specification requires.
"""

from collections.abc import Sequence
from typing import NamedTuple

from agent.exploration.exploration_mission import ExplorationMission
from agent.exploration.exploration_task import FleetTask, Status, fixed
from agent.interface.config import S
from agent.interface.mission import FleetView
from crdt import Phase
from crdt.occupancy import MergeResult


class FleetMember(NamedTuple):
    """One robot as a peer knows it: pose in metres and radians, task, and whether it is live."""

    slot: int
    x_m: float
    y_m: float
    rotation_rad: float  # our heading; of others the course that they drive
    assigned_task: FleetTask | None
    last_sync_at_us: int  # when it was last received; for ourselves now
    active: bool

    @property
    def device_id(self) -> str:
        """The robot's name in reports."""
        return f"robot-{self.slot}"


class FleetStatus(NamedTuple):
    """The fleet as one peer knows it at one time."""

    members: tuple[FleetMember, ...]
    tasks: tuple[FleetTask, ...]  # pending and active ones of all robots
    last_merge: MergeResult
    exploration_progress: float  # percent
    now_us: int


def fleet_status(view: FleetView, mission: ExplorationMission) -> FleetStatus:
    """The fleet as one peer knows it at the time of its view."""
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
        pose, heard_at_us = view.neighbours[slot]
        members.append(
            FleetMember(
                slot, pose.x_m, pose.y_m, pose.course_rad, task, heard_at_us, slot in view.live
            )
        )
    return FleetStatus(
        tuple(members), tuple(tasks[slot] for slot in sorted(tasks)), mission.last_merge,
        mission.progress_percent, view.now_us,
    )  # fmt: skip


def _tasks(view: FleetView, mission: ExplorationMission) -> Sequence[FleetTask]:
    """Claims that are not done. The one in work comes last, so that it stands for its robot."""
    found = []
    for section in view.allocation.sections():
        claim = view.allocation.entry(section)
        if claim.phase in (Phase.CLAIMED, Phase.STARTED):
            status = Status.ACTIVE if claim.phase is Phase.STARTED else Status.PENDING
            created_at_us = (
                mission.task.created_at_us if mission.task and claim.owner == view.slot else 0
            )
            found.append(
                FleetTask(section, mission.kind_of(section), mission.place_of(section), claim.owner,
                          status, created_at_us)
            )  # fmt: skip
    return sorted(found, key=lambda task: (task.status is Status.ACTIVE, task.section))


def serialize_for_llm(status: FleetStatus, ages: bool = False) -> str:
    """The status as Markdown. `ages`: add to each line how long ago its robot was received."""
    heard_at_us = {member.slot: member.last_sync_at_us for member in status.members}

    def age(slot: int) -> str:
        if not ages:
            return ""
        if slot not in heard_at_us:
            return " (never heard)"
        return f" ({fixed((status.now_us - heard_at_us[slot]) / S)} s ago)"

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
