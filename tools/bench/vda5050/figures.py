"""The figures of the door to VDA 5050."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from sim.scenarios.delivery_scenario import load_warehouse
from sim.world.drive_trains import Chassis
from tools.bench.figure import Figure
from tools.bench.standing_bodies import standing
from tools.bench.stopped_beats import BUS_BOUND_MS
from tools.bench.systems import ADDED_MS
from tools.bench.vda5050 import masters_actions, masters_orders, own_vehicles, stop_latency
from tools.bench.vda5050.counterparts import PACKAGE, node_folder

AGAINST = f"{PACKAGE}, mosquitto, official schemas of 2.1"
ORDERS, ORDERS_QUICK = 50, 4
VEHICLES = 20


def figures(quick: bool) -> Iterator[Figure]:
    """Orders of a master, vehicles without a master, and stops from both sides."""
    with TemporaryDirectory(prefix="headland-vda5050-") as folder:
        node = node_folder(Path(folder))
        yield from _master(Path(folder), node, quick)
        if not quick:  # the start of peers and vehicles alone takes most of a minute
            yield from _actions(Path(folder), node)
            yield from _vehicles(Path(folder), node)
            yield from _stops(Path(folder), node)


def _master(folder: Path, node: Path, quick: bool) -> Iterator[Figure]:
    orders = ORDERS_QUICK if quick else ORDERS
    place = folder / "master"
    place.mkdir()
    told = asyncio.run(masters_orders.trial(place, node, orders, deaths=not quick))
    deaths = (
        "nothing is killed" if quick else "broker killed twice, two robots and the gateway killed"
    )
    scope = f"{orders} orders, {masters_orders.ROBOTS} robots as processes; {deaths}"
    yield _exactly(
        "VDA 5050: orders of a master delivered once", told.delivered_once, orders, scope
    )
    yield _exactly(
        "VDA 5050: orders that the master knows as done", len(set(told.done)), orders, scope
    )
    flawed = sum(told.flaws.values()) + len(told.dropped)
    count = sum(told.messages.values())
    yield _exactly(
        "VDA 5050: messages to a master that are not valid", flawed, 0, f"of {count}; {scope}"
    )


def _actions(folder: Path, node: Path) -> Iterator[Figure]:
    place = folder / "actions"
    place.mkdir()
    told = asyncio.run(masters_actions.trial(place, node))
    scope = (
        "startPause, stopPause of two robots; cancelOrder before the pick, and with a parcel aboard"
    )
    yield _exactly(
        "VDA 5050: instant actions and orders of a master that end as the standard says",
        told.as_wanted, len(masters_actions.WANTED), scope,
    )  # fmt: skip
    yield _exactly(
        "VDA 5050: parcels delivered of orders that were not taken back", told.delivered,
        masters_actions.DELIVERED, scope,
    )  # fmt: skip


def _vehicles(folder: Path, node: Path) -> Iterator[Figure]:
    place = folder / "vehicles"
    place.mkdir()
    told = asyncio.run(own_vehicles.trial(place, node, VEHICLES))
    scope = (
        f"{VEHICLES} virtual AGVs as bodies, peers in {own_vehicles.GROUPS} processes; "
        "master and gateway killed for good, broker once, half of the peers once"
    )
    once = told.delivered_once
    yield _exactly(
        "VDA 5050: tasks that vehicles without a master delivered once", once, told.ordered, scope
    )
    flawed, count = sum(told.flaws.values()), sum(told.messages.values())
    yield _exactly(
        "VDA 5050: messages to vehicles that are not valid", flawed, 0, f"of {count}; {scope}"
    )
    least_m = 2 * own_vehicles.RADIUS_M
    yield Figure(
        "VDA 5050: least distance of two vehicles", told.closest_m, "m", f">= {least_m:g}",
        told.closest_m >= least_m, AGAINST, f"by their own places; {scope}",
    )  # fmt: skip


def _stops(folder: Path, node: Path) -> Iterator[Figure]:
    place = folder / "stops"
    place.mkdir()
    told = asyncio.run(stop_latency.trial(place, node))
    limit_ms, robots = BUS_BOUND_MS + ADDED_MS, masters_orders.ROBOTS
    for side, times in told.latched_ms.items():
        yield Figure(
            f"VDA 5050: stop {side}, last robot latched", max(times), "ms", f"<= {limit_ms:g}",
            max(times) <= limit_ms, AGAINST,
            f"longest of {len(times)}, to the beat that says it; bound of the bus "
            f"{BUS_BOUND_MS:g} ms; {robots} robots as processes",
        )  # fmt: skip
    fleet = load_warehouse(str(place / "yard.toml")).fleet
    braking_ms = 1000 * fleet.speed_m_s / Chassis().braking_m_s2
    yield from standing("VDA 5050", [*told.bodies.items()], robots, braking_ms, AGAINST)


def _exactly(name: str, value: int, target: int, scope: str) -> Figure:
    return Figure(name, float(value), "", f"= {target}", value == target, AGAINST, scope)
