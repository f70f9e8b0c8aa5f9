"""The truth about parcels and batteries, whatever robots believe: positions and handling.

A parcel lies somewhere or is aboard one robot; it can never be in two places. The judged rules are:
each parcel is delivered once and never moved again, none is lost, and no battery is ever empty.
"""

from collections.abc import Callable, Sequence
from math import dist, hypot
from typing import Any, NamedTuple

from agent.delivery.cost_matrix import Carrier
from agent.delivery.delivery_mission import REACH_M
from agent.interface.config import S
from agent.interface.effects import HALT, GatedDrive
from agent.interface.geometry import Point
from agent.interface.observation import Observation, VisibleParcel
from agent.interface.ports import Body

STILL_M_S = 0.1  # a robot handles parcels and charges only while slower than this
# The tables in `to_plain`, by task or by slot: key in the file, and attribute.
KEPT = {
    "lies": "lies", "aboard": "aboard", "dropoff": "dropoff", "delivered_us": "delivered_at_us",
    "appeared_us": "appeared_at_us", "battery": "battery", "lowest": "lowest",
}  # fmt: skip
BAY_M = 0.5  # reach of the contacts from a bay's middle


class Handled(NamedTuple):
    """What happened to a parcel, and by which robot."""

    t_us: int
    task: int
    slot: int
    what: str  # picked, taken (from a dead robot), put, delivered, again (moved after delivery)


class Bay:
    """A charger bay at a place, which gives power or has failed."""

    def __init__(self, at: Point) -> None:
        self.at, self.works = at, True


class Parcels:
    """Where each parcel really is, how full each battery really is, and a list of everything that
    happened."""

    def __init__(self, carrier: Carrier, bays: Sequence[Point]) -> None:
        self.carrier, self.bays = carrier, [Bay(at) for at in bays]
        self.lies: dict[int, Point] = {}
        self.aboard: dict[int, int] = {}  # slot: task
        self.dropoff: dict[int, Point] = {}
        self.delivered_at_us: dict[int, int] = {}
        self.appeared_at_us: dict[int, int] = {}
        self.events: list[Handled] = []
        self.battery: dict[int, float] = {}
        self.lowest: dict[int, float] = {}
        self.empty: set[int] = set()
        self.is_up: Callable[[int], bool] = lambda slot: True
        self.place_of: Callable[[int], Point] = lambda slot: (0.0, 0.0)

    def to_plain(self) -> dict[str, Any]:
        """The present truth as plain values; see `recall`."""
        kept = {key: sorted(getattr(self, name).items()) for key, name in KEPT.items()}
        return {
            **kept, "events": self.events, "empty": sorted(self.empty),
            "works": [bay.works for bay in self.bays],
        }  # fmt: skip

    def recall(self, said: dict[str, Any]) -> None:
        """Continue from the result of `to_plain`. KeyError, TypeError, ValueError if it is not
        valid."""
        for key, name in KEPT.items():
            known = {
                int(number): tuple(value) if isinstance(value, list) else value
                for number, value in said[key]
            }
            setattr(self, name, known)
        self.events = [Handled(*event) for event in said["events"]]
        self.empty = {int(slot) for slot in said["empty"]}
        for bay, works in zip(self.bays, said["works"], strict=True):
            bay.works = bool(works)

    def appear(self, task: int, pickup: Point, dropoff: Point, now_us: int) -> None:
        """A parcel lies at `pickup` from now on and has to come to `dropoff`; metres. A task that
        is known stays as it is."""
        if task not in self.dropoff:
            self.lies[task], self.dropoff[task] = pickup, dropoff
            self.appeared_at_us[task] = now_us

    def seen(self, slot: int, at: Point) -> dict[int, VisibleParcel]:
        """Parcels within reach of a robot at `at`, metres, by task: those on the floor, and those
        aboard dead robots."""
        found = {
            task: VisibleParcel(*place, False)
            for task, place in self.lies.items()
            if dist(place, at) < REACH_M
        }
        for other, task in self.aboard.items():
            if other != slot and not self.is_up(other):
                place = self.place_of(other)
                if dist(place, at) < REACH_M:
                    found[task] = VisibleParcel(*place, True)
        return found

    def handle(self, slot: int, task: int, at: Point, now_us: int) -> None:
        """Complete the action of the arm of a robot at `at`, metres: put down its parcel, or pick
        up one within reach."""
        own = self.aboard.get(slot)
        if own == task:
            del self.aboard[slot]
            self.lies[task] = at
            there = dist(at, self.dropoff[task]) < REACH_M
            self.events.append(Handled(now_us, task, slot, "delivered" if there else "put"))
            if there:
                self.delivered_at_us.setdefault(task, now_us)
        elif own is None and task in self.seen(slot, at):
            was = next((s for s, t in self.aboard.items() if t == task), None)
            what = "picked" if was is None else "taken"
            if was is not None:
                del self.aboard[was]
            else:
                del self.lies[task]
            if task in self.delivered_at_us:
                what = "again"
            self.aboard[slot] = task
            self.events.append(Handled(now_us, task, slot, what))

    def drain(self, slot: int, metres: float, seconds: float, at: Point, still: bool) -> float:
        """The charge left in a battery after driving `metres` in `seconds`, as a share of 0 to 1.

        A robot that stands still within a working bay, by its place `at` in metres, is charged
        instead.
        """
        left, carrier = self.battery.setdefault(slot, 1.0), self.carrier
        if not carrier.runs_dry:
            return 1.0
        bay = next((b for b in self.bays if b.works and dist(b.at, at) < BAY_M), None)
        if bay is not None and still:
            left += seconds / (carrier.dock_s + carrier.charge_s)
        else:
            left -= metres / carrier.battery_m if carrier.battery_m else 0.0
            left -= seconds / carrier.battery_s if carrier.battery_s else 0.0
        left = min(max(left, 0.0), 1.0)
        self.battery[slot] = left
        self.lowest[slot] = min(self.lowest.get(slot, 1.0), left)
        if left == 0.0:
            self.empty.add(slot)
        return left

    @property
    def flaws(self) -> dict[str, int]:
        """Deliveries done twice; parcels that are nowhere; parcels moved after delivery."""
        delivered = [e.task for e in self.events if e.what == "delivered"]
        aboard = list(self.aboard.values())
        return {
            "twice": len(delivered) - len(set(delivered)),
            "lost": sum(task not in self.lies and task not in aboard for task in self.dropoff),
            "by_two": len(aboard) - len(set(aboard)),
            "again": sum(e.what == "again" for e in self.events),
        }


class CarrierBody:
    """A body with an arm and a battery, between its peer and the world's body."""

    def __init__(self, body: Body, slot: int, parcels: Parcels, now_us: Callable[[], int]) -> None:
        self._body, self._slot, self._parcels, self._now_us = body, slot, parcels, now_us
        self._last: Observation | None = None
        self._last_at_us = now_us()
        self._arm: tuple[int, int] | None = None  # parcel, and since when

    def sense(self, now_us: int) -> Observation | None:
        """What the body senses, with the charge of its battery, its load, and the parcels within
        reach."""
        seen = self._body.sense(now_us)
        if seen is None:
            return None
        t_us, at = self._now_us(), (seen.x_m, seen.y_m)
        still = hypot(seen.vx_m_s, seen.vy_m_s) < STILL_M_S
        metres = 0.0 if self._last is None else dist(at, (self._last.x_m, self._last.y_m))
        left = self._parcels.drain(self._slot, metres, (t_us - self._last_at_us) / S, at, still)
        self._last, self._last_at_us = seen, t_us
        if not still:
            self._arm = None
        load = self._parcels.aboard.get(self._slot, -1)
        return seen._replace(battery=left, load=load, parcels=self._parcels.seen(self._slot, at))

    def drive(self, command: GatedDrive, now_us: int) -> None:
        """Pass the command on, unless the battery is empty; move the arm for as long as the command
        asks for it."""
        if self._parcels.battery.get(self._slot, 1.0) == 0.0 and self._parcels.carrier.runs_dry:
            command = HALT
        self._body.drive(command, now_us)
        t_us = self._now_us()
        if command.parcel_action < 0 or self._last is None:
            self._arm = None
        elif self._arm is None or self._arm[0] != command.parcel_action:
            self._arm = (command.parcel_action, t_us)
        elif t_us - self._arm[1] >= self._parcels.carrier.handle_s * S:
            self._arm = None
            at = (self._last.x_m, self._last.y_m)
            self._parcels.handle(self._slot, command.parcel_action, at, t_us)
