"""Goals that ROS 2 clients send as actions, as orders of an operator.

A place is `headland order N set-goal`. So it needs the operator's key, and a client is told what robots
say: the fleet itself knows nothing of actions.
"""

import asyncio
from pathlib import Path
from typing import Final

from agent.interface.ports import Bus
from protocol.frames.frame import Frame
from protocol.frames.operator_frames import ReportKind
from tools.common.event_lines import EventLines
from tools.inspect.inspector import SILENT_S, Inspector
from tools.operate.operator_device import OPERATOR_SLOT, KnownRobot, Operator
from tools.operate.order import LISTEN_S, convey
from tools.operate.reset import operator_keyring
from tools.operate.tool_address import DeviceAddress
from tools.ros2.action_tasks import TELL_S, ActionTasks, in_field, tell
from tools.ros2.graph import ActionGoal, Ended, GoalPlace, Graph

GO_TO: Final = "NavigateToPose"
OFFER_S: Final = 1.0  # between two looks for robots that are new
OBEY_S: Final = 10.0  # for a robot to obey; a few tries are lost on a loaded machine
# Stopped or silent for this long: it gives the goal up. A protective stop ends 2 s after its cause.
GIVEN_UP_S: Final = 10.0
OVER: Final = (ReportKind.REFUSED, ReportKind.STOPPED, ReportKind.WORKING)


class GoalDesk:
    """Offers an action for each robot, and conveys what clients ask."""

    def __init__(
        self, bus: Bus, device: DeviceAddress, key: Path | None, inspector: Inspector, graph: Graph,
        lines: EventLines,
    ) -> None:  # fmt: skip
        """`device`: whose address it speaks from. `key`: the operator's; without one every goal is
        rejected."""
        self.bus, self.device, self.key = bus, device, key
        self.inspector, self.graph = inspector, graph
        self._listeners: list[Operator] = []
        self._newest: dict[int, ActionGoal] = {}  # by robot: a later goal replaces an earlier one
        self._loop = asyncio.get_running_loop()
        self._speaking = asyncio.Lock()
        self._tasks = ActionTasks(lines)

    def hear(self, now_s: float, frame: Frame) -> None:
        """Take one frame of the bus."""
        for operator in self._listeners:
            operator.hear(now_s, frame)

    async def run(self) -> None:
        """Offer actions as robots are heard, until it is cancelled."""
        offered: set[int] = set()
        try:
            while True:
                for slot in sorted(self.inspector.robots.keys() - offered):
                    offered.add(slot)
                    self._offer(slot)
                await asyncio.sleep(OFFER_S)
        finally:
            self._tasks.cancel()

    def _offer(self, slot: int) -> None:
        async def go(goal: ActionGoal) -> None:
            await self._go(slot, goal)

        name = f"robot_{slot}/navigate_to_pose"
        self.graph.act(
            name, GO_TO, lambda places: self._may_go(slot, places), self._tasks.taken(go)
        )

    # ---------------------------------------------------------------- a place

    def _may_go(self, slot: int, places: list[GoalPlace]) -> bool:
        """In the thread of the graph: whether a goal makes sense and somebody may order it."""
        return self.key is not None and len(places) == 1 and in_field(places[0])

    async def _go(self, slot: int, goal: ActionGoal) -> None:
        place = goal.places[0]
        self._newest[slot] = goal
        operator = Operator(self.bus, None, self.device)
        self._listeners.append(operator)
        try:
            robot, why = await self._ordered(operator, slot, "set-goal", (place.x_m, place.y_m))
            if robot is None:
                self._tasks.abort(goal, why)
                return
            fine_s = self._loop.time()
            while True:
                if goal.cancelled:
                    why = await self._conveyed(operator, robot, "continue", None)
                    if not why:
                        goal.end(Ended.CANCELLED, "")
                        return
                    self._tasks.lines.say("goal-kept", f"goal not taken back yet: {why}", why=why)
                matter = None if robot.report is None else robot.report.matter
                if matter is ReportKind.ARRIVED:
                    goal.end(Ended.SUCCEEDED, "")
                    return
                held = self._held(slot)
                fine_s = fine_s if held else self._loop.time()
                why = self._ended(slot, goal, matter)
                if not why and self._loop.time() - fine_s > GIVEN_UP_S:
                    why = held
                if why:
                    self._tasks.abort(goal, why)
                    return
                tell(goal, self.inspector, slot, place, 1)
                await asyncio.sleep(TELL_S)
        finally:
            self._listeners.remove(operator)
            if self._newest.get(slot) is goal:
                del self._newest[slot]

    def _ended(self, slot: int, goal: ActionGoal, matter: ReportKind | None) -> str:
        """Why a robot will not arrive; empty while it may."""
        if self._newest.get(slot) is not goal:
            return "a later goal has replaced it"
        if matter in OVER:
            return f"robot {slot} says: {matter.name}" if matter is not None else ""
        seen = self.inspector.robots.get(slot)
        return f"robot {slot} has left" if seen is not None and seen.left else ""

    def _held(self, slot: int) -> str:
        """What keeps a robot from its goal at present; empty: nothing."""
        seen = self.inspector.robots.get(slot)
        if seen is None:  # another maker's device has taken its address
            return f"robot {slot} is not heard"
        if seen.stopped:
            return f"robot {slot} is stopped"
        return f"robot {slot} is silent" if self._loop.time() - seen.last_s > SILENT_S else ""

    async def _ordered(
        self, operator: Operator, slot: int, what: str, place: tuple[float, float] | None
    ) -> tuple[KnownRobot | None, str]:
        """The robot if it obeys, or why it does not."""
        await operator.listen(LISTEN_S)
        robot = next((known for known in operator.live if known.slot == slot), None)
        if robot is None:
            return None, f"robot {slot} is not heard"
        why = await self._conveyed(operator, robot, what, place)
        return None if why else robot, why

    async def _conveyed(
        self, operator: Operator, robot: KnownRobot, what: str, place: tuple[float, float] | None
    ) -> str:
        """Why a robot does not obey; empty: it does.

        One order at a time, and only then with a keyring: robots ask for the newest counter of this
        operator, and an older keyring would answer too."""
        async with self._speaking:
            operator.keyring = operator_keyring(self.key, OBEY_S)
            operator.slot = OPERATOR_SLOT if operator.keyring is None else operator.keyring.sender
            try:
                if await convey(operator, robot, what, place, OBEY_S):
                    return ""
            finally:
                operator.keyring = None
        said = "nothing" if robot.report is None else robot.report.matter.name
        return f"robot {robot.slot} does not obey {what}; it says: {said}"
