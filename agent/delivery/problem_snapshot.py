"""The problem of a round of planning as one robot sees it when the round begins."""

from math import sqrt
from typing import TYPE_CHECKING

from agent.delivery.cost_matrix import FULL
from agent.delivery.plan_negotiation import ProblemSnapshot
from agent.delivery.warehouse import CarrierState
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView
from crdt import Phase

if TYPE_CHECKING:
    from agent.delivery.task_allocation import TaskAllocation

# Tasks of one round: the auction's work grows as tasks to the fourth by robots to the second. So many of
# six robots, with batteries, take 25 ms of a small computer, half of a control period.
ROUND_TASKS, ROUND_ROBOTS = 72, 6
ABLE = (State.IDLE, State.WORKING, State.SYNCHRONIZING)


def standings(dispatch: "TaskAllocation", view: FleetView, able: bool) -> list[CarrierState]:
    """When and where each of the living will be free, by slots. `able`: we can work."""
    robots = [dispatch.standing(view)] if able else []
    for slot in sorted(view.live - {dispatch.slot}):
        neighbour = view.neighbours.get(slot)
        if neighbour is not None and neighbour.pose.state in ABLE:
            left = dispatch.told[slot].left if slot in dispatch.told else FULL
            at = neighbour.pose.x_m, neighbour.pose.y_m
            robots.append(dispatch.through(CarrierState(slot, at, 0, left), view))
    return sorted(robots)


def anew(dispatch: "TaskAllocation", view: FleetView, able: bool) -> ProblemSnapshot:
    """Every free task, whoever means to begin it."""
    robots = standings(dispatch, view, able)
    fresh, _ = dispatch.open(view)
    planned = {t for s, told in dispatch.told.items() if s in view.live for t in told.whole}
    wanted = sorted({*fresh, *dispatch.itinerary, *planned})
    tasks = [task for task in wanted if _plannable(dispatch, view, task)]
    del tasks[round_tasks_max(len(robots)) :]  # the lowest numbers, alike at all; others wait
    return _frozen(dispatch, robots, tasks)


def round_tasks_max(robots: int) -> int:
    """How many tasks one round plans for so many robots; what is beyond them waits for a later round.

    >>> round_tasks_max(1), round_tasks_max(6), round_tasks_max(60)
    (29, 72, 227)
    """
    return int(ROUND_TASKS * sqrt(robots / ROUND_ROBOTS))


def hastened(dispatch: "TaskAllocation", view: FleetView, able: bool) -> ProblemSnapshot:
    """What is in somebody's itinerary, and not held there by its age: to begin from as it is."""
    robots, rows = [], []
    met = set[int]()
    for robot in standings(dispatch, view, able):
        own = dispatch.means(robot.slot)
        held = dispatch.haste.held(own, view.now_us)
        robots.append(dispatch.after_all(robot, own[:held]))
        row = [t for t in own[held:] if t not in met and _plannable(dispatch, view, t)]
        met.update(own)
        rows.append(row)
    tasks = sorted(task for row in rows for task in row)
    index = {task: k for k, task in enumerate(tasks)}
    plan = [[index[task] for task in row] for row in rows]
    return _frozen(dispatch, robots, tasks)._replace(plan=plan)


def _plannable(dispatch: "TaskAllocation", view: FleetView, task: int) -> bool:
    order = dispatch.book.tasks.get(task)
    return (
        order is not None
        and view.allocation.phase_of(task) is Phase.FREE
        and not view.progress.bits(task, 0)
        and dispatch.house.known(order)
        and task not in dispatch.cut
    )


def _frozen(dispatch: "TaskAllocation", robots: list[CarrierState], tasks: list[int]) -> ProblemSnapshot:
    trips = [dispatch.house.trip(dispatch.book.tasks[task]) for task in tasks]
    work = dispatch.house.work(trips, robots)
    return ProblemSnapshot(tuple(robot.slot for robot in robots), tuple(tasks), work)
