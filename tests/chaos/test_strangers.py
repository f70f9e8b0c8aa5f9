"""Machines that should not be on the bus change nothing and leave nothing behind (items 5, 11, 12)."""

from typing import Any

import pytest

from sim.chaos.fault_profiles import draw, with_faults
from sim.chaos.planted_bugs import MUTANTS, planted
from sim.chaos.verdict import judge
from sim.scenarios import scenario as kinds
from sim.scenarios.protocol_setup import drill
from sim.scenarios.scenario import Fault

SEED = 3
FAULTS: dict[str, list[Fault]] = {
    "foreign": [kinds.Foreign(at_s=12.0, kind="foreign", for_s=8.0)],
    "unclaimed": [kinds.Foreign(at_s=12.0, kind="foreign", claims=False, for_s=8.0)],
    "twin": [kinds.Twin(at_s=12.0, kind="twin", robot=1, for_s=8.0)],
    "twin at one address": [
        kinds.Twin(at_s=12.0, kind="twin", robot=1, same_address=True, for_s=8.0)
    ],
    **{
        f"nonsense: {what}": [
            kinds.Nonsense.model_validate(
                {"at_s": 12.0, "kind": "nonsense", "what": what, "robot": 1, "for_s": 4.0}
            )
        ]
        for what in ("field", "work", "claims")
    },
}  # fmt: skip
PLANTED = {
    "item 5": "other-makers-believed",
    "item 11, fields": "another-field-holds",
    "item 11, addresses": "addresses-gone-for-good",
    "item 12": "impossible-work-joined",
}
TRIES = 16  # seeds; a hunt with `--mutants` needs 10 for the rarest of these


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", FAULTS)
def test_item_11_a_stranger_holds_nobody_for_good(name: str) -> None:
    verdict = judge(with_faults(drill(3, SEED, "sprint", "stop"), FAULTS[name]))
    assert verdict.ok, (name, verdict.broken)


@pytest.mark.slow
@pytest.mark.parametrize("item", PLANTED)
def test_item_5_11_12_the_planted_bug_is_found(item: str) -> None:
    name, found = PLANTED[item], list[Any]()
    for seed in range(TRIES):
        scenario = draw(seed, MUTANTS[name].profile)
        with planted(name):
            found = list(judge(scenario, first_only=True).broken)
        if found:
            break
    assert found, f"{name} in seeds 0 to {TRIES - 1}"
    rules = {broken.rule for broken in judge(scenario).broken}
    assert found[0].rule not in rules, f"seed {seed} breaks {rules} without the bug"
