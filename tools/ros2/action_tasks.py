"""Goals of actions that are served: each is a task of our loop, begun in the thread of the graph."""

import asyncio
from collections.abc import Awaitable, Callable
from math import hypot, isfinite
from typing import Final

from protocol.frames.operator_frames import goal_frames
from tools.common.bus_address import AttachError
from tools.common.event_lines import EventLines
from tools.inspect.inspector import Inspector
from tools.ros2.graph import ActionGoal, Ended, GoalPlace

FIELD: Final = "map"  # the frame of the fleet's coordinates
TELL_S: Final = 0.2  # between two words to a client


class ActionTasks:
    """Begins a task for each goal that was accepted, and ends them together."""

    def __init__(self, lines: EventLines) -> None:
        self.lines = lines
        self._loop = asyncio.get_running_loop()
        self._working: set[asyncio.Task[None]] = set()

    def taken(
        self, serve: Callable[[ActionGoal], Awaitable[None]]
    ) -> Callable[[ActionGoal], None]:  # fmt: skip
        """What the graph calls, in its thread, with a goal that was accepted."""

        def begin(goal: ActionGoal) -> None:
            task = self._loop.create_task(self._whole(serve, goal))
            self._working.add(task)
            task.add_done_callback(self._working.discard)

        def take(goal: ActionGoal) -> None:
            self._loop.call_soon_threadsafe(begin, goal)

        return take

    async def _whole(
        self, serve: Callable[[ActionGoal], Awaitable[None]], goal: ActionGoal
    ) -> None:  # fmt: skip
        try:
            await serve(goal)
        except AttachError as problem:  # the key has ended, or its file is gone
            self.abort(goal, str(problem))
        except Exception as problem:  # a client would wait for ever for the end of its goal
            self.abort(goal, f"it failed: {problem!r}")

    def cancel(self) -> None:
        """End all of them; clients are told nothing more."""
        for task in self._working:
            task.cancel()

    def abort(self, goal: ActionGoal, why: str) -> None:
        """Results of Nav2 in Jazzy have no room for a reason, so people read it here."""
        self.lines.say("goal-aborted", f"goal aborted: {why}", why=why)
        goal.end(Ended.ABORTED, why)


def tell(
    goal: ActionGoal, inspector: Inspector, slot: int, to: GoalPlace, places_left: int
) -> None:
    """Feedback of the robot that has the goal: where it is, and the straight way to `to`.

    `places_left`: number of poses still to be reached, `to` included. A robot that nobody hears has no
    place to tell of."""
    seen = inspector.robots.get(slot)
    if seen is None:
        return
    left_m = hypot(to.x_m - seen.x_m, to.y_m - seen.y_m)
    goal.tell(GoalPlace(FIELD, seen.x_m, seen.y_m), left_m, places_left)


def in_field(place: GoalPlace) -> bool:
    """Whether a place can be ordered: in the frame of the fleet, and within what a frame can say."""
    if place.frame not in ("", FIELD) or not (isfinite(place.x_m) and isfinite(place.y_m)):
        return False
    try:
        goal_frames(0, 0, place.x_m, place.y_m)
    except (ValueError, OverflowError):
        return False
    return True
