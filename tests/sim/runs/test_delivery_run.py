"""Whole peers that carry parcels: what is true of parcels and batteries at the end, whatever happens."""

from collections.abc import Sequence
from math import dist
from typing import Any

import pytest

from agent.claims.standing_owners import STANDS_US
from agent.delivery.delivery_mission import DeliveryMission
from agent.delivery.task_allocation import round_tasks_max
from agent.delivery.task_outcome import PICKED_UP, TaskPhase, outcome_of
from agent.delivery.task_registry import TransportTask
from agent.delivery.warehouse import Warehouse
from agent.interface.config import ADDRESS_FIRST, S
from agent.interface.effects import Effect, Trace
from crdt import Phase
from protocol.frames.codec import decode_once
from protocol.frames.delivery_frames import PlanRow, TaskBookDigest, TaskOrder
from protocol.frames.frame import Frame
from sim.fleet.simulated_disk import MemoryJournal
from sim.fleet.trace_recorder import Recorder
from sim.runs.delivery_fleet import DeliveryFleet
from sim.runs.delivery_run import DeliveryOutcome, DeliveryRun
from sim.scenarios.delivery_scenario import DeliveryScenario, Outage, TaskRow
from sim.scenarios.delivery_setup import DeliverySetup
from sim.scenarios.fleet_setup import DRAWN
from sim.scenarios.scenario import Crash, DeafWheels, Heal, Loss, Partition, Restart
from tests.agent.planning import short_search
from tools.inspect.inspector import Inspector
from tools.run.run_delivery import UNREACHABLE, exit_code

MAP = """
............
..###..###..
............
..###..###..
............
"""
NOTHING = {"twice": 0, "lost": 0, "by_two": 0, "again": 0}


short_searches = pytest.fixture(autouse=True)(short_search)


def scenario(
    robots: int = 3, seed: int = 1, faults: Sequence[Any] = (), battery: dict[str, float] | None = None,
    loss: float = 0.0, **table: Any,
) -> DeliveryScenario:  # fmt: skip
    print(f"seed {seed}")
    return DeliveryScenario.model_validate({
        "name": "test", "mission": "delivery", "fault": list(faults),
        "warehouse": {"map": MAP, "random_tasks": 6, "handle_s": 1.0, **table},
        "battery": battery or {}, "bus": {"loss": loss},
        "fleet": {"robots": robots, "radius_m": 0.3, "speed_m_s": 1.0, "acceleration_m_s2": 2.0,
                  "silence": "continue"},
        "run": {"seed": seed, "time_limit_s": 400.0},
    })  # fmt: skip


def play(
    given: DeliveryScenario, watch: Any = None, recorder: Recorder | None = None
) -> tuple[DeliveryOutcome, DeliveryRun]:
    run = DeliveryRun(DeliverySetup(given))
    run.watch, run.recorder = watch, recorder
    outcome = run.run()
    print(outcome)
    assert outcome.flaws == NOTHING
    assert not outcome.empty
    assert outcome.contacts == 0
    return outcome, run


def test_i24_a_run_tells_which_tasks_a_full_battery_does_not_last_for() -> None:
    """The robot stood until the end of the run, beside "unreachable: none"."""
    battery = {"range_m": 20.0, "charge_s": 5.0}
    given = scenario(robots=1, random_tasks=0, bays=[(5.5, 2.5)], battery=battery)
    short = given.run.model_copy(update={"time_limit_s": 60.0})
    setting = DeliverySetup(given.model_copy(update={"run": short}))
    setting.rows = [TaskRow((0.5, 0.5), (11.5, 4.5), 1.0), TaskRow((5.5, 0.5), (5.5, 4.5), 1.0)]
    outcome = DeliveryRun(setting).run()
    assert outcome.delivered == 1 and outcome.unreachable == (), outcome
    assert outcome.beyond_battery == (0,), outcome


def test_i24_a_planned_task_that_no_battery_lasts_for_holds_up_no_other_and_no_bay() -> None:
    """The robot claimed the bay, was full, and claimed it again, twice a second."""
    battery = {"range_m": 20.0, "charge_s": 5.0}
    given = scenario(robots=1, random_tasks=0, bays=[(5.5, 2.5)], battery=battery)
    short = given.run.model_copy(update={"time_limit_s": 60.0})
    setting = DeliverySetup(given.model_copy(update={"run": short}))
    setting.rows = [TaskRow((0.5, 0.5), (11.5, 4.5), 1.0), TaskRow((5.5, 0.5), (5.5, 4.5), 1.0)]

    def plan(fleet: DeliveryFleet) -> None:
        """As a round that all joined leaves it, which gives each task to a robot."""
        dispatch = fleet.missions[0].dispatch
        if 0 in dispatch.book.tasks and 0 not in dispatch.itinerary:
            dispatch.itinerary.insert(0, 0)

    run = DeliveryRun(setting)
    run.watch = plan
    outcome = run.run()
    assert outcome.delivered == 1 and outcome.beyond_battery == (0,), outcome
    assert outcome.charges < 5, outcome


@pytest.mark.slow
def test_a_boot_with_many_tasks_is_planned_by_all_and_one_plan_is_streamed() -> None:
    outcome, _ = play(scenario())
    assert outcome.finished and outcome.replicas_equal
    assert outcome.rounds == 1
    assert outcome.ahead > 0  # paths were there before they were needed


@pytest.mark.slow
def test_a_listener_on_the_bus_reads_every_itinerary_and_battery() -> None:
    """What `headland inspect` shows of a fleet that is at work is what its robots mean to do."""
    inspector, checked = Inspector(), [0]

    def watch(cluster: DeliveryFleet) -> None:
        told = {r["slot"]: r for r in inspector.to_dict()["robots"] if "itinerary" in r}
        for slot, mission in cluster.missions.items():
            if slot in told and cluster.host.now_us() > 12 * S:
                means = [s for s in mission.stops if s[0] == "D"]
                heard = [s for s in told[slot]["itinerary"] if s[0] == "D"]
                # what was claimed or put down within the last beat is not told yet
                assert abs(len(means) - len(heard)) <= 1, (mission.stops, told[slot])
                assert abs(told[slot]["battery"] - cluster.truth.battery[slot]) < 0.2
                checked[0] += means == heard

    run = DeliveryRun(
        DeliverySetup(scenario(random_tasks=9, bays=[(0.5, 0.5)], battery={"range_m": 90.0}))
    )
    run.watch = watch
    run.attach = lambda cluster: cluster.segment.taps.append(
        lambda t_us, frame: inspector.hear(t_us / S, frame)
    )
    assert run.run().finished
    assert checked[0] > 40


@pytest.mark.slow
def test_the_same_seed_gives_the_same_run() -> None:
    given = scenario(robots=2, random_tasks=3)
    assert play(given)[0].trace_hash == play(given)[0].trace_hash


@pytest.mark.slow
def test_tasks_in_a_trickle_are_auctioned_one_by_one() -> None:
    """Who hears a bid before its own control period bids too. Found by rounds over a queue: the first
    robot's bid kept all others out, and it did everything."""
    carried: set[int] = set()

    def watch(cluster: DeliveryFleet) -> None:
        carried.update(cluster.truth.aboard)

    outcome, _ = play(scenario(random_tasks=5, random_over_s=40.0), watch)
    assert outcome.finished
    assert outcome.rounds == 0
    assert outcome.frames["TaskBid"] >= 5
    assert len(carried) >= 2
    assert outcome.makespan_s < 60.0  # the last task comes after 27 s


def test_i24_a_parcel_is_carried_to_the_neighbouring_cell_too() -> None:
    """Nearest to the pickup, the robot came no nearer to the dropoff: it put the parcel down at once."""
    setting = DeliverySetup(scenario(robots=1, random_tasks=0))
    setting.rows = [TaskRow((2.5, 0.5), (3.5, 0.5), 1.0)]
    run = DeliveryRun(setting)
    outcome = run.run()
    assert outcome.finished and run.cluster is not None, outcome
    assert dist(run.cluster.truth.lies[0], (3.5, 0.5)) < 0.3


@pytest.mark.parametrize(("count", "rounds"), [(4, 0), (5, 1)])
def test_up_to_t_max_new_tasks_are_inserted_and_more_are_planned_anew(
    count: int, rounds: int
) -> None:
    """Scenarios B and C, at the threshold; t_max is 4."""
    setting = DeliverySetup(scenario(random_tasks=0))
    setting.rows = [TaskRow((2.5 + k, 0.5), (1.5 + k, 4.5), 6.0) for k in range(count)]
    outcome = DeliveryRun(setting).run()
    print(outcome)
    assert outcome.finished and not outcome.flawed
    assert outcome.rounds == rounds
    assert (outcome.frames.get("TaskBid", 0) > 0) is (rounds == 0)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("loss", [0.0, 0.1])
def test_while_tasks_stream_in_faster_than_they_are_done_the_queue_is_planned_better(
    loss: float,
) -> None:
    """One by one (t_max is out of reach): rounds are those that make tasks wait less. Nobody waits."""
    outcome, run = play(scenario(random_tasks=16, random_over_s=36.0, t_max=99, loss=loss))
    assert outcome.finished
    assert outcome.rounds >= 1 and outcome.waited_s == 0
    assert run.cluster is not None
    for mission in run.cluster.missions.values():
        assert not mission.dispatch.itinerary


class KillsTheCarrier:
    """Kills the first robot that has a parcel aboard."""

    def __init__(self) -> None:
        self.killed: int | None = None

    def __call__(self, cluster: DeliveryFleet) -> None:
        if self.killed is None and cluster.truth.aboard:
            self.killed = min(cluster.truth.aboard)
            cluster.kill(self.killed)


@pytest.mark.slow
def test_a_parcel_of_a_robot_that_died_is_fetched_from_where_it_died() -> None:
    killer = KillsTheCarrier()
    outcome, run = play(scenario(), killer)
    assert outcome.finished
    assert run.cluster is not None
    taken = [e for e in run.cluster.truth.events if e.what == "taken"]
    assert len(taken) == 1 and taken[0].slot != killer.killed


@pytest.mark.slow
def test_i24_a_dead_robots_parcel_that_one_robot_cannot_reach_is_fetched_by_another() -> None:
    """The robot that gave it back was live, and counted as its carrier for good."""
    hall = "############......############\n" + "." * 30 + "\n############......############\n"
    given = scenario(map=hall, random_tasks=0)
    setting = DeliverySetup(given)
    setting.starts = [(13.5, 1.5), (2.5, 1.5), (29.5, 1.5)]
    setting.rows = [TaskRow((14.5, 2.5), (27.5, 1.5))]
    orders = {0: setting.order(setting.house, setting.rows[0])}
    setting.house = Warehouse(setting.floor, setting.carrier, (), orders)

    class Blocks:
        done = False

        def __call__(self, cluster: DeliveryFleet) -> None:
            if cluster.truth.aboard.get(0) == 0 and cluster.is_up(0):
                cluster.kill(0)
            known = cluster.missions[2].dispatch.workers.get(0, [])
            if 1 in known and not self.done:  # the nearer robot is on its way
                self.done = True
                cluster.world.add_box(8.5, 1.5, 0.9)

    blocker, run = Blocks(), DeliveryRun(setting)
    run.watch = blocker
    outcome = run.run()
    print(outcome)
    assert blocker.done
    assert outcome.finished and not outcome.flawed


@pytest.mark.slow
def test_a_carrier_that_restarts_brings_what_it_has_aboard() -> None:
    class Restarts(KillsTheCarrier):
        def __call__(self, cluster: DeliveryFleet) -> None:
            was = self.killed
            super().__call__(cluster)
            if was is not None and not cluster.is_up(was):
                cluster.boot(was)

    outcome, run = play(scenario(), Restarts())
    assert outcome.finished
    assert run.cluster is not None
    assert not [e for e in run.cluster.truth.events if e.what == "taken"]


@pytest.mark.slow
def test_what_a_stopped_robot_has_not_picked_up_is_left_to_others() -> None:
    """Found by chaos: who has lost its memory stands stopped until a person comes, and kept its task."""

    class LosesItsMemory:
        slot: int | None = None

        def __call__(self, cluster: DeliveryFleet) -> None:
            begun = [s for s, m in cluster.missions.items() if m.section is not None]
            if self.slot is None and begun and not cluster.truth.aboard:
                self.slot = begun[0]
                cluster.kill(self.slot)
                cluster.journals[self.slot] = MemoryJournal()
                cluster.boot(self.slot)

    forgetful = LosesItsMemory()
    outcome, _ = play(scenario(), forgetful)
    assert forgetful.slot is not None
    assert outcome.finished


class Claims(Recorder):
    """Why sections were claimed."""

    def __init__(self) -> None:
        super().__init__()
        self.claimed: list[str] = []

    def __call__(self, slot: int, now_us: int, effect: Effect) -> None:
        super().__call__(slot, now_us, effect)
        if isinstance(effect, Trace) and effect.event == "CLAIM":
            self.claimed.append(effect.why)


def deaf(robot: int, at_s: float) -> DeafWheels:
    return DeafWheels(at_s=at_s, kind="deaf_wheels", robot=robot, for_s=1_000.0)


@pytest.mark.slow
def test_i24_a_live_robot_that_stands_loses_the_task_that_it_has_not_picked_up() -> None:
    """Its wheels get no command, so it stands. It is live, so no lease ends: its task lay for good."""
    recorder = Claims()
    outcome, _ = play(scenario(faults=[deaf(0, 24.0)]), recorder=recorder)
    assert outcome.finished and outcome.delivered == 6
    assert outcome.makespan_s < 24.0 + 1.5 * STANDS_US / S
    assert [why for why in recorder.claimed if "robot 0 stands for 60 s" in why]


@pytest.mark.slow
def test_i24_a_robot_that_loads_for_long_keeps_its_task() -> None:
    """It stood for 60 s beside the parcel, so another took its task, and stood for 60 s, and so on."""
    outcome, _ = play(scenario(robots=2, random_tasks=1, handle_s=70.0))
    assert outcome.finished and outcome.delivered == 1


@pytest.mark.parametrize("at_s", [20.0, 30.0])
def test_i24_a_robot_that_broke_down_is_gone_round_and_its_plan_is_given_to_others(
    at_s: float,
) -> None:
    """20 s: the task was in the itinerary of a robot that could not begin it, and stayed there. 30 s:
    it said in 36 rounds that it would make way, which it could not, and the other gave up after 30 s."""
    outcome, _ = play(scenario(faults=[deaf(1, at_s)]))
    assert outcome.finished and outcome.delivered == 6
    assert outcome.makespan_s < 90.0


@pytest.mark.slow
def test_a_split_with_parcels_in_flight_delivers_each_once() -> None:
    faults = [
        Partition(at_s=8.0, kind="partition", islands=[[0], [1, 2]]),
        Heal(at_s=60.0, kind="heal"),
    ]
    outcome, _ = play(scenario(faults=faults, random_tasks=8))
    assert outcome.finished and outcome.replicas_equal


@pytest.mark.slow
def test_the_elected_dies_as_it_begins_to_stream_and_the_next_best_does() -> None:
    given = scenario(robots=4, random_tasks=8)
    run = DeliveryRun(DeliverySetup(given))
    killed: list[int] = []

    def attach(cluster: DeliveryFleet) -> None:
        def tap(t_us: int, frame: Any) -> None:
            source, message = decode_once(frame)
            if isinstance(message, PlanRow) and not killed:
                slots = [r.slot for r in cluster.running if r.peer.address == source]
                killed.extend(slots)
                cluster.kill(slots[0])

        cluster.segment.taps.append(tap)

    run.attach = attach
    outcome = run.run()
    print(outcome)
    assert killed
    assert outcome.rounds == 1  # of those that live
    assert outcome.finished and outcome.flaws == NOTHING


@pytest.mark.slow
def test_batteries_are_charged_before_they_are_needed_also_when_a_bay_is_lost() -> None:
    given = scenario(
        robots=2, random_tasks=10, bays=[(0.5, 2.5), (11.5, 2.5)], outage=[Outage(bay=0, at_s=5.0)],
        battery={"range_m": 50.0, "charge_s": 10.0, "dock_s": 2.0, "reserve": 0.15},
    )  # fmt: skip
    outcome, _ = play(given)
    assert outcome.finished
    assert outcome.charges > 0
    assert outcome.lowest_battery > 0.0


@pytest.mark.slow
def test_boxes_fall_and_frames_are_lost() -> None:
    outcome, _ = play(scenario(loss=0.05, boxes_a_minute=10.0, boxes_until_s=40.0, box_s=8.0))
    assert outcome.finished


@pytest.mark.slow
def test_a_robot_dies_and_comes_back_while_frames_are_lost() -> None:
    faults = [
        Loss(at_s=1.0, kind="loss", rate=0.2),
        Crash(at_s=12.0, kind="crash", robot=1),
        Restart(at_s=30.0, kind="restart", robot=1),
    ]
    outcome, _ = play(scenario(faults=faults))
    assert outcome.finished


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", [2, 3])
def test_one_wide_halls_do_not_lock(seed: int) -> None:
    hall = "......\n.####.\n......\n.####.\n......"
    outcome, _ = play(scenario(robots=3, seed=seed, map=hall, random_tasks=6))
    assert outcome.finished


def test_a_parcel_behind_a_dead_body_is_reported_and_the_rest_is_delivered() -> None:
    """The only way into a dead end is taken for good: nobody waits for ever, and nobody lies."""
    dead_end = "########....\n............\n########....\n########....\n"

    class Blocks:
        done = False

        def __call__(self, cluster: DeliveryFleet) -> None:
            for robot in cluster.running:
                x_m, y_m = cluster.world.body(robot.slot).position
                if not self.done and y_m > 2.0 and x_m < 6.5 and not cluster.truth.aboard:
                    self.done = True
                    cluster.kill(robot.slot)

    given = scenario(robots=2, seed=1, map=dead_end, random_tasks=0, tasks=None)
    setting = DeliverySetup(given)
    setting.starts = [(7.5, 2.5), (11.5, 3.5)]
    rows = [((0.5, 2.5), (9.5, 0.5)), ((10.5, 0.5), (9.5, 1.5))]
    setting.rows = [TaskRow(*row) for row in rows]
    orders = {k: setting.order(setting.house, row) for k, row in enumerate(setting.rows)}
    setting.house = Warehouse(setting.floor, setting.carrier, (), orders)
    killer = Blocks()
    run = DeliveryRun(setting)
    run.watch = killer
    outcome = run.run()
    print(outcome)
    assert killer.done
    assert outcome.flaws == NOTHING and not outcome.contacts
    assert outcome.delivered == 1
    assert outcome.unreachable == (0,)
    assert outcome.simulated_s < 300.0  # it does not wait for the time limit
    assert exit_code(outcome) == UNREACHABLE


@pytest.mark.slow
def test_tasks_that_were_added_while_running_survive_the_restart_of_everybody() -> None:
    class Restarts:
        done = False

        def __call__(self, cluster: DeliveryFleet) -> None:
            if not self.done and cluster.host.now_us() > 12 * S and cluster.desk.numbers:
                self.done = True
                assert not cluster.desk.due()
                cluster.desk.wanted.clear()  # the device that ordered them has gone home
                for slot in range(3):
                    cluster.kill(slot)
                for slot in range(3):
                    cluster.boot(slot)

    restarts = Restarts()
    outcome, _ = play(scenario(random_tasks=4, random_over_s=8.0), restarts)
    assert restarts.done
    assert outcome.tasks == 4 and outcome.finished


@pytest.mark.slow
def test_a_task_to_a_floor_that_no_way_leads_to_is_reported() -> None:
    """Found: its robot drove against the wall for ever."""
    given = scenario(robots=2, map="....#...\n....#...\n....#...\n", random_tasks=0)
    setting = DeliverySetup(given)
    setting.starts = [(0.5, 0.5), (0.5, 2.5)]
    setting.rows = [TaskRow((1.5, 1.5), (6.5, 1.5)), TaskRow((2.5, 0.5), (3.5, 2.5))]
    orders = {k: setting.order(setting.house, row) for k, row in enumerate(setting.rows)}
    setting.house = Warehouse(setting.floor, setting.carrier, (), orders)
    outcome = DeliveryRun(setting).run()
    print(outcome)
    assert outcome.delivered == 1 and outcome.unreachable == (0,)
    assert outcome.simulated_s < 150.0
    assert exit_code(outcome) == UNREACHABLE


ONE_AISLE = """
....................
....................
..########.########.
..########.########.
..########.########.
..########.########.
....................
..#################.
..#################.
..#################.
....................
....................
"""


@pytest.mark.slow
def test_m1_one_robot_delivers_although_boxes_stand_for_the_whole_run() -> None:
    """Three boxes, one in the aisle: it drove 49 m, planned 168 times, and stood with nothing delivered.

    It must also not go to see again and again whether the boxes that it has seen have gone.
    """
    boxes = [
        {"kind": "box", "at_s": at_s, "x_m": x_m, "y_m": y_m, "size_m": size_m, "for_s": 1200.0}
        for at_s, x_m, y_m, size_m in (
            (5.0, 10.5, 6.5, 0.8), (10.0, 1.0, 5.5, 1.2), (20.0, 12.5, 10.5, 0.8),
        )
    ]  # fmt: skip
    given = scenario(1, seed=1, faults=boxes, map=ONE_AISLE, random_tasks=8, random_over_s=60.0)
    given = given.model_copy(update={"run": given.run.model_copy(update={"time_limit_s": 1200.0})})
    outcome, _ = play(given)
    assert outcome.finished and outcome.delivered == 8


@pytest.mark.slow
def test_t13_a_burst_of_orders_makes_no_round_larger_than_a_control_period_allows() -> None:
    """300 orders in 3 s: one auction of all took 7 s, in which no robot heard a stop."""
    sizes: list[tuple[int, int]] = []

    def watch(cluster: DeliveryFleet) -> None:
        for robot in cluster.robots.values():
            mission = robot.peer.mission
            assert isinstance(mission, DeliveryMission)
            frozen = mission.dispatch.round._frozen  # of the newest round
            if frozen is not None:
                sizes.append((len(frozen.tasks), len(frozen.slots)))

    given = scenario(
        6, map="\n".join(["." * 24] * 8), random_tasks=300, random_over_s=3.0,
        bays=[[0.5, 0.5], [23.5, 0.5]],
    )  # fmt: skip
    given = given.model_copy(
        update={
            "battery": given.battery.model_copy(update={"range_m": 250.0, "charge_s": 30.0}),
            "run": given.run.model_copy(update={"time_limit_s": 90.0}),
        }
    )
    outcome, _ = play(given, watch)
    assert sizes and all(tasks <= round_tasks_max(robots) for tasks, robots in sizes), sizes
    assert outcome.delivered >= 6 * 3, "they work while orders wait"


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_transport_that_was_taken_back_is_not_fetched_and_the_others_are_delivered(
    seed: int,
) -> None:
    taken: list[int] = []

    def watch(cluster: DeliveryFleet) -> None:
        allocation = cluster.running[0].peer.allocation
        for task in sorted(cluster.truth.lies.keys() - cluster.truth.delivered_at_us.keys()):
            if not taken and allocation.phase_of(task) is Phase.STARTED:
                order = cluster.missions[0].dispatch.book.tasks[task]
                cluster.inject(TaskOrder(task, *order.taken_back))  # a robot is on its way
                taken.append(task)

    given = scenario(seed=seed, random_tasks=6)
    given = given.model_copy(update={"run": given.run.model_copy(update={"time_limit_s": 150.0})})
    fleets: list[DeliveryFleet] = []
    run = DeliveryRun(DeliverySetup(given))
    run.watch, run.attach = watch, fleets.append
    outcome = run.run()
    print(outcome)
    (task,), (fleet,) = taken, fleets
    assert outcome.flaws == NOTHING and outcome.contacts == 0
    assert fleet.truth.delivered_at_us.keys() == fleet.truth.dropoff.keys() - {task}
    assert not [event for event in fleet.truth.events if event.task == task]
    for robot in fleet.running:
        peer = robot.peer
        order = fleet.missions[robot.slot].dispatch.book.tasks[task]
        assert outcome_of(task, order, peer.allocation, peer.progress).phase is TaskPhase.WITHDRAWN
        assert task not in fleet.missions[robot.slot].dispatch.itinerary


@pytest.mark.slow
def test_a_transport_that_is_taken_back_too_late_is_delivered() -> None:
    taken: list[int] = []

    def watch(cluster: DeliveryFleet) -> None:
        for slot, task in cluster.truth.aboard.items():
            if not taken:
                order = cluster.missions[slot].dispatch.book.tasks[task]
                cluster.inject(TaskOrder(task, *order.taken_back))
                taken.append(task)

    outcome, _ = play(scenario(), watch)
    assert taken and outcome.finished and outcome.replicas_equal


@pytest.mark.slow
def test_a_parcel_of_a_dead_robot_is_delivered_though_its_order_was_taken_back() -> None:
    """Found: no robot fetched it, and its outcome stayed `aboard` for good."""
    carriers: list[int] = []

    def watch(cluster: DeliveryFleet) -> None:
        if not carriers and cluster.truth.aboard:
            carriers.extend(cluster.truth.aboard)
            order = cluster.missions[carriers[0]].dispatch.book.tasks[0]
            cluster.inject(TaskOrder(0, *order.taken_back))
        elif carriers and len(cluster.running) == 2 and told(cluster):
            cluster.kill(carriers[0])

    def told(cluster: DeliveryFleet) -> bool:
        return all(
            cluster.missions[robot.slot].dispatch.book.tasks[0].withdrawn
            and robot.peer.progress.bits(0, 0) & PICKED_UP
            for robot in cluster.running
        )

    given = scenario(robots=2, random_tasks=1)
    run = DeliveryRun(DeliverySetup(given))
    fleets: list[DeliveryFleet] = []
    run.watch, run.attach = watch, fleets.append
    outcome = run.run()
    (survivor,) = fleets[0].running
    assert outcome.delivered == 1 and outcome.finished
    order = fleets[0].missions[survivor.slot].dispatch.book.tasks[0]
    told_at_last = outcome_of(0, order, survivor.peer.allocation, survivor.peer.progress)
    assert told_at_last.phase is TaskPhase.DELIVERED and told_at_last.carrier == survivor.slot


def test_a_device_without_keys_may_ask_which_tasks_there_are() -> None:
    """`headland task list` of a fleet with keys waited 20 s for orders that nobody repeated."""
    given = scenario(2, random_tasks=2)
    fleet = given.fleet.model_copy(update={"keys": DRAWN})
    given = given.model_copy(update={"fleet": fleet})
    told: set[int] = set()

    def hear(_: int, frame: Frame) -> None:
        message = decode_once(frame)[1]
        if isinstance(message, TaskOrder):
            told.add(message.task)

    def ask(cluster: DeliveryFleet) -> None:
        if cluster.host.now_us() > 8 * S:  # the fleet is up
            cluster.inject(TaskBookDigest(0, 0, 0, 0))

    run = DeliveryRun(DeliverySetup(given))
    run.watch = ask
    run.attach = lambda cluster: cluster.segment.taps.append(hear)
    outcome = run.run()
    assert told == {0, 1} and outcome.finished and outcome.replicas_equal


@pytest.mark.slow
def test_t13_in_a_fleet_with_keys_only_proven_orders_are_believed() -> None:
    """The operator's device proves its orders; those of a stranger are held and dropped."""
    given = scenario(2, random_tasks=2, random_over_s=4.0)
    fleet = given.fleet.model_copy(update={"keys": DRAWN})
    limit = given.run.model_copy(update={"time_limit_s": 60.0})
    given = given.model_copy(update={"fleet": fleet, "run": limit})
    forged, known = TaskOrder(200, 0, 5), []

    def watch(cluster: DeliveryFleet) -> None:
        cluster.inject(forged)
        cluster.inject(forged, ADDRESS_FIRST)  # in a robot's name
        for mission in cluster.missions.values():
            known.append(200 in mission.dispatch.book.tasks)

    outcome, _ = play(given, watch)
    assert known and not any(known)
    assert outcome.delivered == 2, "the parcel of the stranger lies there, and nobody fetches it"


def test_replicas_of_robots_that_know_other_orders_are_not_equal() -> None:
    """A run in which a robot never learned an order said that all replicas are equal."""
    run, equal = DeliveryRun(DeliverySetup(scenario(2, random_tasks=1))), list[bool]()

    def watch(fleet: DeliveryFleet) -> None:
        equal.append(fleet.replicas_equal)
        fleet.missions[0].dispatch.book.tasks[40] = TransportTask(0, 11)
        equal.append(fleet.replicas_equal)
        del fleet.missions[0].dispatch.book.tasks[40]
        run.ended = True

    run.watch = watch
    run.run()
    assert equal[:2] == [True, False]
