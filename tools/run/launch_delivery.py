"""`headland launch` of a warehouse: each robot a process, in a world with parcels, arms, batteries.

Transports may be ordered at any time, so it goes on until it is ended, by Ctrl-C or `--seconds`.
"""

import asyncio
from math import isfinite

from agent.delivery.cost_matrix import Trip
from agent.delivery.task_outcome import outcome_of
from agent.delivery.task_registry import TASKS_MAX, TransportTask
from agent.runtime.files.key_file import FLEET
from crdt import Phase
from protocol.frames.frame import Frame
from protocol.frames.messages import Message
from sim.fleet.scheduler import follow
from sim.fleet.warehouse_floor import WarehouseFloor, beyond_battery
from sim.record.remote_body import BodyServer
from sim.scenarios.delivery_setup import DeliverySetup
from sim.world.parcel_truth import CarrierBody, Parcels
from tools.common.counted import counted
from tools.operate.order_proofs import FileProofs
from tools.operate.tool_address import DeviceAddress
from tools.run.launch import Launch
from tools.run.launch_bus import LaunchBus


class _Desk:
    """The bus of the launch, as a device speaks on it."""

    def __init__(self, bus: LaunchBus) -> None:
        self.bus = bus

    def send(self, frame: Frame) -> bool:
        self.bus.say(frame)
        return True


class HaulLaunch(Launch):
    """A launch whose world has parcels and chargers, and which takes orders until a person ends it."""

    floor: WarehouseFloor
    endless = True

    def _furnish(self, bodies: BodyServer, bus: LaunchBus) -> list["asyncio.Task[None]"]:
        assert isinstance(self.setting, DeliverySetup)

        loop = asyncio.get_running_loop()
        proofs = self._proofs()
        desk = DeviceAddress(_Desk(bus), proofs=proofs)

        def say(message: Message) -> None:
            desk.send(message)

        bus.taps.append(lambda t_us, frame: desk.hear(loop.time(), frame))
        if self.world_began_us:
            self.floor.recall(self.world_began_us)
        self.floor.now_us, self.floor.say = bodies.now_us, say
        bus.taps.append(lambda t_us, frame: self.floor.hear(bodies.now_us(), frame))
        carriers = {
            slot: CarrierBody(self.world.body(slot), slot, self.floor.truth, bodies.now_us)
            for slot in self.world.robots
        }
        bodies.body = carriers.__getitem__
        scripts = [self.floor.calls(), *self.floor.events()]
        return [asyncio.create_task(follow(script, bodies.zero_at_us)) for script in scripts]

    def _proofs(self) -> FileProofs | None:
        """Under the owner's key, as the file of the fleet has it now."""
        scenario = self.setting.scenario
        if self.setting.keys is None:
            return None
        assert scenario.fleet.keys is not None, "keys come from a file"
        return FileProofs(scenario.folder / scenario.fleet.keys, FLEET, self.console.print)

    def _sections(self) -> frozenset[int]:
        """Tasks come while it goes on."""
        return frozenset()

    def _parcels(self) -> Parcels:
        assert isinstance(self.setting, DeliverySetup)

        def unsaid(message: Message) -> None:
            """Nobody orders before the bus is there."""

        self.floor = WarehouseFloor(self.setting, self.world, lambda: 0, self._is_up, unsaid)
        return self.floor.truth

    def _is_up(self, slot: int) -> bool:
        process = self.processes.get(slot)
        return process is not None and process.returncode is None

    @property
    def flawed(self) -> bool:
        """Whether a parcel was mishandled, a battery ran empty, or a body touched something."""
        truth = self.floor.truth
        return bool(self.world.contacts or truth.empty or any(truth.flaws.values()))

    def _progress(self) -> tuple[int, int, str]:
        """Parcels, as they lie; those of the scenario that have not come yet count as well."""
        truth = self.floor.truth
        to_do = max(len(truth.dropoff), len(self.floor.setting.rows))
        return len(truth.delivered_at_us), to_do, "parcels"

    def _report(self, elapsed_s: float, finished: bool) -> None:
        truth, allocation = self.floor.truth, self.inspector.allocation
        known = all(allocation.phase_of(task) is Phase.DONE for task in truth.dropoff)
        charges = sum(
            section >= TASKS_MAX and allocation.phase_of(section) is Phase.DONE
            for section in allocation.sections()
        )
        beyond = self._beyond_battery()
        of_it = {
            "tasks": len(truth.dropoff), "delivered": len(truth.delivered_at_us), "known_to_all": known,
            "flaws": truth.flaws, "empty": sorted(truth.empty), "charges": charges,
            "lowest_battery": min(truth.lowest.values(), default=1.0), "beyond_battery": beyond,
        }  # fmt: skip
        if finished and not known:
            self.difference = "every parcel lies at its place, robots do not all say so"
        verdict = (
            f"{len(truth.delivered_at_us)} of {len(truth.dropoff)} parcels delivered, "
            f"{counted(len(self.world.contacts), '{} contact{s}')}"
        )
        if beyond:
            verdict += (
                f", a full battery does not last for {', '.join(f'task {n}' for n in beyond)}"
            )
        self._write(elapsed_s, finished, of_it, verdict)

    def _beyond_battery(self) -> list[int]:
        """Tasks that wait because a battery that is full at any bay does not last for them.

        Found at the end, because the ways are planned in the process that moves the world."""
        assert isinstance(self.setting, DeliverySetup)
        truth, house = self.floor.truth, self.setting.house
        trips = {
            task: Trip(at, truth.dropoff[task])
            for task, at in truth.lies.items()
            if not (task in truth.delivered_at_us or self._is_over(task))
            and isfinite(house.way_m(at, truth.dropoff[task]))
        }
        return sorted(beyond_battery(house, trips))

    def _is_over(self, task: int) -> bool:
        """Also for one that was taken back."""
        heard, order = self.inspector, self.inspector.transports.get(task)
        asked = None if order is None else TransportTask(*order)
        return outcome_of(task, asked, heard.allocation, heard.progress).final
