"""Bad luck from seeds, every profile a little, and every story of a bug that bad luck once found.

`headland chaos` runs thousands; here it is only seen to work. A failure is reproduced with
`headland chaos --seeds SEED --profile PROFILE`, a story with `headland chaos --scenario FILE`.
"""

from collections import Counter
from pathlib import Path
from typing import get_args

import pytest
from pydantic import BaseModel

from sim.chaos.fault_generators import DRAWS
from sim.chaos.fault_profiles import (
    PROFILES,
    SENSOR_FAULTS,
    SHAPES,
    draw,
    is_beyond_notice,
    span_of,
    with_faults,
)
from sim.chaos.golden_story import difference, golden_path, tell
from sim.chaos.planted_bugs import MUTANTS, planted
from sim.chaos.shrink import shrink
from sim.chaos.verdict import RULES, judge
from sim.scenarios.scenario import Box, Crash, Fault, Jumped, Restart, Scenario, StuckRays, load
from sim.scenarios.toml_writer import to_toml

ROOT = Path(__file__).parents[2]
LINES_MAX = 400  # of a golden text; most have less than a hundred
STORIES = sorted((Path(__file__).parent / "stories").glob("*.toml"))


@pytest.mark.parametrize(
    ("profile", "seed"), [("protocol", 1), ("protocol", 9), ("all", 5), ("stop", 3), ("body", 2)]
)
def test_every_rule_is_kept(profile: str, seed: int) -> None:
    verdict = judge(draw(seed, profile))
    assert verdict.ok, f"profile {profile}, seed {seed}: {verdict.broken}"
    assert verdict.simulated_s > span_of(draw(seed, profile)).calm_at_s


@pytest.mark.sampled(1)
@pytest.mark.parametrize("path", STORIES, ids=lambda path: path.stem)
def test_a_bug_that_was_found_stays_away(path: Path) -> None:
    verdict, played = tell(load(str(path)))
    assert verdict.ok, verdict.broken
    kept = golden_path(path).read_text()
    if played != kept:
        again = f"headland chaos --scenario {path.relative_to(ROOT)}"
        pytest.fail(
            f"{path.stem} is played differently:\n{difference(kept, played, path.stem)}\n"
            f"To play it again: {again}\nIf the difference is meant: {again} --golden",
            pytrace=False,
        )


def test_golden_texts_are_small_enough_to_read() -> None:
    texts = {path.stem: golden_path(path).read_text() for path in STORIES}
    assert max(len(text.splitlines()) for text in texts.values()) <= LINES_MAX, "leave events out"
    assert sum(map(len, texts.values())) <= 500_000


@pytest.mark.slow
def test_a_golden_text_shows_what_changed() -> None:
    """A fault that comes 100 ms later: the diff has its line, and what robots did about it."""
    scenario = load(str(STORIES[0]))
    _, text = tell(scenario)
    fault = scenario.fault[0]
    later = fault.model_copy(update={"at_s": fault.at_s + 0.1})
    changed = difference(
        text, tell(with_faults(scenario, [later, *scenario.fault[1:]]))[1], "story"
    )
    lines = changed.splitlines()
    assert f"-{round(fault.at_s * 1000):>7}         fault {fault.kind}" in changed
    assert any((line.startswith("-") and "state" in line) or "safety" in line for line in lines)
    assert difference(text, text, "story") == ""


@pytest.mark.parametrize(
    "name",
    ["stop-without-brake", "latch-forgotten", "lost-claims-kept",
     "permit-of-any", "used-stop-ignored", "standard-stop-once"],
)  # fmt: skip
def test_a_planted_bug_is_found(name: str) -> None:
    """A few of them; all with `headland chaos --mutants`."""
    with planted(name):
        profile = MUTANTS[name].profile
        found = any(judge(draw(s, profile), first_only=True).broken for s in range(6))
    assert found, name


def test_a_failure_is_made_small() -> None:
    """Of many faults, those without which the rule is kept; what judges it here is cheap."""
    plain = draw(12, "protocol")
    crash = Crash(at_s=30.0, kind="crash", robot=0)
    scenario = with_faults(plain, [*plain.fault, crash])

    def fails(candidate: Scenario) -> bool:
        return crash in candidate.fault

    small, runs = shrink(scenario, fails)
    drawn = [fault for fault in small.fault if fault.at_s <= span_of(small).calm_at_s]
    assert drawn == [crash] and runs <= 80
    assert small.fleet.robots <= scenario.fleet.robots


def test_a_failure_that_is_made_small_has_no_robot_that_stays_dead() -> None:
    """A tractor that came too late was made small to a fleet that waited for a dead robot."""
    plain = draw(12, "protocol")
    crash = Crash(at_s=30.0, kind="crash", robot=0)
    restart = Restart(at_s=35.0, kind="restart", robot=0)
    scenario = with_faults(plain, [*plain.fault, crash, restart])
    small, _ = shrink(scenario, lambda candidate: crash in candidate.fault)
    assert restart in small.fault


@pytest.mark.parametrize("profile", PROFILES)
def test_what_is_drawn_can_be_written_by_hand(profile: str, tmp_path: Path) -> None:
    """Printed as TOML and read again, a scenario is the same; and every kind of it is drawn."""
    seen: Counter[str] = Counter()
    for seed in range(40):
        scenario = draw(seed, profile)
        path = tmp_path / "drawn.toml"
        path.write_text(to_toml(scenario))
        again = load(str(path))
        assert again.fault == scenario.fault and again.fleet == scenario.fleet
        assert draw(seed, profile) == scenario, "the same seed, the same luck"
        seen.update(fault.kind for fault in scenario.fault)
    assert all(_kinds_of(name) & set(seen) for name in PROFILES[profile].weights)


@pytest.mark.parametrize("profile", [n for n, p in PROFILES.items() if p.mission == "field"])
def test_faults_of_senses_are_drawn_in_every_profile_with_bodies(profile: str) -> None:
    """Stuck scans are not drawn where something comes into the way in nearly every run."""
    seen: Counter[str] = Counter()
    for seed in range(150):
        drawn = [f for f in draw(seed, profile).fault if f.kind in SENSOR_FAULTS]
        seen.update(f.kind for f in drawn)
    assert set(SENSOR_FAULTS) - set(seen) <= ({"stuck_rays"} if profile == "traffic" else set())


@pytest.mark.parametrize("profile", [n for n, p in PROFILES.items() if p.mission == "field"])
def test_every_field_of_a_profile_is_drawn(profile: str) -> None:
    fields = {draw(seed, profile).name for seed in range(40)}
    assert fields == set(PROFILES[profile].scenarios)


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
def test_a_fleet_without_faults_works_all_of_each_shape_in_half_the_time(shape: str) -> None:
    verdict = judge(with_faults(load(shape).changed(2, 1), []))
    assert verdict.ok, verdict.broken
    assert verdict.simulated_s < span_of(load(shape)).limit_at_s / 2


def test_a_fault_that_no_robot_could_notice_is_not_drawn() -> None:
    def jumped(robot: int) -> Jumped:
        return Jumped(at_s=20.0, kind="jumped", robot=robot, dx_m=3.0, dy_m=0.0, for_s=2.0)

    starts = [Restart(at_s=21.0, kind="restart", robot=1)]
    assert is_beyond_notice(jumped(1), [*starts]) and not is_beyond_notice(jumped(0), [*starts])
    late = [Restart(at_s=22.5, kind="restart", robot=1)]
    assert not is_beyond_notice(jumped(1), [*late]), "the place is right again when it starts"
    stuck = StuckRays(at_s=20.0, kind="stuck_rays", robot=0, for_s=2.0)
    box = Box(at_s=5.0, kind="box", x_m=0.0, y_m=0.0, for_s=9.0)
    assert is_beyond_notice(stuck, [box]) and not is_beyond_notice(stuck, [*starts])


def _kinds_of(name: str) -> set[str]:
    """The kinds of fault that a draw of this name makes."""
    together = {"blackout": {"crash", "restart"}, "burst": {"omission", "estop"},
                "split": {"partition", "heal"}, "stalled": {"freeze"}, "thief": {"forger"}}  # fmt: skip
    return {"haste": {"order"}, **together}.get(name, {name})


def test_every_kind_of_fault_is_drawn_and_played() -> None:
    kinds = {get_args(kind.model_fields["kind"].annotation)[0] for kind in _faults()}
    drawn = {kind for name in DRAWS for kind in _kinds_of(name)}
    assert kinds - drawn == {"heal", "restart"}  # these come with a cut and a crash
    played = {fault.kind for path in STORIES for fault in load(str(path)).fault}
    assert kinds <= played


def _faults() -> tuple[type[BaseModel], ...]:
    union, _ = get_args(Fault)
    return get_args(union)


def test_every_rule_has_a_place_in_the_documents() -> None:
    text = (Path(__file__).parents[2] / "docs" / "how" / "chaos.md").read_text()
    assert all(f"| {rule} |" in text for rule in RULES)
