"""A small warehouse with random faults from a seed: everything that may go wrong with parcels.

`bad_luck` mixes troubles; `TROUBLES` are single ones. To play more seeds than the bench does, run
`python -m tools.bench.delivery_trouble --kinds split,freeze --seeds 0:20 --out results.jsonl`, which
continues where it stopped.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

from agent.interface.config import S
from sim.runs.delivery_fleet import DeliveryFleet
from sim.runs.delivery_run import DeliveryOutcome, DeliveryRun
from sim.scenarios.building_generator import warehouse
from sim.scenarios.delivery_scenario import DeliveryScenario
from sim.scenarios.delivery_setup import DeliverySetup

ROBOTS = 4
CALM_S = 60.0  # boxes fall until then
MIXED = "mixed"
Faults = list[dict[str, Any]]
Draw = Callable[[Random], Faults]


def bad_luck(seed: int) -> DeliveryScenario:
    """Lost frames all the time; a split that heals; one robot dies for good, another comes back."""
    rng = Random(f"{seed}/delivery trouble")
    dies, returns = rng.sample(range(ROBOTS), 2)
    split_s, dead_s, down_s = (rng.uniform(4.0, 50.0) for _ in range(3))
    island = rng.sample(range(ROBOTS), 2)
    rest = [slot for slot in range(ROBOTS) if slot not in island]
    faults: Faults = [
        {"at_s": split_s, "kind": "partition", "islands": [island, rest]},
        {"at_s": split_s + rng.uniform(5.0, 60.0), "kind": "heal"},
        {"at_s": dead_s, "kind": "crash", "robot": dies},
        {"at_s": down_s, "kind": "crash", "robot": returns},
        {"at_s": down_s + rng.uniform(1.0, 40.0), "kind": "restart", "robot": returns},
    ]
    return scenario("trouble", seed, faults, boxes=4.0, loss=0.05)


def scenario(
    name: str, seed: int, faults: Faults, boxes: float = 0.0, loss: float = 0.0,
    outage: Faults | None = None,
) -> DeliveryScenario:  # fmt: skip
    """A small warehouse with these faults. `boxes` is a number a minute, `loss` a share of all
    frames from 0 to 1."""
    document = {
        "name": name, "mission": "delivery", "fault": faults,
        "warehouse": {
            "map": warehouse(2, 3, 4, 1, 2, 3), "random_tasks": 10, "random_over_s": 30.0 * (seed % 2),
            "handle_s": 1.0, "bays": [[0.5, 0.5], [0.5, 8.5]], "boxes_a_minute": boxes,
            "boxes_until_s": CALM_S, "box_s": 10.0, "outage": outage or [],
        },
        "battery": {"range_m": 80.0, "charge_s": 15.0, "dock_s": 2.0},
        "bus": {"loss": loss},
        "fleet": {
            "robots": ROBOTS, "radius_m": 0.3, "speed_m_s": 1.0, "acceleration_m_s2": 2.0,
            "silence": "continue",
        },
        "run": {"seed": seed, "time_limit_s": 600.0},
    }  # fmt: skip
    return DeliveryScenario.model_validate(document)


def _one_way(rng: Random, heals: bool = True) -> Faults:
    """Some robots do not hear some others, but the others hear them."""
    at_s = rng.uniform(2.0, 40.0)
    pairs = rng.sample([(a, b) for a in range(ROBOTS) for b in range(ROBOTS) if a != b], 3)
    cuts: Faults = [
        {"at_s": at_s, "kind": "one_way", "sender": a, "receiver": b}
        for a, b in pairs[: rng.randint(1, 3)]
    ]
    healed_s = at_s + rng.uniform(2.0, 60.0)
    return cuts + ([{"at_s": healed_s, "kind": "heal"}] if heals else [])


def _split(rng: Random) -> Faults:
    slots = rng.sample(range(ROBOTS), ROBOTS)
    at_s, size = rng.uniform(2.0, 50.0), rng.randint(1, ROBOTS - 1)
    healed_s = at_s + rng.choice((0.5, 5.0, 30.0, 90.0))
    return [
        {"at_s": at_s, "kind": "partition", "islands": [slots[:size], slots[size:]]},
        {"at_s": healed_s, "kind": "heal"},
    ]


def _restart(*disks: str) -> Draw:
    def draw(rng: Random) -> Faults:
        robot, at_s = rng.randrange(ROBOTS), rng.uniform(2.0, 60.0)
        back: dict[str, Any] = {
            "at_s": at_s + rng.uniform(0.05, 40.0), "kind": "restart", "robot": robot,
        }  # fmt: skip
        found = [
            {"at_s": at_s, "kind": "crash", "robot": robot},
            back | {"disk": rng.choice(disks)},
        ]
        if "lost" in disks and rng.random() < 0.5:  # a robot without its memory waits for a person
            found.append({"at_s": back["at_s"] + rng.uniform(5.0, 60.0), "kind": "reset"})
        return found

    return draw


def _freezes(rng: Random) -> Faults:
    return [
        {"at_s": rng.uniform(2.0, 60.0), "kind": "freeze", "robot": rng.randrange(ROBOTS),
         "for_s": rng.choice((0.3, 1.0, 8.0, 30.0))}
        for _ in range(3)
    ]  # fmt: skip


def _pushes(rng: Random) -> Faults:
    return [
        {"at_s": rng.uniform(2.0, 60.0), "kind": "pushed", "robot": rng.randrange(ROBOTS),
         "dx_m": rng.uniform(-4.0, 4.0), "dy_m": rng.uniform(-4.0, 4.0)}
        for _ in range(4)
    ]  # fmt: skip


def _none(rng: Random) -> Faults:
    return []


TROUBLES: dict[str, Draw] = {
    "loss": _none,  # 10 to 30 % of all frames, in each receiver by itself
    "one way": _one_way,
    "deaf": lambda rng: _one_way(rng, heals=False),
    "split": _split,
    "carrier": _none,  # one that has a parcel aboard dies for good
    "restart": _restart("kept", "torn"),
    "no disk": _restart("lost"),  # a person lets it go on in every other run
    "freeze": _freezes,
    "charger": _none,  # one of two bays gives nothing any more
    "pushed": _pushes,
    "boxes": _none,  # twelve a minute, for ten seconds each
}


class CarrierDies:
    """Power off for the first robot that has a parcel aboard from a time on."""

    def __init__(self, at_s: float) -> None:
        self.at_us, self.killed = round(at_s * S), False

    def __call__(self, cluster: DeliveryFleet) -> None:
        if self.killed or cluster.host.now_us() < self.at_us:
            return
        aboard = [slot for slot in sorted(cluster.truth.aboard) if cluster.is_up(slot)]
        if aboard:
            self.killed = True
            cluster.kill(aboard[0])


def troubled(kind: str, seed: int) -> DeliveryRun:
    """A run with one trouble, or with all of `bad_luck`."""
    if kind == MIXED:
        return DeliveryRun(DeliverySetup(bad_luck(seed)))
    rng = Random(f"{seed}/{kind}")
    outage: Faults = []
    if kind == "charger":
        outage = [{"bay": rng.randrange(2), "at_s": rng.uniform(0.0, 60.0)}]
    loss = rng.uniform(0.1, 0.3) if kind == "loss" else 0.0
    given = scenario(
        kind, seed, TROUBLES[kind](rng), 12.0 if kind == "boxes" else 0.0, loss, outage
    )
    watch = CarrierDies(rng.uniform(2.0, 60.0)) if kind == "carrier" else None
    run = DeliveryRun(DeliverySetup(given))
    run.watch = watch
    return run


def told(kind: str, seed: int, outcome: DeliveryOutcome) -> dict[str, Any]:
    """One line of the results."""
    return {
        "kind": kind, "seed": seed, "finished": outcome.finished, "flaws": dict(outcome.flaws),
        "contacts": outcome.contacts, "empty": outcome.empty, "delivered": outcome.delivered,
        "tasks": outcome.tasks, "makespan_s": round(outcome.makespan_s, 1),
        "simulated_s": round(outcome.simulated_s, 1), "unreachable": outcome.unreachable,
        "hash": outcome.trace_hash,
    }  # fmt: skip


def main() -> None:
    """Play the kinds and seeds that the command line names, and append a line of JSON for each to
    the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", default=",".join(TROUBLES), help=f"troubles, or {MIXED}")
    parser.add_argument("--seeds", default="0:20", help="FIRST:END")
    parser.add_argument(
        "--out", type=Path, required=True, help="JSON lines; those in it are not run"
    )
    asked = parser.parse_args()
    first, end = (int(part) for part in asked.seeds.split(":"))
    lines = asked.out.read_text().splitlines() if asked.out.exists() else []
    known = {(row["kind"], row["seed"]) for row in map(json.loads, lines)}
    for seed in range(first, end):
        for kind in asked.kinds.split(","):
            if (kind, seed) in known:
                continue
            outcome = troubled(kind, seed).run()
            with asked.out.open("a") as out:
                out.write(json.dumps(told(kind, seed, outcome)) + "\n")


if __name__ == "__main__":
    main()
