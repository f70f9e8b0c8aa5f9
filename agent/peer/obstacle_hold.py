"""Holds the robot while it asks people about an unannounced obstacle."""

from collections.abc import Mapping, Sequence

from agent.interface.effects import Drive, Effect
from agent.interface.geometry import Point
from agent.interface.motion_controller import ObstacleQuestion
from agent.interface.observation import Neighbour, Observation
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController
from protocol.frames.safety_frames import Command

NOWHERE = frozenset[Point]()
NOTHING_ROUND = (NOWHERE, False)


class ObstacleHold:
    """The stop cause OBSTACLE_AHEAD follows the question: raised while it is open."""

    def __init__(self, question: ObstacleQuestion | None, safety: StopController) -> None:
        """`question`: None if the robot's sensors cannot tell a person from a wall."""
        self.question, self.safety = question, safety

    @property
    def passing(self) -> bool:
        """Whether it goes round an obstacle that an operator has confirmed."""
        return self.question is not None and self.question.passing

    @property
    def round(self) -> tuple[frozenset[Point], bool]:
        """For the mission: the places to go round, and whether to skip the units under them."""
        return NOTHING_ROUND if self.question is None else self.question.round

    @property
    def under_bar(self) -> frozenset[Point]:
        """For the mission: places that have kept the implement up for some time."""
        return NOWHERE if self.question is None else self.question.under_bar

    def watch(
        self,
        wanted: Drive,
        here: Observation,
        neighbours: Mapping[int, Neighbour],
        now_us: int,
        way: Point | None = None,
    ) -> tuple[Drive, Sequence[Effect]]:
        """The drive that may be, before the gate, and what is told to people.

        `way`: the velocity that the mission wants, (x, y) metres a second.
        """
        question = self.question
        if question is None:
            return wanted, ()
        asked, may_move = question.asking, self.safety.may_move
        wanted, effects = question.watch(wanted, here, neighbours, may_move, now_us, way)
        self._follow(asked, now_us)
        return wanted, effects

    def answer(self, command: Command, number: int, now_us: int) -> Sequence[Effect]:
        """An operator's answer to the question."""
        if self.question is None:
            return ()
        asked = self.question.asking
        effects = self.question.answer(command, number, now_us)
        self._follow(asked, now_us)
        return effects

    def go_round(self, why: str, now_us: int) -> Sequence[Effect]:
        """Go round the obstacle in the way, because the operator that gave the order knows of it."""
        if self.question is None:
            return ()
        asked = self.question.asking
        effects = self.question.go_round(why, now_us)
        self._follow(asked, now_us)
        return effects

    def _follow(self, asked: bool, now_us: int) -> None:
        """`asked`: whether a question was open before."""
        question = self.question
        if question is None or question.asking == asked:
            return
        if question.asking:
            self.safety.raise_cause(StopCause.OBSTACLE_AHEAD, now_us, question.why)
        else:
            self.safety.clear_cause(StopCause.OBSTACLE_AHEAD, now_us)
