"""Problems for planners, and rounds of planning on a wire that loses, delays nothing, and has deaths."""

from random import Random

import numpy as np
import pytest

from agent.delivery import plan_negotiation as plan_round
from agent.delivery.cost_matrix import Carrier, CostMatrix, Trip, workload
from agent.delivery.plan_negotiation import (
    SLICE_US,
    NegotiationPhase,
    PlanNegotiation,
    ProblemSnapshot,
)
from agent.delivery.routing_problem import Workload
from agent.mapping.building import Floor
from agent.paths.nav_mesh import Mesh
from protocol.frames.delivery_frames import PlanRow

MAP = "\n".join(["." * 14, "." * 3 + "#" * 8 + "." * 3] * 4 + ["." * 14])
ROWS = (0, 2, 4, 6, 8)


def short_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fixture for those who judge what rounds do, not how good a plan is: as many slices in as much
    time, a twentieth of the tries in each."""
    for name in ("SLICE_MOVES", "SLICE_MOVES_CHARGING", "SLICE_MOVES_HASTE"):
        monkeypatch.setattr(plan_round, name, getattr(plan_round, name) // 20)


def _costs() -> CostMatrix:
    floor = Floor.drawn(MAP, 1.0, 0.3)
    return CostMatrix(Mesh(floor.inflated, floor.origin, floor.fine_m))


COSTS = _costs()


def trips(count: int, rng: np.random.Generator) -> list[Trip]:
    def place() -> tuple[float, float]:
        return float(rng.integers(14)) + 0.5, float(rng.choice(ROWS)) + 0.5

    return [Trip(place(), place()) for _ in range(count)]


def random_work(robots: int, tasks: int, seed: int) -> Workload:
    rng = np.random.default_rng(seed)
    starts = [trip.pickup for trip in trips(robots, rng)]
    return workload(COSTS, Carrier(1.0, 2.0), trips(tasks, rng), starts, [0] * robots)


def frozen(robots: int, tasks: int, seed: int) -> ProblemSnapshot:
    rng = np.random.default_rng(seed)
    lead = rng.integers(1_000, 60_000, (robots, tasks))
    link = rng.integers(1_000, 60_000, (tasks, tasks))
    return ProblemSnapshot(
        tuple(range(robots)), tuple(100 + t for t in range(tasks)),
        Workload(np.zeros(robots, dtype=np.int64), lead, link),
    )  # fmt: skip


def play(
    robots: int,
    loss: float,
    seed: int,
    dies_streaming: bool = False,
    problem: ProblemSnapshot | None = None,
    number: int = 0,
) -> list[PlanNegotiation]:
    """Until all are at rest; those that live. `number`: of the last round that the caller knows."""
    print(f"seed {seed}")
    rng = Random(seed)
    problem = frozen(robots, 12, seed) if problem is None else problem
    peers = {slot: PlanNegotiation(slot, seed + slot) for slot in range(robots)}
    peers[0].number = number
    peers[0].call(problem, 1_000_000, 0)
    now_us = 0
    for _ in range(400):
        now_us += SLICE_US
        for slot, peer in list(peers.items()):
            peer.on_tick(now_us)
            for said in list(peer.outgoing(now_us)):
                if dies_streaming and isinstance(said, PlanRow):
                    del peers[slot]
                    dies_streaming = False
                    break
                for other_slot, other in peers.items():
                    if other_slot == slot or rng.random() < loss:
                        continue
                    if not isinstance(said, PlanRow) and other.wanted(said):
                        other.join(said, problem, now_us)
                    else:
                        other.on_message(slot, said, now_us)
        if all(peer.phase is NegotiationPhase.REST for peer in peers.values()):
            break
    return list(peers.values())
