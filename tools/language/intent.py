"""What a person can want of the fleet: the only things that words are ever turned into.

The grammar or a language model turns words into these intents and nothing else. The types refuse
unknown keys, other values and further text.
"""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from agent.interface.config import PEERS_MAX

INTENTS_MAX = 8  # of one phrase; more could not be watched by the person that gives them
FAR_M = 3276.7  # largest coordinate that frames can carry

Slot = Annotated[int, Field(ge=0, lt=PEERS_MAX)]
Metres = Annotated[float, Field(ge=-FAR_M, le=FAR_M, allow_inf_nan=False)]
Everybody = Literal["all"]
Action = Literal["stop", "emergency_stop", "go_home", "wait", "continue", "replan", "start"]
# Which robot: by number, the nearest idle one, or none named (then it is asked for).
Mover = Slot | Literal["nearest", "unnamed", "all", "several"]


class _Intent(BaseModel):
    # Built at its first use: a phrase uses one or two of them.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, defer_build=True)


class At(_Intent):
    """A place by its coordinates, metres east and north."""

    x_m: Metres
    y_m: Metres


class Beside(_Intent):
    """Where a robot stands."""

    robot: Slot


Target = At | Beside | Annotated[str, Field(min_length=1, max_length=64)]  # a string: a named place


class Goal(_Intent):
    """A robot shall go to a place and stay."""

    kind: Literal["goal"] = "goal"
    robot: Mover
    place: Target


class Control(_Intent):
    """What robots shall do where they are."""

    kind: Literal["control"] = "control"
    action: Action
    robots: tuple[Slot, ...] | Literal["all", "unnamed"]


class Query(_Intent):
    """A question; nothing moves."""

    kind: Literal["query"] = "query"
    ask: Literal[
        "status", "position", "nearest", "stopped", "idle", "section", "queue", "places", "battery",
        "progress", "finished", "distance",
    ]  # fmt: skip
    robots: tuple[Slot, ...] | Everybody = "all"
    place: Target | None = None
    section: Annotated[int, Field(ge=0, le=0xFFFF)] | None = None


class Backlog(_Intent):
    """About the goals that wait for an idle robot."""

    kind: Literal["backlog"] = "backlog"
    action: Literal["clear"]


Intent = Annotated[Goal | Control | Query | Backlog, Field(discriminator="kind")]
Intents = Annotated[tuple[Intent, ...], Field(min_length=1, max_length=INTENTS_MAX)]
INTENTS: TypeAdapter[tuple[Goal | Control | Query | Backlog, ...]] = TypeAdapter(
    Intents, config=ConfigDict(defer_build=True)
)
AnyIntent = Goal | Control | Query | Backlog


def plain(intent: AnyIntent) -> dict[str, object]:
    """As JSON, without what was not said.

    >>> plain(Goal(robot=2, place="shelf"))
    {'kind': 'goal', 'robot': 2, 'place': 'shelf'}
    """
    return intent.model_dump(mode="json", exclude_none=True)
