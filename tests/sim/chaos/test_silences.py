"""S6: which robots have to stand because a member is silent, beside boots and a full bus."""

from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import pytest

from agent.peer.membership import Membership
from agent.safety.stop_controller import StopController
from sim.chaos.scenario_judge import ScenarioJudge
from sim.scenarios import scenario as kinds
from sim.scenarios.protocol_setup import drill
from sim.scenarios.scenario import Fault

DEAD, TWICE, STANDS = range(3)  # dead from 10 s on, restarted meanwhile, and never off


def _forgives(right: Callable[..., Any]) -> Callable[..., Any]:
    """A robot that hears a new member forgets which were silent."""

    def members(self: StopController, live: frozenset[int], silent: frozenset[int], t: int) -> Any:
        return right(self, live, frozenset() if live - self._live else silent, t)

    return members


def _remembers_nobody(right: Callable[..., Any]) -> Callable[..., Any]:
    """A restart forgets which were silent."""

    def init(self: Membership, *args: Any) -> None:
        *first, _, now_us = args
        right(self, *first, {}, now_us)

    return init


PLANTED: dict[str, tuple[type, str, Callable[[Callable[..., Any]], Callable[..., Any]]]] = {
    "": (StopController, "members", lambda right: right),
    "forgiven": (StopController, "members", _forgives),
    "forgotten": (Membership, "__init__", _remembers_nobody),
}


def _judge(faults: list[Fault], end_at_s: float) -> ScenarioJudge:
    scenario = drill(3, 1, "sprint", "stop", None)
    run = scenario.run.model_copy(update={"time_limit_s": end_at_s})
    return ScenarioJudge(scenario.model_copy(update={"fault": faults, "run": run}))


@pytest.mark.parametrize(
    ("planted", "found"), [("", None), ("forgiven", STANDS), ("forgotten", TWICE)]
)
def test_a_boot_releases_nobody_else_from_a_silence(planted: str, found: int | None) -> None:
    """Every boot released all robots, whichever booted and whatever it remembered."""
    where, name, change = PLANTED[planted]
    faults: list[Fault] = [
        kinds.Crash(at_s=10.0, kind="crash", robot=DEAD),
        kinds.Crash(at_s=14.0, kind="crash", robot=TWICE),
        kinds.Restart(at_s=15.0, kind="restart", robot=TWICE),
    ]
    judge = _judge(faults, 22.0)
    with patch.object(where, name, change(getattr(where, name))):
        told = [each.what for each in judge.run().broken if each.rule == "S6"]
    assert [f"robots ({found},)" in each for each in told] == ([] if found is None else [True]), (
        told
    )


def test_who_boots_while_a_device_babbles_has_not_met_who_dies_meanwhile() -> None:
    """`claims` seed 242: no frame of the dead robot had got through to it, and S6 took it for one that
    had met it."""
    faults: list[Fault] = [
        kinds.Crash(at_s=7.4, kind="crash", robot=TWICE),
        kinds.Babble(at_s=14.2, kind="babble", priority=5, identifier=0, for_s=6.0),
        kinds.Restart(at_s=14.6, kind="restart", robot=TWICE),
        kinds.Crash(at_s=18.8, kind="crash", robot=DEAD),
    ]
    judge = _judge(faults, 23.0)
    assert [each for each in judge.run().broken if each.rule == "S6"] == []


def test_who_met_before_a_device_babbles_has_met() -> None:
    babble = kinds.Babble(at_s=10.0, kind="babble", priority=5, identifier=0, for_s=6.0)
    judge = _judge([babble], 12.0)
    judge.run()
    judge.cluster.look()
    assert all(judge.cluster.acquaintance.met(slot, 2 - slot) for slot in (0, 2))


TROUBLE: dict[str, Fault] = {
    "loss": kinds.Loss(at_s=12.0, kind="loss", rate=0.01),
    "heal": kinds.Heal(at_s=12.0, kind="heal"),
    "freeze": kinds.Freeze(at_s=12.0, kind="freeze", robot=TWICE, for_s=0.05),
    "partition": kinds.Partition(at_s=12.0, kind="partition", islands=[[DEAD, TWICE], [STANDS]]),
}


@pytest.mark.parametrize("trouble", TROUBLE)
@pytest.mark.parametrize("holds", [True, False], ids=["stands", "goes on"])
def test_trouble_of_links_releases_nobody_from_a_silence_that_is_known(
    trouble: str, holds: bool
) -> None:
    """Every fault of links released all robots, although nothing of the dead one could be heard."""
    died: list[Fault] = [kinds.Crash(at_s=10.0, kind="crash", robot=DEAD), TROUBLE[trouble]]
    judge = _judge(died, 18.0)
    ends_by_itself = property(lambda controller: bool(controller._silent))
    with patch.object(
        StopController, "_settles", StopController._settles if holds else ends_by_itself
    ):
        told = [each.what for each in judge.run().broken if each.rule == "S6"]
    assert bool(told) is not holds, told


def test_a_frame_in_the_name_of_the_dead_releases_those_that_hear_it() -> None:
    died: list[Fault] = [
        kinds.Crash(at_s=10.0, kind="crash", robot=DEAD),
        kinds.Twin(at_s=12.0, kind="twin", robot=DEAD, for_s=2.0),
    ]
    judge = _judge(died, 18.0)
    judge.run()
    assert DEAD not in judge._silences
