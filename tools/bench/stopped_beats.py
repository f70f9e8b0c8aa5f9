"""When the last robot of a fleet says that it is stopped, from the frames on its bus."""

import asyncio

from protocol.frames.codec import decode
from protocol.frames.fleet_frames import Pose
from protocol.frames.frame import Frame
from protocol.frames.safety_frames import EmergencyStop, Reason
from tools.operate.operator_device import Operator

# From a press until no command to move is in force: the silence limit of 300 ms and 20 ms.
BUS_BOUND_MS = 320.0  # docs/how/safety_case.md, S1
LOOK_S = 0.01
REPEAT_S = 0.005  # as a stop panel repeats its press
TIMEOUT_S = 10.0
SETTLED_S = 2.0  # a fleet whose places came at their rate for so long has started
GONE_S = (
    3.0  # nobody beats from an address any more; robots of a loaded machine are silent for a second
)
READY_S = 120.0  # for a whole fleet to start again, on a machine that does much else


class Beats:
    """Which robots say that they are stopped. Beats come every 50 ms."""

    def __init__(self, robots: int) -> None:
        """`robots`: how many there are."""
        self.robots = robots
        self.stopped: dict[int, bool] = {}  # by source address
        self._heard_at_s: dict[int, float] = {}  # by source address
        self.all_at_s: float | None = None  # when all said so
        self.placed = 0  # beats of all robots that say a place

    def hear(self, frame: Frame) -> None:
        """Take one frame of the bus."""
        source, message = decode(frame)
        if isinstance(message, Pose):
            now_s = self._heard_at_s[source] = asyncio.get_running_loop().time()
            self.stopped[source] = message.stopped
            if len(self.stopped) > self.robots:  # one has taken another address
                self.stopped = {
                    address: stopped for address, stopped in self.stopped.items()
                    if now_s - self._heard_at_s[address] < GONE_S
                }  # fmt: skip
            self.placed += message.placed
            if self.all_at_s is None and self._all(True):
                self.all_at_s = asyncio.get_running_loop().time()

    def _all(self, stopped: bool) -> bool:
        return len(self.stopped) == self.robots and set(self.stopped.values()) == {stopped}

    async def until(self, stopped: bool) -> None:
        """Wait until all say so. Raises TimeoutError."""
        async with asyncio.timeout(READY_S):
            while not self._all(stopped):
                await asyncio.sleep(LOOK_S)

    async def settled(self, rate_hz: float) -> bool:
        """Wait until every robot has said so many places a second for a while; whether they did.

        Twenty processes that start on two cores beat too, but rarely.
        """
        loop = asyncio.get_running_loop()
        ends_at_s = loop.time() + READY_S
        while loop.time() < ends_at_s:
            before, begun_at_s = self.placed, loop.time()
            await asyncio.sleep(SETTLED_S)
            for_s = loop.time() - begun_at_s
            if self.placed - before >= rate_hz * for_s * self.robots:
                return True
        return False

    async def since(self, pressed_at_s: float) -> float:
        """Milliseconds from a press to the last robot. Raises TimeoutError."""
        async with asyncio.timeout(TIMEOUT_S):
            while self.all_at_s is None:
                await asyncio.sleep(REPEAT_S)
        return 1000 * (self.all_at_s - pressed_at_s)

    async def pressed(self, operator: Operator) -> float:
        """Press on the bus; milliseconds until the last robot. Raises TimeoutError."""
        stop: EmergencyStop = operator.new_stop(Reason.OPERATOR_INTERVENTION)
        begun_at_s = asyncio.get_running_loop().time()
        async with asyncio.timeout(TIMEOUT_S):
            while self.all_at_s is None:
                operator.stop(stop)
                await asyncio.sleep(REPEAT_S)
        return 1000 * (self.all_at_s - begun_at_s)
