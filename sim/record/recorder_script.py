"""Records a simulated run, five times a second: the intent of each robot, and the obstacles."""

from collections.abc import Sequence
from typing import Any, Protocol

from agent.interface.effects import Effect
from sim.fleet.scheduler import Script
from sim.fleet.simulated_fleet import Cluster
from sim.record.robot_intent import intent_of
from sim.world.walls import FREE

EVERY_US = 200_000


class RecordingSink(Protocol):
    """What takes intents and obstacles while a run goes on: memory, or an MCAP file."""

    def tell(self, t_us: int, intent: dict[str, Any]) -> None:
        """Keep the intent of one robot, see `sim.record.robot_intent`."""

    def place(self, t_us: int, rows: list[list[float]]) -> None:
        """Keep the obstacles that stand from `t_us` on: rows of `sim.world.walls`, metres."""


def watch(cluster: Cluster, keepers: Sequence[RecordingSink]) -> None:
    """Pass this to a run as `attach`. It only reads, so the run is the same with and without it."""
    cluster.host.spawn(_look(cluster, keepers))
    writers = [keeper.effect for keeper in keepers if hasattr(keeper, "effect")]
    record = cluster.record

    def both(slot: int, now_us: int, effect: Effect) -> None:
        if record is not None:
            record(slot, now_us, effect)
        for write in writers:
            write(slot, now_us, effect)

    if writers:
        cluster.record = both


def _look(cluster: Cluster, keepers: Sequence[RecordingSink]) -> Script[None]:
    standing: list[list[float]] = []
    while True:
        now_us = cluster.host.now_us()
        for robot in cluster.running:
            intent = intent_of(robot.peer)
            if intent is not None:
                plain = intent.to_dict()
                for keeper in keepers:
                    keeper.tell(now_us, plain)
        rows = [row for row in cluster.world.obstacles() if row[0] != FREE]
        if rows != standing:
            standing = rows
            for keeper in keepers:
                keeper.place(now_us, rows)
        yield now_us + EVERY_US
