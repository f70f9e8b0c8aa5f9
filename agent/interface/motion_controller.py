"""What turns a mission's motion request into a drive, and what may stand before an obstacle and ask."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

from agent.interface.effects import Drive, Effect
from agent.interface.lifecycle import State
from agent.interface.mission import MotionRequest
from agent.interface.ports import Neighbour, Observation
from protocol.frames.safety_frames import Command

Point = tuple[float, float]  # metres east and north in the field


class BodyLimits(NamedTuple):
    """What the body is and can do."""

    radius_m: float
    speed_m_s: float
    acceleration_m_s2: float


class ObstacleQuestion(Protocol):
    """One robot's stop before what nobody has announced: a question to people, and their answer."""

    @property
    def asking(self) -> bool:
        """The robot has to stand: a question is open."""
        ...

    @property
    def why(self) -> str:
        """What the open question is about."""
        ...

    @property
    def passing(self) -> bool:
        """It goes round something that an operator knows of."""
        ...

    @property
    def round(self) -> tuple[frozenset[Point], bool]:
        """For the mission: what to go round, and whether to leave out what is under it."""
        ...

    def watch(
        self, wanted: Drive, here: Observation, neighbours: Mapping[int, Neighbour],
        may_move: bool, now_us: int,
    ) -> tuple[Drive, list[Effect]]: ...  # fmt: skip

    def answer(self, command: Command, number: int, now_us: int) -> Sequence[Effect]: ...

    def go_round(self, why: str, now_us: int) -> list[Effect]: ...


class MotionController:
    """From a motion request to a drive that harms nobody; the safety gate comes after it."""

    def drive(
        self,
        here: Observation,
        wish: MotionRequest,
        neighbours: Mapping[int, Neighbour],
        now_us: int,
    ) -> Drive:
        """Asked once a control period."""
        raise NotImplementedError

    @property
    def body_limits(self) -> BodyLimits | None:
        """None where the body's own are not known."""
        return None

    def set_state(self, state: State) -> None:
        """Our own state, as the beat says it to others: who gives way depends on it."""

    def obstacle_question(self) -> ObstacleQuestion | None:
        """A new one, for one robot; None where it cannot tell a person from a wall."""
        return None
