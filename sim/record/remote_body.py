"""A robot process and its body in the world's process: messages on a socket of their owner.

The world sends each body's observation every `TELL_US`, with the time at which it was sensed. A
robot sends its drive commands. A lost or late message has the same effect as a lost or late sensor
reading or command: commands expire by themselves, and observations age. A slot belongs to the
process that has sent a hello for it, until that process ends. Another process receives nothing and
moves nothing.
"""

import asyncio
import struct
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from agent.interface.effects import Drive, GatedDrive
from agent.interface.observation import Observation, VisibleParcel
from agent.interface.ports import Body
from agent.peer.peer import Peer
from agent.runtime.robot_body import RobotBody
from sim.record.intent_stream import IntentRelay, tell
from sim.record.local_link import Link, LinkServer

if TYPE_CHECKING:
    from sim.world.world import World  # physics and numba, which a robot's process has no use for

TELL_US = 20_000  # one world step
HELLO_S = 0.2  # a robot that has received nothing yet repeats its hello
DRIVE = struct.Struct("<4sBdddBi")  # magic, slot, vx, vy, turn, implement, parcel to handle
# magic, slot, sensed at (us of the world), x, y, heading, vx, vy, battery, load, implement, number of
# parcels in reach; the parcels and the rays follow
SENSE = struct.Struct("<4sBqddddddibB")
NOT_SENSED = -1  # of an implement: up is 0, down is 1
LYING = struct.Struct("<idd?")  # task, x, y, on a robot
PARCELS_MAX = 32  # sent together; within an arm's reach
RAY = struct.Struct("<f")
MAGIC_DRIVE, MAGIC_HELLO, MAGIC_SENSE = b"HLDr", b"HLHi", b"HLSe"
DRIFT_SHARE = 1e-4  # limit for how much faster than ours the world's clock may run


def sense_bytes(slot: int, seen: Observation) -> bytes:
    """An observation as one message: a fixed head, up to `PARCELS_MAX` parcels, then the ranges."""
    parcels = sorted(seen.parcels.items())[:PARCELS_MAX]
    implement = NOT_SENSED if seen.implement_down is None else int(seen.implement_down)
    head = SENSE.pack(
        MAGIC_SENSE, slot, seen.sensed_at_us, *seen[:5], seen.battery, seen.load, implement,
        len(parcels),
    )  # fmt: skip
    lying = b"".join(LYING.pack(task, *where) for task, where in parcels)
    return head + lying + struct.pack(f"<{len(seen.ranges_m)}f", *seen.ranges_m)


def observation_of(data: bytes) -> Observation | None:
    """Parse an observation; None if `sense_bytes` did not make it. Its time is the world's."""
    if len(data) < SENSE.size:
        return None
    _, _, sensed_at_us, *pose, battery, load, implement, count = SENSE.unpack_from(data)
    begin = SENSE.size + count * LYING.size
    rays = (len(data) - begin) // RAY.size
    if rays < 0 or len(data) != begin + rays * RAY.size:
        return None
    lying = (LYING.unpack_from(data, SENSE.size + k * LYING.size) for k in range(count))
    parcels = {task: VisibleParcel(x_m, y_m, on_robot) for task, x_m, y_m, on_robot in lying}
    ranges_m = struct.unpack_from(f"<{rays}f", data, begin)
    return Observation(*pose)._replace(
        ranges_m=ranges_m, battery=battery, load=load, parcels=parcels, sensed_at_us=sensed_at_us,
        implement_down=None if implement == NOT_SENSED else implement == 1,
    )  # fmt: skip


class BodyServer:
    """Runs in the world's process. `zero_at_us`: the loop's time at which the world's time is 0."""

    def __init__(self, world: "World", zero_at_us: int) -> None:
        self.world, self.zero_at_us = world, zero_at_us
        # May be replaced by one with an arm and a battery.
        self.body: Callable[[int], Body] = world.body
        self.malformed = 0
        self.refused = 0  # hellos and commands for a slot that belongs to another process
        self.relay = IntentRelay()
        self.server = LinkServer(lambda: _RobotLink(self))
        self._links: dict[int, Link] = {}

    async def start(self, folder: Path | None = None) -> Path:
        """The path of the socket, for robots and maps of the same owner. Raises OSError."""
        return await self.server.start(folder)

    def close(self) -> None:
        """Accept no more robots."""
        self.server.close()

    def now_us(self) -> int:
        """Microseconds of the world, which began at `zero_at_us` of the loop."""
        return round(asyncio.get_running_loop().time() * 1e6) - self.zero_at_us

    def take(self, data: bytes, link: Link) -> None:
        """Obey a drive command or a greeting, and answer with what the body senses. Anything
        malformed is counted and dropped."""
        if self.relay.take(data, link):
            return
        if len(data) != DRIVE.size or data[:4] not in (MAGIC_DRIVE, MAGIC_HELLO):
            self.malformed += 1
            return
        magic, slot, vx_m_s, vy_m_s, turn_rad_s, tool_on, parcel_action = DRIVE.unpack(data)
        if slot not in self.world.robots or not all(
            abs(v) < 1e3 for v in (vx_m_s, vy_m_s, turn_rad_s)
        ):
            self.malformed += 1
            return
        owner = self._links.get(slot)
        if magic == MAGIC_HELLO and (owner is None or not owner.open):
            self._links[slot] = owner = link
        if owner is not link:
            self.refused += 1
        elif magic == MAGIC_DRIVE:
            drive = Drive(vx_m_s, vy_m_s, turn_rad_s, tool_on == 1, parcel_action)
            # It has passed the gate in the robot's process.
            self.body(slot).drive(GatedDrive(drive), self.now_us())

    async def run(self) -> None:
        """Step the world in real time and send an observation to every robot that has asked."""
        loop, next_at_s = asyncio.get_running_loop(), asyncio.get_running_loop().time()
        while True:
            now_us = self.now_us()
            self.world.advance(now_us)
            for slot, link in self._links.items():
                seen = self.body(slot).sense(now_us) if link.open else None
                if seen is not None:
                    link.send(sense_bytes(slot, seen))
            next_at_s = max(next_at_s + TELL_US / 1e6, loop.time())
            await asyncio.sleep(next_at_s - loop.time())


class _RobotLink(Link):
    def __init__(self, bodies: BodyServer) -> None:
        super().__init__()
        self.bodies = bodies

    def take(self, message: bytes) -> None:
        self.bodies.take(message, self)


class RemoteBody(Link):
    """The `Body` port over a link, in a robot's process.

    The world uses another clock. The fastest message so far gives its offset from ours; a message
    that took longer is older by the difference.

    The world raises the implement where a command comes too late, and several of its messages may come
    between two control periods. So an implement that was up in any of them is said to be up.
    """

    def __init__(self, slot: int) -> None:
        super().__init__()
        self.slot = slot
        self.seen: Observation | None = None
        self.first = asyncio.Event()
        self._behind_for_us: float | None = None  # how far the world's clock is behind ours
        self._heard_at_us = 0
        self._lifted = False  # the implement was up in a message since the last look

    def take(self, message: bytes) -> None:
        seen = None
        if message[:4] == MAGIC_SENSE and message[4:5] == bytes([self.slot]):
            seen = observation_of(message)
        if seen is None:
            self.malformed += 1
            return
        now_us = round(asyncio.get_running_loop().time() * 1e6)
        behind_for_us: float = now_us - seen.sensed_at_us
        if self._behind_for_us is not None:
            drifted_for_us = self._behind_for_us + (now_us - self._heard_at_us) * DRIFT_SHARE
            behind_for_us = min(behind_for_us, drifted_for_us)
        self._behind_for_us, self._heard_at_us = behind_for_us, now_us
        self.seen = seen._replace(sensed_at_us=round(seen.sensed_at_us + behind_for_us))
        self._lifted = self._lifted or seen.implement_down is False
        self.first.set()

    async def ready(self) -> None:
        """Send hellos until the first observation comes."""
        while not self.first.is_set():
            self._say(MAGIC_HELLO, Drive(0.0, 0.0))
            try:
                async with asyncio.timeout(HELLO_S):
                    await self.first.wait()
            except TimeoutError:
                continue

    def sense(self, now_us: int) -> Observation | None:
        """The newest observation, without time limit; its age shows how useful it is."""
        lifted, self._lifted = self._lifted, False
        if lifted and self.seen is not None:
            return self.seen._replace(implement_down=False)
        return self.seen

    def drive(self, command: Drive, now_us: int) -> None:
        """Send a command to the world's process."""
        self._say(MAGIC_DRIVE, command)

    def tell(self, data: bytes) -> None:
        """Send to observers; see `sim.record.intent_stream`."""
        self.send(data)

    def _say(self, magic: bytes, c: Drive) -> None:
        self.send(
            DRIVE.pack(
                magic, self.slot, c.vx_m_s, c.vy_m_s, c.turn_rad_s, c.tool_on, c.parcel_action
            )
        )


class WorldBody(RobotBody):
    """A body in the world of another process, as a robot file names it."""

    has_range_sensors: ClassVar[bool] = True  # as far as the scenario gives it rays

    def __init__(self, slot: int, socket: str) -> None:
        """`socket`: the path that `BodyServer.start` returns."""
        self.socket, self.remote = Path(socket), RemoteBody(slot)

    async def open(self) -> None:
        """Connect, and wait for the first observation. Raises OSError."""
        try:
            await self.remote.connect(self.socket)
        except OSError as problem:
            raise OSError(f"no world answers at {self.socket}: {problem}") from None
        await self.remote.ready()

    def sense(self, now_us: int) -> Observation | None:
        """The newest observation that has arrived."""
        return self.remote.sense(now_us)

    def drive(self, command: Drive, now_us: int) -> None:
        """Send the command to the world."""
        self.remote.drive(command, now_us)

    async def watch(self, peer: Peer) -> None:
        """Send the robot's intent to maps and recordings."""
        await tell(peer, self.remote.tell)

    def close(self) -> None:
        """End the connection; the world then stops the body."""
        self.remote.end()
