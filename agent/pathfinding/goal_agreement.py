"""How a fleet agrees on one plan to the goals of all: the rounds of coverage, with goals.

A robot knows the map and its own goal, nothing more. With its place it sends its goal. The rest is
as in `agent/coverage/plan_agreement.py`: all stand, all compute the same plan, all compare digests,
and then each drives in the order of the plan. A robot that falls silent is taken to stand where its
last command expired, and the others plan round it.
"""

from collections.abc import Iterable

from agent.coverage.cell_map import NONE, CellMap
from agent.coverage.plan_agreement import CellPlace, CoverageAgreement, FleetSnapshot
from agent.pathfinding.goal_course import GoalInputs, course_to_goals, neighbours
from crdt.progress import Progress
from protocol.frames.agreement_frames import AgreementReply


class GoalAgreement(CoverageAgreement):
    """One robot's part in the rounds, for a fleet in which each robot has a goal cell."""

    def __init__(self, slot: int, ground: CellMap, goal: int) -> None:
        super().__init__(slot, ground)
        assert 0 <= goal < len(ground)
        self.goal = goal

    def _detail(self, crew: FleetSnapshot) -> int:
        """The goal, in the 24 bits that coverage uses for a digest."""
        return self.goal

    def _is_equal(self, places: Iterable[CellPlace]) -> bool:
        """Goals are cells of the map."""
        return all(place.digest < len(self.ground) for place in places)

    def _compute(self, crew: FleetSnapshot, now_us: int) -> None:
        movers, blocked = self._movers(crew, now_us)
        slots = tuple(sorted(movers))
        inputs = GoalInputs(
            slots, tuple(movers[s] for s in slots), tuple(self._used[s].digest for s in slots),
            tuple(sorted(blocked)), self.round, self._beside_stranded(),
        )  # fmt: skip
        course = course_to_goals(self.ground, inputs)
        self._left_out = bool(course.left_out) or not course.solved
        self._adopt(course, inputs.digest(self.ground))

    def _beside_stranded(self) -> tuple[int, ...]:
        """The cells beside robots that stand between two cells: each must get one of them back."""
        stranded = [p.number for p in self._used.values() if p.answer is AgreementReply.BUSY]
        if not stranded:
            return ()
        near = neighbours(self.ground)[stranded]
        return tuple(sorted(set(near[near != NONE].tolist())))

    def _remember(self) -> None:
        """A goal stays with its robot, so nothing is handed on."""

    def owing(self, progress: Progress, slots: Iterable[int]) -> list[int]:
        """Which of these slots have a part in the last plan."""
        return [] if self.course is None else sorted(set(slots) & set(self.course.slots))

    def wrecks(self, crew: FleetSnapshot) -> list[int]:
        """All silent robots of the plan: no other robot can do their work, so none is waited for."""
        return self.owing(crew.progress, crew.fell_silent_at_us)
