"""How a carrier drives: boxes that come and go cost nothing, the next way is there before it is needed,
and no battery is ever empty, also with a parcel aboard."""

from collections.abc import Sequence
from functools import partial
from math import inf

import pytest

from agent.delivery.warehouse import Warehouse
from agent.interface.config import S
from agent.navigation.path_requests import AHEAD_S
from sim.runs.delivery_fleet import DeliveryFleet
from sim.runs.delivery_run import DeliveryOutcome, DeliveryRun
from sim.scenarios.delivery_scenario import DeliveryScenario, TaskRow
from sim.scenarios.delivery_setup import DeliverySetup
from sim.world.world import World

OPEN = "\n".join(["." * 24] * 7)
HALL = "\n".join(["...#" + "#" * 19 + "#", "." * 24, "...#" + "#" * 19 + "#"])
NOTHING = {"twice": 0, "lost": 0, "by_two": 0, "again": 0}
Box = tuple[float, float, float, float]  # from, until, x, y


class Alone(DeliverySetup):
    """One robot, tasks by hand, and boxes of 0.8 m that come and go."""

    def __init__(
        self, drawing: str, start: tuple[float, float], rows: Sequence[TaskRow],
        boxes: Sequence[Box] = (), bays: Sequence[tuple[float, float]] = (),
        battery: dict[str, float] | None = None,
    ) -> None:  # fmt: skip
        super().__init__(DeliveryScenario.model_validate({
            "name": "alone", "mission": "delivery",
            "warehouse": {"map": drawing, "handle_s": 1.0, "bays": list(bays)},
            "battery": battery or {},
            "fleet": {"robots": 1, "radius_m": 0.3, "speed_m_s": 1.0, "acceleration_m_s2": 2.0},
            "run": {"seed": 1, "time_limit_s": 400.0},
        }))  # fmt: skip
        self.starts, self.rows, self.falling = [start], list(rows), list(boxes)
        orders = {k: self.order(self.house, row) for k, row in enumerate(self.rows)}
        self.house = Warehouse(self.floor, self.carrier, bays, orders)

    def world(self) -> World:
        world = super().world()
        for from_s, until_s, x_m, y_m in self.falling:
            world.at(round(from_s * S), partial(self._put, world, until_s, x_m, y_m))
        return world

    @staticmethod
    def _put(world: World, until_s: float, x_m: float, y_m: float) -> None:
        number = world.add_box(x_m, y_m, 0.8)
        if until_s < inf:
            world.at(round(until_s * S), partial(world.remove_box, number))


def play(setting: Alone, watch: object = None) -> tuple[DeliveryRun, DeliveryOutcome, list[str]]:
    run = DeliveryRun(setting)
    if callable(watch):
        run.watch = watch
    outcome = run.run()
    print(outcome)
    assert outcome.finished and not outcome.flawed and outcome.flaws == NOTHING
    assert run.cluster is not None
    return run, outcome, [path.why for path in run.cluster.missions[0].followed]


ACROSS = [TaskRow((1.5, 3.5), (22.5, 3.5))]  # twenty metres with the parcel aboard


def test_boxes_that_appear_and_leave_before_they_matter_cost_no_path() -> None:
    """Far ahead for seconds, right beside the way for long, and on it for less than is looked at."""
    boxes = [(4.0, 9.0, 19.5, 3.5), (2.0, inf, 11.5, 5.5), (12.02, 12.11, 12.5, 3.5)]
    _, _, without = play(Alone(OPEN, (0.5, 3.5), ACROSS))
    _, outcome, why = play(Alone(OPEN, (0.5, 3.5), ACROSS, boxes))
    assert why == without and set(why) == {"goal"}
    assert outcome.contacts == 0


def test_a_box_that_stays_costs_a_path_or_two() -> None:
    """One when it is seen, one more where its far side is seen only from beside it."""
    _, _, why = play(Alone(OPEN, (0.5, 3.5), ACROSS, [(2.0, inf, 12.5, 3.5)]))
    assert 1 <= why.count("blocked") <= 2 and "lost" not in why


def test_the_next_path_is_planned_ten_seconds_ahead_and_used() -> None:
    planned_s: list[float] = []

    def watch(cluster: DeliveryFleet) -> None:
        paths = cluster.missions[0].paths
        planned_s.extend([cluster.host.now_us() / S] * (paths.planned - len(planned_s)))

    run, outcome, _ = play(
        Alone(
            OPEN, (1.5, 1.5), [TaskRow((21.5, 2.5), (1.5, 2.5)), TaskRow((1.5, 4.5), (21.5, 0.5))]
        ),
        watch,
    )
    assert run.cluster is not None
    at_s = [e.t_us / S for e in run.cluster.truth.events]  # picked, delivered, picked, delivered
    print(planned_s, at_s)
    assert 5.0 < at_s[0] - planned_s[0] < AHEAD_S + 4.0  # braking and handling come on top
    assert 5.0 < at_s[1] - planned_s[1] < AHEAD_S + 4.0
    assert outcome.ahead >= 3


@pytest.mark.parametrize("reserve", [0.0, 0.15])
def test_a_carrier_that_is_held_up_charges_with_its_parcel_aboard(reserve: float) -> None:
    """Its battery would last for the task, not for a box in the only way for more than a minute."""
    setting = Alone(
        HALL, (1.5, 1.5), [TaskRow((2.5, 2.5), (22.5, 1.5))], [(1.0, 85.0, 12.5, 1.5)],
        bays=[(0.5, 0.5)],
        battery={"range_m": 1000.0, "standby_s": 100.0, "dock_s": 1.0, "charge_s": 10.0,
                 "reserve": reserve},
    )  # fmt: skip
    run, outcome, _ = play(setting)
    assert run.cluster is not None
    assert [e.what for e in run.cluster.truth.events] == ["picked", "delivered"]
    assert outcome.charges >= 1
    assert outcome.lowest_battery > 0.0
