"""A fleet with keys on a wire without time, and an attacker who can send any frame at any moment.

Robots drive side by side to the east, sections are claimed and covered by calls. So each
change of a replica, a state or a drive has one cause, and a judge that is not in the robots finds it.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from random import Random
from typing import NamedTuple

import numpy as np

from agent.interface.config import MS, S
from agent.interface.effects import HALT, Drive, Effect, Send
from agent.interface.identity import Identity, SilencePolicy
from agent.interface.lifecycle import State
from agent.interface.mission import ClaimRequest, FleetView, Mission, MotionRequest
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.motion.holonomic_motion import HolonomicMotion
from agent.peer.inputs import BusState, ClaimSection, Cover, Input, Received, Sensed, Timer
from agent.peer.peer import Peer
from agent.runtime.peer_factory import MissionParts, keyring_of, make_peer
from protocol.authentication import KEY_SIZE, Keys
from protocol.controller_health import Health
from protocol.frames.codec import encode
from protocol.frames.frame import Frame
from protocol.frames.messages import Message
from protocol.name import fleet_name

FLEET = "keyed"
SECTIONS, UNITS = 8, 40
FIELD_HASH = 1
LANE_M = 30.0  # between robots, which drive side by side
FULL = MotionRequest(2.0, 0.0, 0.0, True)
WIRE_US = 640  # a frame with 8 bytes
TURNS_MAX = 64  # of all robots at one instant
BOOT_US = 6 * S  # claim addresses, start the fleet's time, and hear each other


class AlwaysForward(Mission):
    """A mission that wants full speed to the east in every state."""

    section_units: Mapping[int, int] = dict.fromkeys(range(SECTIONS), UNITS)

    def choose(self, view: FleetView) -> ClaimRequest | None:
        return None

    def approach(self, section: int, view: FleetView) -> MotionRequest:
        return FULL

    def work(self, view: FleetView) -> MotionRequest:
        return FULL

    def accepts_goal(self, goal: tuple[float, float]) -> bool:
        return True

    def travel(self, goal: tuple[float, float], view: FleetView) -> MotionRequest:
        return FULL

    def idle(self, view: FleetView) -> MotionRequest:
        return FULL


class Witnessed(NamedTuple):
    """What an attack must not change in one robot."""

    registers: Mapping[int, int]
    progress: bytes
    live: frozenset[int]
    state: State


class KeyedRig:
    """Robots with keys, the wire between them, and the frames that an attacker has recorded."""

    def __init__(self, seed: int, robots: int = 3, keyed: bool = True, day: int = 0) -> None:
        """`day`: a fleet has the same keys on each, and draws other numbers."""
        rng = Random(f"keyed rig/{seed}")
        self.keys = Keys(rng.randbytes(KEY_SIZE), rng.randbytes(KEY_SIZE)) if keyed else None
        self.rng = Random(f"keyed rig/{seed}/{day}")
        self.robots, self.now_us = robots, 0
        self.peers: dict[int, Peer] = {}
        self.cut: set[int] = set()  # robots that send and receive nothing
        self.recorded: deque[Frame] = deque(maxlen=4096)
        self.drives: dict[int, Drive] = {}
        self._sent: dict[int, int] = {}
        self._due_at_us: dict[int, int] = {}  # of robots that got no input since it was computed
        self._x_m: dict[int, float] = {}
        self._moved_at_us: dict[int, int] = {}
        for slot in range(robots):
            self.boot(slot)
        self.run_for(BOOT_US)

    def boot(self, slot: int, lost: bool = False) -> Peer:
        """Switch a robot on, with an empty memory. `lost`: it knows that there was one."""
        identity = Identity(
            slot, frozenset(range(self.robots)), fleet_name(FLEET, slot), FIELD_HASH,
            SilencePolicy.STOP, started=True, first_boot=not lost,
        )  # fmt: skip
        motion = HolonomicMotion(slot, BodyLimits(0.8, 2.5, 1.5), np.empty((0, 4)))
        keyring = keyring_of(self.keys, slot, self.rng.randbytes(KEY_SIZE))
        parts = MissionParts(AlwaysForward(), motion)
        rng = Random(self.rng.random())
        peer = make_peer(identity, rng, self.now_us, {}, parts, keyring=keyring)
        self.peers[slot], self._sent[slot], self.drives[slot] = peer, 0, HALT
        self._x_m[slot], self._moved_at_us[slot] = 0.0, self.now_us
        self._due_at_us.pop(slot, None)
        return peer

    # ---------------------------------------------------------------- time

    def run_for(self, for_us: int) -> None:
        """Let the robots do what is due, in the order of their deadlines."""
        end_at_us = self.now_us + for_us
        due_at_us, turns, seen_at_us = self._due_at_us, 0, -1
        while True:
            for slot in self.peers.keys() - due_at_us.keys():
                due_at_us[slot] = self.peers[slot].due_at_us
            at_us, slot = min((at_us, slot) for slot, at_us in due_at_us.items())
            if at_us > end_at_us:
                break
            self.now_us = max(self.now_us, at_us)
            turns = turns + 1 if seen_at_us == self.now_us else 0
            assert turns < TURNS_MAX, f"robot {slot} is due for ever: its computer would be busy"
            seen_at_us = self.now_us
            self._turn(slot)
        self.now_us = end_at_us

    def _turn(self, slot: int) -> None:
        peer, now_us = self.peers[slot], self.now_us
        self.tell(slot, BusState(Health.ACTIVE, True, self._sent[slot]))
        if peer.wants_observation(now_us):
            self._move(slot)
            x_m, vx_m_s = self._x_m[slot], self.drives[slot].vx_m_s
            here = Observation(x_m, LANE_M * slot, 0.0, vx_m_s, 0.0, sensed_at_us=now_us)
            self.tell(slot, Sensed(here))
        self.tell(slot, Timer())

    def tell(self, slot: int, fact: Input) -> None:
        """Give a robot one input now, and put what it sends on the wire."""
        self._due_at_us.pop(slot, None)
        self.send(slot, self.peers[slot].step(fact, self.now_us))

    def send(self, slot: int, effects: Sequence[Effect]) -> None:
        """Perform effects of a robot, or what somebody with its key would do."""
        peer = self.peers[slot]
        for effect in effects:
            if isinstance(effect, Drive):
                self._move(slot)
                self.drives[slot] = effect
            elif isinstance(effect, Send):
                self._sent[slot] += 1
                source = peer.address if effect.source is None else effect.source
                if source is not None and slot not in self.cut:
                    frame = encode(effect.message, source, effect.destination)
                    self.recorded.append(frame)
                    self._deliver(frame, slot)

    def _move(self, slot: int) -> None:
        """Its body has followed its last drive until now."""
        passed_for_us = self.now_us - self._moved_at_us[slot]
        self._x_m[slot] += self.drives[slot].vx_m_s * passed_for_us / S
        self._moved_at_us[slot] = self.now_us

    def _deliver(self, frame: Frame, sender: int | None) -> None:
        for slot in self.peers:
            if slot != sender and slot not in self.cut:
                self.tell(slot, Received(frame))

    # ---------------------------------------------------------------- work

    def work(self, slot: int, section: int, units: int = UNITS // 2) -> None:
        """A robot claims a section and covers units of it."""
        self.tell(slot, ClaimSection(section, 3))
        self.run_for(400 * MS)
        self.tell(slot, Cover(section, tuple(range(units))))
        self.run_for(3 * S)

    # ---------------------------------------------------------------- the attacker

    def address_of(self, slot: int) -> int:
        """The bus address of a robot. Raises AssertionError if it has none."""
        address = self.peers[slot].address
        assert address is not None
        return address

    def forge(self, message: Message, source: int, destination: int = 255) -> None:
        """A frame of somebody who holds no key."""
        self.inject(encode(message, source, destination))

    def inject(self, frame: Frame) -> None:
        """Any frame, also one that cannot be read."""
        self.run_for(WIRE_US)
        self._deliver(frame, None)

    def inject_late(self, frame: Frame) -> None:
        """As `inject`, but what is due waits, as in a computer that is busy with its queue.

        The next `run_for` does it. It saves most of the time of a long trial."""
        self.now_us += WIRE_US
        self._deliver(frame, None)

    def witness(self, slot: int) -> Witnessed:
        """What is in the replica of a robot and in its view of the fleet now."""
        peer = self.peers[slot]
        return Witnessed(
            dict(peer.allocation.entries()), peer.progress.serialize(),
            peer.membership.live, peer.state,
        )  # fmt: skip

    def witness_all(self) -> dict[int, Witnessed]:
        """`witness` of every robot, by slot."""
        return {slot: self.witness(slot) for slot in self.peers}
