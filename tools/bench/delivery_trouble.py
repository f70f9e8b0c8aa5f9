"""A small warehouse and bad luck from a seed: everything that may go wrong with parcels on the way."""

from random import Random
from typing import Any

from sim.floor_plan import warehouse
from sim.warehouse_scenario import WarehouseScenario

ROBOTS = 4


def bad_luck(seed: int) -> WarehouseScenario:
    """Lost frames all the time; a split that heals; one robot dies for good, another comes back."""
    rng = Random(f"{seed}/delivery trouble")
    dies, returns = rng.sample(range(ROBOTS), 2)
    split_s, dead_s, down_s = (rng.uniform(4.0, 50.0) for _ in range(3))
    island = rng.sample(range(ROBOTS), 2)
    rest = [slot for slot in range(ROBOTS) if slot not in island]
    faults: list[dict[str, Any]] = [
        {"at_s": split_s, "kind": "partition", "islands": [island, rest]},
        {"at_s": split_s + rng.uniform(5.0, 60.0), "kind": "heal"},
        {"at_s": dead_s, "kind": "crash", "robot": dies},
        {"at_s": down_s, "kind": "crash", "robot": returns},
        {"at_s": down_s + rng.uniform(1.0, 40.0), "kind": "restart", "robot": returns},
    ]
    document = {
        "name": "trouble", "mission": "delivery", "fault": faults,
        "warehouse": {
            "map": warehouse(2, 3, 4, 1, 2, 3), "random_tasks": 10, "random_over_s": 30.0 * (seed % 2),
            "handle_s": 1.0, "bays": [[0.5, 0.5], [0.5, 8.5]], "boxes_a_minute": 4.0,
            "boxes_until_s": 60.0, "box_s": 10.0,
        },
        "battery": {"range_m": 80.0, "charge_s": 15.0, "dock_s": 2.0},
        "bus": {"loss": 0.05},
        "fleet": {
            "robots": ROBOTS, "radius_m": 0.3, "speed_m_s": 1.0, "acceleration_m_s2": 2.0,
            "silence": "continue",
        },
        "run": {"seed": seed, "time_limit_s": 600.0},
    }  # fmt: skip
    return WarehouseScenario.model_validate(document)
