"""What any peer can say of the whole exploring fleet, also as markdown for a language model.

There is no coordinator to ask: poses are those last heard, tasks are the claims in the allocation. How
old each line is can be told with it; without ages the text has exactly the mission's shape.
"""

from collections.abc import Sequence
from typing import NamedTuple

from agent.exploration.exploration_mission import ExplorationMission
from agent.exploration.exploration_task import FleetTask, Status, fixed
from agent.interface.config import S
from agent.peer.peer import Peer
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


def fleet_status(peer: Peer, mission: ExplorationMission, now_us: int) -> FleetStatus:
    """As this peer knows it."""
    tasks = {task.assigned_to: task for task in _tasks(peer, mission)}
    members = []
    for slot in sorted({peer.slot, *peer.membership.neighbours}):
        task = tasks.get(slot)
        if slot == peer.slot:
            if peer.here is not None:
                here = peer.here
                members.append(
                    FleetMember(slot, here.x_m, here.y_m, here.heading_rad, task, now_us, True)
                )
            continue
        pose, heard_us = peer.membership.neighbours[slot]
        active = slot in peer.membership.live
        members.append(
            FleetMember(slot, pose.x_m, pose.y_m, pose.course_rad, task, heard_us, active)
        )
    return FleetStatus(
        tuple(members), tuple(tasks[slot] for slot in sorted(tasks)), mission.last_merge,
        mission.progress_percent, now_us,
    )  # fmt: skip


def _tasks(peer: Peer, mission: ExplorationMission) -> Sequence[FleetTask]:
    """Claims that are not done, the one in work last, so that it stands for its robot."""
    found = []
    for section in peer.allocation.sections():
        claim = peer.allocation.entry(section)
        if claim.phase in (Phase.CLAIMED, Phase.STARTED):
            status = Status.ACTIVE if claim.phase is Phase.STARTED else Status.PENDING
            created_us = mission.task.created_us if mission.task and claim.owner == peer.slot else 0
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
