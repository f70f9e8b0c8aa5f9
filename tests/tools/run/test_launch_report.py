"""What a launch writes of itself when it has ended."""

import json
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from agent.delivery.task_registry import TransportTask
from agent.interface.lifecycle import State
from protocol.frames.codec import encode
from protocol.frames.delivery_frames import TaskOrder
from protocol.frames.fleet_frames import Member, Pose
from sim.scenarios.delivery_scenario import DeliveryScenario
from sim.scenarios.delivery_setup import DeliverySetup
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from sim.world.ground_truth import Contact
from tests.sim.runs.test_delivery_run import MAP
from tools.run.fleet_folder import fleet_folder
from tools.run.launch import Launch
from tools.run.launch_delivery import HaulLaunch

BOOTED_S = 86_400.0  # the loop's clock, when the launch begins


def test_times_in_the_report_count_from_the_start_of_the_launch(tmp_path: Path) -> None:
    """Of a machine that had run for a day, the first transition was at 86,402 s."""
    setting = FieldSetup(load("small").changed(robots=2))
    fleet = fleet_folder(tmp_path, setting, False)
    launch = Launch(setting, "small", fleet, Console(quiet=True), None)
    launch.zero_at_us = round(BOOTED_S * 1e6)
    launch.world.contacts.append(Contact(4_000_000, 0, None, 0.1, "fence", 1.0, 2.0))
    working = Pose(1.0, 2.0, 0.0, 1.0, State.WORKING.value, False, 255)
    launch.inspector.hear(BOOTED_S + 1.0, encode(Member(0, 1, 0), 0x80))
    launch.inspector.hear(BOOTED_S + 2.5, encode(working, 0x80))
    launch._report(9.0, False)
    for lock in fleet.locks:
        lock.close()
    told = json.loads((tmp_path / "report.json").read_text())
    assert [step["t_s"] for step in told["robots"][0]["transitions"]] == [2.5]
    assert [touch["t_s"] for touch in told["touched"]] == [4.0]


@pytest.mark.parametrize(
    ("began_us", "told"),
    [
        (0, "not finished after 37 s: "),
        (27_000_000, "not finished after 37 s, 10 s of them in this launch: "),
    ],
)
def test_a_launch_that_continues_a_fleet_tells_its_own_time_as_well(
    tmp_path: Path, began_us: int, told: str
) -> None:
    """After `--seconds 10` it said 37 s: the time of all launches of the fleet."""
    setting, said = FieldSetup(load("small").changed(robots=2)), StringIO()
    fleet = fleet_folder(tmp_path, setting, False)
    launch = Launch(setting, "small", fleet, Console(file=said, width=1000), None)
    launch.world_began_us = began_us
    launch.world.contacts.append(Contact(4_000_000, 0, None, 0.1, "fence", 1.0, 2.0))
    launch._report(37.0, False)
    for lock in fleet.locks:
        lock.close()
    assert told in said.getvalue()
    assert ", 1 contact, " in said.getvalue()  # it said "1 contacts"


def test_a_launch_tells_which_tasks_a_full_battery_does_not_last_for(tmp_path: Path) -> None:
    """Only `headland run` did, and nothing said why such a parcel lay there."""
    scenario = DeliveryScenario.model_validate({
        "name": "test", "mission": "delivery", "battery": {"range_m": 20.0, "charge_s": 5.0},
        "warehouse": {"map": MAP, "random_tasks": 0, "handle_s": 1.0, "bays": [(5.5, 2.5)]},
        "fleet": {"robots": 1, "radius_m": 0.3, "speed_m_s": 1.0},
    })  # fmt: skip
    setting, said = DeliverySetup(scenario), StringIO()
    fleet = fleet_folder(tmp_path, setting, False)
    launch = HaulLaunch(setting, "test", fleet, Console(file=said, width=1000), None)
    truth, house = launch._parcels(), setting.house
    far, near = ((0.5, 0.5), (11.5, 4.5)), ((5.5, 0.5), (5.5, 4.5))
    for task, (pickup, dropoff) in enumerate((far, near, far)):
        truth.appear(task, pickup, dropoff, 0)
    cell = house.cell(far[1])
    assert cell is not None
    taken_back = TransportTask(0, cell).taken_back
    launch.inspector.hear(1.0, encode(TaskOrder(2, *taken_back), 0x80))
    launch._report(9.0, False)
    for lock in fleet.locks:
        lock.close()
    assert json.loads((tmp_path / "report.json").read_text())["beyond_battery"] == [0]
    assert "a full battery does not last for task 0" in said.getvalue()
