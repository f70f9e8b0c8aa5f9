"""Interfaces that turn a motion request into a drive, and that stop at an obstacle and ask people."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

from agent.interface.effects import Drive, Effect
from agent.interface.geometry import Point
from agent.interface.lifecycle import State
from agent.interface.mission import MotionRequest
from agent.interface.observation import Neighbour, Observation
from protocol.frames.safety_frames import Command


class BodyLimits(NamedTuple):
    """Size and dynamic limits of the body."""

    radius_m: float
    speed_m_s: float
    acceleration_m_s2: float


class ObstacleQuestion(Protocol):
    """One robot's stop before an unannounced obstacle: its question to people, and the answer."""

    @property
    def asking(self) -> bool:
        """Whether a question is open, so that the robot has to stand still."""
        ...

    @property
    def why(self) -> str:
        """The reason of the open question."""
        ...

    @property
    def passing(self) -> bool:
        """Whether the robot goes round an obstacle that an operator has confirmed."""
        ...

    @property
    def round(self) -> tuple[frozenset[Point], bool]:
        """For the mission: the places to go round, (x, y) metres, and whether to skip the units
        under them.
        """
        ...

    @property
    def under_bar(self) -> frozenset[Point]:
        """For the mission: places that have kept the implement up for some time, (x, y) metres."""
        ...

    def watch(
        self,
        wanted: Drive,
        here: Observation,
        neighbours: Mapping[int, Neighbour],
        may_move: bool,
        now_us: int,
        way: Point | None = None,
    ) -> tuple[Drive, list[Effect]]:
        """Each control period: the drive that avoids the obstacle, and the effects.

        `wanted`: the drive of the motion controller. `neighbours`: newest poses by slot.
        `may_move`: no stop cause holds the robot. The safety gate comes after the result. `way`: the
        velocity of the mission, before it gives way to robots, (x, y) metres a second; None: `wanted`
        is that.
        """
        ...

    def answer(self, command: Command, number: int, now_us: int) -> Sequence[Effect]:
        """An operator's WAIT, CONTINUE or REPLAN to question `number`; 0 means the open one.

        An answer to a question that is not open is refused with a report.
        """
        ...

    def go_round(self, why: str, now_us: int) -> list[Effect]:
        """Treat the obstacle as confirmed, as if an operator had answered; `why` is for the trace."""
        ...


class MotionController:
    """Turns a motion request into a collision-free drive; the safety gate comes after it."""

    def drive(
        self,
        here: Observation,
        wish: MotionRequest,
        neighbours: Mapping[int, Neighbour],
        now_us: int,
    ) -> Drive:
        """Once each control period: the drive for the mission's request.

        `here`: the newest observation. `wish`: what the mission wants. `neighbours`: newest poses
        by slot. `now_us`: the peer's clock.
        """
        raise NotImplementedError

    @property
    def body_limits(self) -> BodyLimits | None:
        """The limits of the body; None if they are not known."""
        return None

    def set_state(self, state: State) -> None:
        """Set our own state, as our beats report it; right of way depends on it."""

    def obstacle_question(self) -> ObstacleQuestion | None:
        """A new question for one robot; None if its sensors cannot tell a person from a wall."""
        return None
