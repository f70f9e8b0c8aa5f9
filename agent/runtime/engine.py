"""`FleetCoordinationEngine`: the asyncio interface of one peer, with the API of the protocol
document.

    engine = FleetCoordinationEngine("tractor_001", open_bus("socketcan", "can0", 250_000))
    await engine.start()
    if await engine.claim_section("S7"):
        ...
        await engine.release_section("S7")

All frames and decisions come from `agent/peer/peer.py`; this module only adds names, waiting and
callbacks.
"""

import asyncio
import inspect
import logging
from collections.abc import Awaitable, Callable, Mapping
from math import cos, hypot, inf, sin
from random import Random
from secrets import randbits, token_bytes
from typing import Any, NamedTuple

from can import BusABC

from agent.delivery.task_outcome import TaskOutcome, outcome_of
from agent.interface.config import CONTENTION_US, S
from agent.interface.effects import Effect, Trace
from agent.interface.identity import SilencePolicy
from agent.interface.lifecycle import State
from agent.interface.observation import Observation
from agent.interface.ports import Bus, Journal
from agent.peer.inputs import (
    ClaimSection,
    EndRelease,
    Finish,
    Input,
    ManualReset,
    Press,
    ReleaseSection,
    ReleaseStops,
    Sensed,
    Start,
)
from agent.peer.journal_recovery import remembers
from agent.peer.peer import Peer
from agent.peer.self_health import readings
from agent.runtime.peer_factory import clock_zero_at_s, identity_of, keyring_of, make_peer
from agent.runtime.peer_runner import PeerRunner
from agent.runtime.section_names import SectionNames
from agent.safety.stop_cause import Severity, about, sentence
from agent.safety.stop_controller import CREEP_M_S
from crdt import FieldAllocationCRDT, Phase
from protocol.authentication import KEY_SIZE, OPERATOR_FIRST, Keyring, Keys
from protocol.fleet_tags import QUESTION_BITS
from protocol.frames.fleet_frames import NOWHERE_M, Pose
from protocol.frames.safety_frames import Reason
from protocol.links.bus import CanBus
from protocol.name import ON_A_BUS

log = logging.getLogger(__name__)

CLEAR_TIMEOUT_S = 5.0  # two robots of a quiet bus need 0.5 s
CLEAR_STEP_S = 0.15  # robots answer a question about held stops at most every 0.1 s
JOIN_TIMEOUT_S = 5.0  # address claim 0.4 s, a first sync 2 s; beyond it something is wrong


class Cleared(NamedTuple):
    """What a release of stops has done. Machines are named by tractor ids."""

    stops: tuple[str, ...]  # that held this machine, by name
    # Machines that still hold a stop, or have not answered that they hold none.
    holding: tuple[str, ...]
    silent: tuple[str, ...]  # silent members: whether they hold a stop is unknown

    @property
    def complete(self) -> bool:
        """Whether no machine holds a stop, as far as can be known."""
        return not self.holding and not self.silent


class FleetCoordinationEngine:
    """One robot of a fleet, for a program that has its own sensors and wheels.

    All methods must be called on the thread of one asyncio loop. Methods that need a running engine
    raise RuntimeError before `start`.
    """

    def __init__(
        self,
        tractor_id: str,
        isobus_interface: Bus | BusABC,
        *,
        fleet: str = "headland",
        members: int = 30,
        journal: Journal | None = None,
        silence: SilencePolicy = SilencePolicy.STOP,
        seed: int | None = None,
        first_boot: bool = False,
        keys: Keys | None = None,
    ) -> None:
        """`tractor_id`: ends in the fleet slot ("tractor_001" is slot 1). `isobus_interface`: a
        `protocol.links.bus.CanBus` over any python-can interface, a `can.Bus`, or anything with the
        methods of `Bus`. `fleet`: the name that all its robots share. `members`: how many robots it
        has.

        `journal`: durable memory; without one nothing can be lost. `silence`: what ends a stop by
        silence. `seed`: of random delays; None: the slot. `first_boot`: this machine is new.
        Otherwise an empty journal counts as lost, and the robot stays latched until a person resets
        it. `keys`: keys of the fleet; without them any device on the bus can stop and release it.

        Raises TypeError if the interface has not these methods, and ValueError if the id has no
        slot of this fleet.
        """
        self.keys = keys
        self.first_boot = first_boot or journal is None
        if isinstance(isobus_interface, BusABC):
            isobus_interface = CanBus(isobus_interface)
        if not (hasattr(isobus_interface, "send") and hasattr(isobus_interface, "subscribe")):
            raise TypeError(
                "isobus_interface must be a can.Bus, a protocol.links.bus.CanBus, or have its methods; "
                f"not {type(isobus_interface).__name__}"
            )
        self.tractor_id, self.bus, self.journal = tractor_id, isobus_interface, journal
        self._told_of_stop, self._state = False, State.DISCONNECTED.name
        self.refusal = ""  # why the last claim_section was False
        self.fleet, self.members = fleet, members
        digits = tractor_id[len(tractor_id.rstrip("0123456789")) :]
        if not digits or not 0 <= int(digits) < members:
            raise ValueError(
                f"tractor id {tractor_id!r} must end in a slot number below {members}, "
                "for example 'tractor_001'"
            )
        self.prefix, self.width = tractor_id[: -len(digits)], len(digits)
        self.slot, self.silence = int(digits), silence
        self.sections = SectionNames()
        self._rng = Random(self.slot if seed is None else seed)
        self._runner: PeerRunner | None = None
        self._task: asyncio.Task[None] | None = None
        self._changed = asyncio.Event()
        self._on_state: list[Callable[[str], Any]] = []
        self._on_emergency: list[Callable[[dict[str, Any]], Any]] = []
        self._on_leader: list[Callable[[str | None], Any]] = []
        self._led: str | None = None  # the leader last passed to the callbacks
        self._background: set[asyncio.Task[None]] = set()

    # ---------------------------------------------------------------- lifecycle

    async def start(self) -> None:
        """Start the engine and join the fleet; nothing happens if it runs already.

        Raises TimeoutError if no address can be claimed within `JOIN_TIMEOUT_S`, and OSError if the
        journal cannot be read.
        """
        if self._task is not None:
            return
        recalled: Mapping[str, bytes] = self.journal.load() if self.journal else {}
        identity = identity_of(
            self.fleet,
            self.slot,
            self.members,
            FieldAllocationCRDT.hash_of(self.fleet),
            self.silence,
            first_boot=self.first_boot,
            diagnostics=True,
            device=ON_A_BUS,
        )
        if not remembers(recalled) and not self.first_boot:
            self._rng = Random(randbits(64))  # the next incarnation must not be an earlier one
        self.first_boot = self.journal is None
        now_us, lot = PeerRunner.now_us(), token_bytes(KEY_SIZE)
        keyring = keyring_of(self.keys, self.slot, lot, clock_zero_at_s(now_us))
        peer = make_peer(identity, self._rng, now_us, recalled, keyring=keyring)
        self._runner = PeerRunner(peer, self.bus, None, self.journal, self._effect)
        self._task = asyncio.create_task(self._runner.run(), name=f"peer {self.tractor_id}")
        self._task.add_done_callback(self._ended)
        try:
            await self._wait(lambda: peer.lifecycle.state is not State.DISCONNECTED, JOIN_TIMEOUT_S)
        except (TimeoutError, asyncio.CancelledError):
            await self._cancel()
            raise

    async def stop(self) -> None:
        """Leave the fleet with a farewell and stop the engine. A latched stop stays latched,
        durably.

        A machine that moves is given up to 5 s to stand before the farewell, so go on with `update`.
        The others brake for a machine that leaves while it moves.
        """
        if self._runner is None:
            return
        if (
            not self.failure
        ):  # an engine that has ended says no farewell: its bus may be what failed
            await self._runner.leave()
            await asyncio.sleep(0)
        await self._cancel()

    async def _cancel(self) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        self._task = self._runner = None

    # ---------------------------------------------------------------- tasks

    def update(
        self, x_m: float, y_m: float, heading_rad: float, speed_m_s: float, health: float = 1.0
    ) -> None:
        """The current reading of this machine's own sensors, sent in its beats from now on.

        Field frame: metres east and north, heading in radians counter-clockwise from east.
        `health`: 0.0 failed to 1.0 healthy. After the first call, call it at least every 50 ms: the
        machine has to stand if its reading is old.
        """
        vx_m_s, vy_m_s = speed_m_s * cos(heading_rad), speed_m_s * sin(heading_rad)

        here = Observation(
            x_m, y_m, heading_rad, vx_m_s, vy_m_s, sensed_at_us=PeerRunner.now_us(), health=health
        )
        self._operate(Sensed(here))

    async def claim_section(self, section_id: str) -> bool:
        """Claim a section; True once the contention window has passed and the claim still wins.

        False if it is lost, or if this machine may not work; `refusal` says why. Raises ValueError
        if the name cannot be a section.
        """
        try:
            won = await self._claim_section(section_id)
        except TimeoutError:  # it is not allowed to start its claimed section
            section = self.sections.number(section_id)
            self._operate(ReleaseSection(section))
            self.refusal = "; ".join(self.stands) or f"in state {self.get_current_state()}"
            return False
        if not won and not self.refusal:
            self.refusal = "another machine has it, or it is done"
        return won

    async def _claim_section(self, section_id: str) -> bool:
        peer, section = self._peer, self.sections.number(section_id)
        self.refusal = ""
        if peer.lifecycle.state not in (State.IDLE, State.WORKING):
            self.refusal = f"in state {peer.lifecycle.state.name}"
            return False
        self._operate(ClaimSection(section, 0))
        if not self._holds(section):
            return False
        settled_for_s = 2.0 * CONTENTION_US / S
        if peer.claims.current is None:
            await self._wait(
                lambda: section not in peer.claims.contest_ends_at_us, settled_for_s + 1.0
            )
        else:  # claimed ahead, so it is held but not yet started
            await asyncio.sleep(CONTENTION_US / S)
        return self._holds(section)

    def _holds(self, section: int) -> bool:
        """Whether a section is ours to work: one that we have finished still has us as its owner."""
        allocation = self._peer.allocation
        done = allocation.phase_of(section) is Phase.DONE
        return allocation.owner_of(section) == self.slot and not done

    async def release_section(self, section_id: str) -> None:
        """Release a section: a started one is DONE for good, another one is given back.

        Raises ValueError if the name cannot be a section.
        """
        section = self.sections.number(section_id)
        if self._peer.claims.current == section:
            self._operate(Finish(section))
        else:
            self._operate(ReleaseSection(section))

    # ---------------------------------------------------------------- emergency

    async def broadcast_emergency_stop(self, reason_code: str) -> None:
        """Stop the whole fleet. Raises ValueError with the known reasons if `reason_code` is none
        of them.
        """
        try:
            reason = Reason[reason_code]
        except KeyError:
            known = ", ".join(r.name for r in Reason)
            raise ValueError(f"unknown reason {reason_code!r}; one of {known}") from None
        self._operate(Press(reason))

    async def clear_stops(
        self,
        operator: Keyring | None = None,
        *,
        keyless: bool = False,
        timeout_s: float = CLEAR_TIMEOUT_S,
    ) -> "Cleared":
        """Clear the stops that hold this machine, here and at every other one; reset and start
        none.

        `operator`: the keyring of a person's operator key (`agent.runtime.files.key_file`), with a
        sender of 192 or more. `keyless`: must be True in a fleet without keys. `timeout_s`: how
        long to wait for answers. Afterwards each machine needs its `manual_reset`, then its
        `permit`. A stop that is pressed meanwhile is not cleared. Raises ValueError if the
        authority does not fit the fleet.
        """
        peer = self._peer
        if peer.safety.keyed and (keyless or operator is None):
            raise ValueError("this fleet has keys: give the keyring of an operator key")
        if not peer.safety.keyed and (operator is not None or not keyless):
            raise ValueError(
                "this fleet has no keys, so any device on the bus can release it: "
                "pass keyless=True and no keyring"
            )
        if operator is not None and operator.sender < OPERATOR_FIRST:
            raise ValueError(
                f"sender {operator.sender} is no operator: they begin at {OPERATOR_FIRST}"
            )
        call = ReleaseStops(operator, randbits(QUESTION_BITS))
        loop = asyncio.get_running_loop()
        end_at_s = loop.time() + timeout_s
        try:
            self._operate(call)
            release = peer.stop_release.current
            assert release is not None
            named = tuple(".".join(map(str, dot)) for dot in release.dots)
            while True:
                await asyncio.sleep(CLEAR_STEP_S)
                if not release.outstanding or loop.time() >= end_at_s:
                    break
                self._operate(call)
        finally:
            self._operate(EndRelease())
        holding = tuple(map(self._name, release.outstanding))
        return Cleared(named, holding, tuple(map(self._name, sorted(peer.membership.silent))))

    async def manual_reset(self) -> bool:
        """A person resets this machine. False while a stop is not cleared."""
        self._operate(ManualReset())
        return self._peer.lifecycle.state is not State.EMERGENCY_STOP

    async def permit(self) -> bool:
        """A person permits this machine to move, after its reset. False if it is latched."""
        self._operate(Start())
        return self._peer.safety.started and not self._peer.safety.latched

    # ---------------------------------------------------------------- queries

    def get_fleet_status(self) -> dict[str, dict[str, Any]]:
        """The last known status of every received member, ourselves included, by tractor id."""
        peer, now_us = self._peer, PeerRunner.now_us()
        status: dict[str, dict[str, Any]] = {}
        for slot, standing in sorted(peer.membership.standing.items()):
            neighbour = peer.membership.neighbours.get(slot)
            if neighbour is None:
                continue
            pose = neighbour.pose
            status[self._name(slot)] = {
                "status": State(pose.state).name,
                "standing": standing.name,
                "position": _position(pose),
                "speed_m_s": pose.speed_m_s,
                "health": peer.reports.healths.get(slot),
                "age_s": (now_us - neighbour.heard_at_us) / 1e6,
                "stands": peer.reports.told_standing(slot, now_us),
                "operations": peer.clock[slot],
                "sections": [
                    self.sections.name(s) for s in peer.allocation.assigned_sections(slot)
                ],
            }
        here, health = peer.here, readings(peer.self_known(now_us))
        status[self.tractor_id] = {
            "status": peer.lifecycle.state.name,
            "standing": "SELF",
            "position": None if here is None else {"x_m": here.x_m, "y_m": here.y_m},
            "speed_m_s": None if here is None else hypot(here.vx_m_s, here.vy_m_s),
            "health": health[0].share,
            "health_why": [reading.why for reading in health if reading.why],
            "stands": self.stands,
            "operations": peer.clock[self.slot],
            "sections": [
                self.sections.name(s) for s in peer.allocation.assigned_sections(self.slot)
            ],
            "age_s": 0.0,
        }
        return status

    @property
    def speed_limit_m_s(self) -> float:
        """The speed limit of this machine now: 0.0 means that it must stand, infinity that it is
        free.

        Read it in each control period before commanding the wheels: it includes all stops and other
        causes. It is 0.0 while the engine is not started, and for good after a failure that ended it.
        """
        if self._runner is None or self.failure or self._peer.safety.severity >= Severity.PAUSE:
            return 0.0
        return CREEP_M_S if self._peer.safety.severity is Severity.SLOW else inf

    @property
    def stands(self) -> list[str]:
        """Why this machine stands still or creeps, and what a person can do: one line for each
        cause.
        """
        told = [f"the engine ended: {self.failure}; stop and start it"] if self.failure else []
        return told + [sentence(c.number, about(c, why)) for c, why in self._peer.safety.causes]

    @property
    def failure(self) -> str:
        """What ended the engine, as a driver that raised; empty while it runs or is not started.

        It neither hears nor says anything then, and its other answers are of that moment.
        """
        if self._task is None or not self._task.done() or self._task.cancelled():
            return ""
        return repr(self._task.exception())

    def leader(self) -> str | None:
        """The id of the elected leader as this machine knows it; None if there is none, or before
        the start.

        Only the leader answers a global request for the state of the fleet. Use it for tasks that
        one machine should do once. They must do no harm if two machines or none do them for a
        while, because a network cut has a leader on each side. Never use it for stopping, claims or
        maps.
        """
        slot = None if self._runner is None else self._peer.leader
        return None if slot is None else self._name(slot)

    @property
    def is_leader(self) -> bool:
        """Whether this machine is the elected leader; see `leader`."""
        return self._runner is not None and self._peer.leads

    def get_field_allocation_state(self) -> FieldAllocationCRDT:
        """The current, merged view of the field allocation."""
        return self._peer.allocation

    def get_task_outcome(self, task: int) -> TaskOutcome:
        """What has become of a transport, by its number: how far it is, and which slot holds it."""
        return outcome_of(task, None, self._peer.allocation, self._peer.progress)

    def get_current_state(self) -> str:
        """The name of this machine's state, as in `State`; DISCONNECTED before the start."""
        return State.DISCONNECTED.name if self._runner is None else self._peer.lifecycle.state.name

    # ---------------------------------------------------------------- events

    def on_state_change(self, callback: Callable[[str], Awaitable[None] | None]) -> None:
        """Call back with the name of the new state at each change. The callback may be a coroutine
        function.
        """
        self._on_state.append(callback)

    def on_emergency(self, callback: Callable[[dict[str, Any]], Awaitable[None] | None]) -> None:
        """Call back at each stop with its data: why, from_state, reason, slot and position of the
        presser.

        Entries that are not known are None. The callback may be a coroutine function.
        """
        self._on_emergency.append(callback)

    def on_leader_change(self, callback: Callable[[str | None], Awaitable[None] | None]) -> None:
        """Call back with the id of the new leader, or None if there is none any more."""
        self._on_leader.append(callback)

    # ---------------------------------------------------------------- inside

    @property
    def _peer(self) -> Peer:
        if self._runner is None:
            raise RuntimeError("the engine is not started: await engine.start() first")
        return self._runner.peer

    def _ended(self, task: asyncio.Task[None]) -> None:
        """The peer has failed: the program has to stop the machine."""
        if task.cancelled() or task is not self._task:
            return
        log.error("%s has failed", self.tractor_id, exc_info=task.exception())
        told = {
            "why": f"the engine ended: {self.failure}", "from_state": self._state,
            "reason": None, "slot": None, "position": None,
        }  # fmt: skip
        for stop in self._on_emergency:
            self._call(stop, told)

    def _operate(self, call: Input) -> None:
        _ = self._peer
        assert self._runner is not None
        self._runner.operate(call)

    def _name(self, slot: int) -> str:
        return f"{self.prefix}{slot:0{self.width}d}"

    def _effect(self, now_us: int, effect: Effect) -> None:
        if (leader := self.leader()) != self._led:
            self._led = leader
            for led in self._on_leader:
                self._call(led, leader)
        if not isinstance(effect, Trace):
            return
        if effect.machine == "safety" and effect.event in ("PRESSED", "HEARD_STOP"):
            self._told_of_stop = True
            for stop in self._on_emergency:
                self._call(stop, self._emergency(effect))
        if effect.machine == "lifecycle":
            if effect.target == State.EMERGENCY_STOP.name and not self._told_of_stop:
                for stop in self._on_emergency:  # latched by another cause: a disk, a lost memory
                    self._call(stop, self._emergency(effect, False))
            self._told_of_stop, self._state = False, effect.target
            for changed in self._on_state:
                self._call(changed, effect.target)
        self._changed.set()

    def _emergency(self, pressed: Trace, is_stop: bool = True) -> dict[str, Any]:
        """The data of a stop, also during another one: presser, reason, and the presser's last
        place.
        """
        last = self._peer.safety.last_stop
        told: dict[str, Any] = {
            "why": f"stop: {pressed.why}" if is_stop else pressed.why, "from_state": self._state,
            "reason": None, "slot": None, "position": None,
        }  # fmt: skip
        if last is None or not is_stop:
            return told
        slot, reason = last
        pose = self._peer.membership.neighbours.get(slot)
        here = self._peer.here if slot == self.slot else pose.pose if pose else None
        if here is not None:
            told["position"] = {"x_m": here.x_m, "y_m": here.y_m}
        return told | {"reason": reason.name, "slot": slot}

    def _call(self, callback: Callable[[Any], Any], argument: Any) -> None:
        """Run a plain or async callback; its exceptions are logged and do not propagate."""
        try:
            result = callback(argument)
        except Exception:
            log.exception("a callback of %s failed", self.tractor_id)
            return
        if inspect.isawaitable(result):
            task = asyncio.ensure_future(self._contain(result))
            self._background.add(task)
            task.add_done_callback(self._background.discard)

    async def _contain(self, awaitable: Awaitable[Any]) -> None:
        try:
            await awaitable
        except Exception:
            log.exception("an async callback of %s failed", self.tractor_id)

    async def _wait(self, condition: Callable[[], bool], timeout_s: float) -> None:
        async with asyncio.timeout(timeout_s):
            while not condition():
                self._changed.clear()
                await self._changed.wait()


def _position(pose: Pose) -> dict[str, float] | None:
    """The position; None if the robot never knew its place."""
    return {"x_m": pose.x_m, "y_m": pose.y_m} if pose.x_m > NOWHERE_M else None
