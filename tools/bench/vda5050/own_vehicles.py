"""Vehicles of an independent implementation as the bodies of peers, whose master is killed for good.

A master orders from the fleet, by `headland vda5050`. Then it and the gateway are killed, the broker is
killed and started again, and one process of peers is killed and started again. What the vehicles did is
read from the vehicles.
"""

import asyncio
import json
from asyncio.subprocess import PIPE, STDOUT, Process
from collections import Counter
from contextlib import suppress
from math import hypot
from pathlib import Path
from typing import Any, NamedTuple

from agent.delivery.task_registry import TransportTask
from agent.runtime.vda5050.messages import Topic
from sim.scenarios.delivery_setup import DeliverySetup
from tools.bench.vda5050.counterparts import (
    WAIT_S,
    Mosquitto,
    NodeProgram,
    Witness,
    drain,
    end,
    free_port,
    said,
    start,
)
from tools.bench.vda5050.many_robots import MANUFACTURER
from tools.common.child_process import module_command
from tools.run.launch_setup import setting_of

SPEED_M_S = 0.8
RADIUS_M = 0.35
REACH_M = 1.25  # of an arm, and a step of the place in a message
RUN_S = 900.0  # four vehicles need 100 s, and 20 of them less than 600
GROUPS = 2  # processes that share the peers


class OwnVehicles(NamedTuple):
    """What vehicles did without a master."""

    ordered: int
    handled: dict[str, tuple[int, int]]  # by task: how often it was picked, and dropped
    misplaced: list[str]  # tasks that were dropped elsewhere
    closest_m: float  # between the middles of two vehicles, as they say
    flaws: dict[str, int]  # of what the robots sent, by the official schemas
    messages: dict[str, int]

    @property
    def delivered_once(self) -> int:
        """Tasks that were picked once and dropped once, at their places."""
        once = [task for task, count in self.handled.items() if count == (1, 1)]
        return len(set(once) - set(self.misplaced))


def scenario_of(vehicles: int) -> str:
    """A hall with room for so many."""
    drawing = "\n".join(["." * max(12, 2 * vehicles)] * 12)
    return f"""
name = "hall"
mission = "delivery"
[warehouse]
map = '''
{drawing}
'''
handle_s = 1.0
[fleet]
robots = {vehicles}
speed_m_s = {SPEED_M_S}
acceleration_m_s2 = 1.0
radius_m = {RADIUS_M}
"""


async def _robots(folder: Path, port: int, url: str, slots: list[int]) -> Process:
    words = ("hall.toml", str(port), url, str(folder / "journal"), ",".join(map(str, slots)))
    return await asyncio.create_subprocess_exec(
        *module_command("tools.bench.vda5050.many_robots"), *words,
        cwd=folder, stdout=PIPE, stderr=STDOUT,
    )  # fmt: skip


async def _up(process: Process, slots: list[int]) -> "asyncio.Task[None]":
    for _ in slots:
        await said(process, r"up (\d+)")
    return asyncio.create_task(drain(process))


async def trial(folder: Path, node: Path, vehicles: int, deaths: bool = True) -> OwnVehicles:
    """One order for each vehicle; then the master is killed for good."""
    (folder / "hall.toml").write_text(scenario_of(vehicles))
    (folder / "journal").mkdir()
    setting = setting_of(str(folder / "hall.toml"), None, None, None)
    assert isinstance(setting, DeliverySetup)
    cells = [list(setting.cells[k * len(setting.cells) // 37]) for k in range(37)]
    broker, agvs, master = Mosquitto(folder), NodeProgram(), NodeProgram()
    await broker.start()
    port = free_port()
    hub = await start(folder, "hub", "--port", str(port))
    slots = [list(range(k, vehicles, GROUPS)) for k in range(GROUPS)]
    groups: list[Process] = []
    gateway: Process | None = None
    reading: list[asyncio.Task[None]] = []
    orders, seen = Witness(broker, MANUFACTURER, as_vehicle=False), _Distances(broker)
    try:
        starts = json.dumps([list(place) for place in setting.starts])
        await agvs.start(node, "vehicles.js", broker.url, "hall", starts, str(SPEED_M_S))
        await agvs.until(lambda events: any("started" in e for e in events), WAIT_S)
        await said(hub, r"(socketcand)")
        reading.append(asyncio.create_task(drain(hub)))
        for mine in slots:
            groups.append(await _robots(folder, port, broker.url, mine))
        for group, mine in zip(groups, slots, strict=True):
            reading.append(await _up(group, mine))
        words = ("--broker", broker.url, "--scenario", "hall.toml", "--port", str(port))
        gateway = await start(folder, "vda5050", *words, "--book", "book.jsonl")
        await master.start(
            node, "master.js", broker.url, "0", str(vehicles), "hall", json.dumps(cells)
        )
        book = folder / "book.jsonl"
        async with asyncio.timeout(RUN_S):
            while not book.exists() or len(_tasks(book)) < vehicles:
                await said(gateway, r"(is task)")
        tasks = _tasks(book)

        def drops(events: list[dict[str, Any]]) -> int:
            return sum("drop" in event for event in events)

        if deaths:
            await agvs.until(lambda events: any("pick" in e for e in events), RUN_S)
        await master.kill()  # for good
        gateway.kill()
        await gateway.wait()
        if deaths:
            await broker.kill()
            await broker.start()
            await agvs.until(lambda events: drops(events) >= vehicles // 4, RUN_S)
            groups[0].kill()
            await groups[0].wait()
            groups[0] = await _robots(folder, port, broker.url, slots[0])
            reading.append(await _up(groups[0], slots[0]))
        with suppress(TimeoutError):  # what was delivered until then is the result
            await agvs.until(lambda events: drops(events) >= vehicles, RUN_S)
    finally:
        await end(gateway)
        await master.kill()
        for process in (*groups, hub):
            await _ended(process)
        await agvs.kill()
        await orders.close()
        await seen.close()
        await broker.kill()
    return _judged(setting, tasks, agvs.events, seen.closest_m, orders)


async def _ended(process: Process) -> None:
    if process.returncode is None:
        process.terminate()
        await process.wait()


def _tasks(book: Path) -> dict[int, TransportTask]:
    """Of the gateway's book: number and cells of each order."""
    said_ = [json.loads(line) for line in book.read_text().splitlines()]
    return {row["number"]: TransportTask(*row["task"]) for row in said_ if row["task"]}


def _judged(
    setting: DeliverySetup, tasks: dict[int, TransportTask], events: list[dict[str, Any]],
    closest_m: float, orders: Witness,
) -> OwnVehicles:  # fmt: skip
    picks, drops = Counter[str](), Counter[str]()
    misplaced = []
    for event in events:
        for kind, counts, end_ in (("pick", picks, 0), ("drop", drops, 1)):
            if kind not in event:
                continue
            counts[event[kind]] += 1
            place = setting.house.place(tasks[int(event[kind].removeprefix("task "))][end_])
            if hypot(place[0] - event["x"], place[1] - event["y"]) > REACH_M:
                misplaced.append(event[kind])
    handled = {name: (picks[name], drops[name]) for name in (f"task {n}" for n in tasks)}
    return OwnVehicles(
        len(tasks), handled, misplaced, closest_m, dict(orders.flaws), dict(orders.counts)
    )


class _Distances(Witness):
    """How near vehicles came to each other, by what they say themselves."""

    def __init__(self, broker: Mosquitto) -> None:
        self.closest_m = float("inf")
        self.places: dict[str, tuple[float, float]] = {}
        super().__init__(broker, MANUFACTURER)

    def _hear(self, topic: str, payload: Any) -> None:
        _, _, manufacturer, serial, kind = topic.split("/")
        if manufacturer != MANUFACTURER or kind not in (Topic.VISUALIZATION, Topic.STATE):
            return
        at = json.loads(payload).get("agvPosition")
        if at is None:
            return
        x_m, y_m = self.places[serial] = at["x"], at["y"]
        others = (place for name, place in self.places.items() if name != serial)
        gaps = [hypot(x_m - a_m, y_m - b_m) for a_m, b_m in others]
        self.closest_m = min([self.closest_m, *gaps])
