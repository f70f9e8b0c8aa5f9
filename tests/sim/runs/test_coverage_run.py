"""Whole peers cover grids over the wire, through deaths, joins, splits and noise; judged from outside."""

import json
from pathlib import Path
from random import Random

import numpy as np
import pytest
from typer.testing import CliRunner

from agent.interface.config import S
from sim.files.grid_map import Instance, gate_starts, rack_walls, random_starts, random_walls
from sim.runs.coverage_run import CoverageOutcome, CoverageRun
from sim.runs.grid_fleet import CoverageFleet
from sim.runs.planned_coverage import work
from sim.scenarios.coverage_setup import STEP_S, CoverageSetup
from sim.scenarios.scenario import (
    BusOff,
    Crash,
    Estop,
    Fault,
    Freeze,
    Heal,
    Join,
    Loss,
    Partition,
    Reset,
    Restart,
)
from sim.world.plan_judge import judge
from tools.run.coverage import app


def scene(side: int, robots: int, seed: int, share: float = 0.1, gate: bool = False) -> Instance:
    walls = random_walls(side, side, share, seed)
    starts = gate_starts(walls, robots) if gate else random_starts(walls, robots, seed)
    return Instance(f"random {side}x{side} seed {seed}", walls, starts)


def play(instance: Instance, *faults: Fault, seed: int = 1, loss: float = 0.0) -> CoverageOutcome:
    setting = CoverageSetup.made(
        instance, seed=seed, faults=faults, loss=loss, time_limit_s=400.0
    )  # fmt: skip
    return CoverageRun(setting).run()


@pytest.mark.slow
def test_the_wire_costs_a_few_steps() -> None:
    """As fast as with instant sharing but for the boot, which is over within two seconds."""
    instance = scene(14, 5, 2)
    outcome = play(instance)
    assert outcome.success, outcome
    shared_at_once = judge(work(instance)).makespan
    assert outcome.makespan_s <= (shared_at_once + 2) * STEP_S + 2.0, outcome
    assert outcome.rounds == 1 and outcome.bus_load_worst_case < 0.3


def test_the_same_seed_is_the_same_run() -> None:
    one, same, other = (play(scene(8, 3, 4), seed=seed) for seed in (1, 1, 2))
    assert one.trace_hash == same.trace_hash != other.trace_hash


@pytest.mark.parametrize("seed", [1, 2])
def test_a_dead_robot_stays_a_wreck_and_its_work_is_done(seed: int) -> None:
    instance = scene(12, 4, seed)
    outcome = play(instance, Crash(at_s=20.0, kind="crash", robot=seed), seed=seed)
    assert outcome.success, outcome
    assert outcome.untold <= 1, "only what it was about to tell"


@pytest.mark.slow
def test_both_sides_of_a_split_work_and_nothing_is_done_again_after_the_heal() -> None:
    instance = scene(14, 4, 5)
    faults = (
        Partition(at_s=15.0, kind="partition", islands=[[0, 2], [1, 3]]),
        Heal(at_s=45.0, kind="heal"),
    )
    outcome = play(instance, *faults, seed=5)
    assert outcome.success and outcome.rounds == 3, "a stopped robot is not a stranded one"
    alone = play(instance, seed=5)
    assert outcome.makespan_s < alone.makespan_s + 20.0, "neither side waits for the other"


def test_i24_a_plan_made_just_before_a_heal_is_no_fault_of_the_fleet() -> None:
    """Robot 0 began a round by itself 0.4 s before the heal. The judge looked after the heal, and counted
    what the others had covered as planned again."""
    walls = random_walls(8, 6, 0.2, 30)
    faults = (
        Partition(at_s=13.0, kind="partition", islands=[[0], [1, 2]]),
        Heal(at_s=34.0, kind="heal"),
    )
    outcome = play(Instance("random", walls, random_starts(walls, 3, 30)), *faults, seed=30)
    assert outcome.success and outcome.redone == 0, outcome


@pytest.mark.slow
def test_who_comes_late_is_given_work() -> None:
    instance = scene(14, 4, 6)
    late = [Join(at_s=25.0, kind="join", robot=robot) for robot in (1, 3)]
    two, four = play(instance._replace(starts=instance.starts[::2])), play(instance, *late)
    assert four.success and four.makespan_s < 0.85 * two.makespan_s, (four, two)


def test_a_fifth_of_all_frames_lost() -> None:
    outcome = play(scene(10, 4, 7), loss=0.2)
    assert outcome.success, outcome


def test_a_report_that_a_lossy_bus_has_just_lost_is_no_flaw_of_the_plan() -> None:
    """`headland coverage drive --H 5 --W 5 --robots 2 --loss 0.1` ended with exit code 1: the first plan
    had the cell where the other robot stood, because that frame was lost 3 s before."""
    outcome = play(scene(5, 2, 0, share=0.2), seed=0, loss=0.1)
    assert outcome.untold == 1, "seed 0 loses that frame"
    assert outcome.success and outcome.redone == 0, outcome


@pytest.mark.slow
def test_a_stopped_robot_is_gone_round_and_one_that_comes_back_works() -> None:
    faults = (
        Crash(at_s=12.0, kind="crash", robot=0),
        Restart(at_s=20.0, kind="restart", robot=0),
        BusOff(at_s=24.0, kind="bus_off", robot=2, for_s=2.0),
        Estop(at_s=32.0, kind="estop", robot=1),
        Reset(at_s=36.0, kind="reset"),
    )
    outcome = play(scene(12, 4, 8), *faults)
    assert outcome.finished and outcome.replicas_equal and outcome.contacts == 0, outcome
    assert outcome.uncovered == outcome.replanned == outcome.redone == 0, outcome


def test_i24_a_run_does_not_end_before_a_robot_that_was_frozen_has_its_part_again() -> None:
    """The plan that was made as it woke up counted it as standing, and the run told that all was over."""
    walls = np.zeros((1, 8), dtype=np.bool_)
    walls[0, 1] = True
    instance = Instance("two rooms", walls, [(0, 0), (0, 7)])
    outcome = play(instance, Freeze(at_s=4.0, kind="freeze", robot=1, for_s=25.0))
    assert outcome.finished and outcome.uncovered == 0, outcome


@pytest.mark.parametrize(("side", "robots"), [(2, 1), (3, 2)])
def test_i24_a_run_does_not_end_before_the_last_cells_are_announced(side: int, robots: int) -> None:
    """Covered cells are announced every 2 s. The run ended before that, as finished and without a flaw,
    with 0 of 1 sections done."""
    outcome = play(scene(side, robots, 1, share=0.0))
    assert outcome.success and outcome.sections_done == outcome.sections == 1, outcome


def test_i24_a_run_goes_on_where_its_last_news_brings_a_round() -> None:
    """The robot woke up while the replicas settled, and its fleet agreed again. The run ended in that
    round, as not finished."""
    walls = np.zeros((8, 2), dtype=np.bool_)
    walls[0, 0] = walls[6, 1] = True
    starts = [(7, 0), (5, 0), (4, 1), (4, 0), (1, 0)]
    freeze = Freeze(at_s=6.0, kind="freeze", robot=1, for_s=4.0)
    outcome = play(Instance("lane", walls, starts), freeze, seed=1019)
    assert outcome.success and outcome.sections_done == 1, outcome


def test_i24_a_robot_alone_works_on_after_its_bus_off() -> None:
    """Nobody else sent a frame, so the wire was never asked again, and the robot stayed off the bus."""
    outcome = play(scene(6, 1, 4), BusOff(at_s=5.0, kind="bus_off", robot=0, for_s=3.0))
    assert outcome.success, outcome


class MovedIntoWall(CoverageRun):
    """At 8 s people push robot 1 into a wall of the map, where it stays."""

    moved = False

    def look(self, cluster: CoverageFleet) -> None:
        super().look(cluster)
        now_us, world = cluster.host.now_us(), cluster.grid_world
        if not self.moved and now_us >= 8 * S:
            self.moved, row = True, world.robots[1].index
            world.positions[row], world.placed_at_us[row] = world.ground.centre_of((1, 3)), now_us
            world.speeds[row] = 0.0


def test_i24_nobody_waits_for_a_robot_that_stands_in_no_cell_of_the_map() -> None:
    """It called a round, and told no place in it. So no round had an end, and its part was left."""
    walls = np.zeros((6, 7), dtype=np.bool_)
    walls[:3, 3] = True
    instance = Instance("wall", walls, [(0, 0), (5, 6)])
    outcome = MovedIntoWall(CoverageSetup.made(instance, seed=1, time_limit_s=90.0)).run()
    assert outcome.uncovered == 0 and outcome.contacts == 0, outcome


@pytest.mark.parametrize("columns", [7, 15])
def test_i24_what_a_standing_robot_has_claimed_is_done_when_its_cells_are_covered(
    columns: int,
) -> None:
    """It was live, so its sections and its share of the others were left, and the run had no end."""
    walls = np.zeros((6, columns), dtype=np.bool_)
    walls[:3, 3] = True
    instance = Instance("wall", walls, [(0, 0), (5, 6)])
    outcome = MovedIntoWall(CoverageSetup.made(instance, seed=1, time_limit_s=250.0)).run()
    assert outcome.finished and outcome.sections_done == outcome.sections, outcome


def test_corridors_full_of_robots() -> None:
    """A comb of dead ends one cell wide: who is in the way goes on, in the order of the plan."""
    walls = np.ones((5, 13), dtype=np.bool_)
    walls[0, :] = False
    walls[:, ::2] = False
    starts = [(4, column) for column in range(0, 13, 2)] + [(3, 0), (3, 6)]
    outcome = play(Instance("comb", walls, starts))
    assert outcome.success and outcome.closest_m >= 2.0, outcome


@pytest.mark.slow
def test_a_death_among_aisles_of_one_robot() -> None:
    """Who follows another round a corner comes after it: three once met at a crossing, and stood."""
    walls = rack_walls(22, 22)
    instance = Instance("warehouse", walls, gate_starts(walls, 8))
    plain = play(instance)
    assert plain.success and plain.closest_m > 0.6 * 4.0, "the plan keeps apart, not the guard"
    dead = play(instance, Crash(at_s=plain.makespan_s / 2, kind="crash", robot=2))
    assert dead.success and dead.rounds == 2, "the stop for a silent member strands no robot"
    assert dead.makespan_s <= (1.0 + 0.5 / 7) * plain.makespan_s + 12.0, "its share, and a round"


@pytest.mark.parametrize("seed", range(3))
def test_trouble_of_any_kind(seed: int) -> None:
    """Drawn faults on crowded maps: nobody touches anybody, and all that can be covered is."""
    rng = Random(f"{seed}/grid trouble")
    slots = list(range(5))
    rng.shuffle(slots)
    at_s = rng.uniform(3.0, 15.0)
    faults = (
        Loss(at_s=rng.uniform(0.0, 20.0), kind="loss", rate=0.1),
        Partition(at_s=at_s, kind="partition", islands=[slots[:2], slots[2:]]),
        Heal(at_s=at_s + rng.choice((1.0, 15.0)), kind="heal"),
        Crash(at_s=rng.uniform(5.0, 25.0), kind="crash", robot=slots[0]),
    )
    outcome = play(scene(9, 5, seed, 0.25, gate=seed == 1), *faults, seed=seed)
    assert outcome.finished and outcome.replicas_equal, (seed, outcome)
    assert outcome.contacts == outcome.through_walls == outcome.uncovered == 0, (seed, outcome)
    assert outcome.replanned == 0, (seed, outcome)


def test_i24_what_a_fleet_of_which_all_robots_die_left_is_uncovered() -> None:
    """The run ended in a ValueError: no replica was left."""
    deaths = [Crash(at_s=5.0 + robot, kind="crash", robot=robot) for robot in range(2)]
    outcome = play(scene(5, 2, 2), *deaths)
    assert not outcome.finished and not outcome.success, outcome
    assert 10 < outcome.uncovered < 24, outcome


def test_the_command(tmp_path: Path) -> None:
    words = ["drive", "--H", "8", "--W", "8", "--robots", "3", "--die", "1@10", "--out",
             str(tmp_path), "--json"]  # fmt: skip
    done = CliRunner().invoke(app, words)
    report = json.loads(done.stdout)
    assert done.exit_code == 0 and report["success"] and report["robots"] == 3, done.output
    assert json.loads((tmp_path / "report.json").read_text())["ratio"] == report["ratio"]
    assert [(told["kind"], told["robot"]) for told in report["faults"]] == [("crash", 1)]
    assert (tmp_path / "can.log").stat().st_size > 10_000


@pytest.mark.parametrize("words", [
    ["--robots", "3", "--die", "3@1"], ["--robots", "3", "--die", "x"], ["--robots", "200"],
    ["--robots", "3", "--split", "0@9-5"], ["--robots", "3", "--split", "0@5"],
    ["--robots", "1", "--join", "0@5"], ["--robots", "3", "--loss", "2"],
    ["--robots", "3", "--turn-cost", "-1"],
    ["--robots", "3", "--H", "300", "--W", "300", "--wall-prob", "0"],
])  # fmt: skip
def test_bad_input_is_one_line(words: list[str]) -> None:
    done = CliRunner().invoke(app, ["drive", *words])
    assert done.exit_code == 2 and "Traceback" not in done.output
    assert done.output.strip().count("\n") == 0 and "headland:" in done.output


@pytest.mark.parametrize("second", [3.5, 4.5])
def test_a_robot_that_has_no_room_joins_when_the_others_have_made_some(second: float) -> None:
    place = Instance("two cells", np.zeros((1, 2), dtype=bool), [(0, 0), (0, 1)])
    run = CoverageRun(
        CoverageSetup.made(
            place, faults=[Join(at_s=second, kind="join", robot=0)], time_limit_s=60.0
        )
    )
    outcome = run.run()
    assert outcome.success, outcome
    assert run.cluster is not None and run.cluster.is_up(0)
