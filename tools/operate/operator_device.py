"""An operator's device on the bus: which robots are there, which are stopped, and frames to send.

Sans I/O but for `Bus.send`: the commands below (`estop`, `reset`) own the loop and the clock.
"""

import asyncio
from collections.abc import Iterable
from dataclasses import dataclass, field
from secrets import randbelow

from agent.interface.lifecycle import State
from agent.interface.ports import Bus
from agent.peer.told_causes import ToldCauses
from crdt.stops import RemoteStopDot
from protocol.authentication import Keyring, Signed
from protocol.fleet_tags import FleetTags, plain_reset
from protocol.frames.agreement_frames import SilentPosition
from protocol.frames.codec import Malformed, decode
from protocol.frames.fleet_frames import Heartbeat, Member, Pose, Standstill
from protocol.frames.frame import Frame
from protocol.frames.identifier import NULL_ADDRESS
from protocol.frames.messages import GROUP_OF, Message
from protocol.frames.network_frames import AddressClaimed, Request
from protocol.frames.operator_frames import OperatorReport, ReportKind, goal_check, goal_frames
from protocol.frames.safety_frames import (
    EVERYBODY,
    Challenge,
    Command,
    EmergencyReset,
    EmergencyStop,
    Freshness,
    HeldReset,
    OperatorCommand,
    StopsHeld,
)
from protocol.frames.segment_frames import FleetStop
from protocol.frames.work_frames import REGISTERS, STOPS, StateSyncRequest
from tools.common.bus_address import AttachError
from tools.common.frame_makers import Makers
from tools.operate.device_keys import DeviceKeys
from tools.operate.shown_stops import ShownStops
from tools.operate.tool_address import CROWDED_OUT, DeviceAddress

OPERATOR_SLOT = 249  # an operator device in dots and commands, in a fleet without keys
LIVE_S = 1.0  # heard within this: it has to stop
LEFT_S = 0.5  # silence after a farewell until it is believed: ten beats
# Echoes of one robot that are checked for one stop: a forger has 8 guesses of 2^-16.
ECHOES_TRIED = 8
NOT_HEARD_S = float("-inf")  # when a robot was heard that only others reported
LEAST_S = 1e-6  # a shorter rest is no time: added to a virtual clock it may be lost in rounding
ASK_S = 0.25
ASKED_S = 2.0  # a release that is asked for is said twice a second
# Robots ask for the counter of a frame that was signed just now. Later the question is about another
# device with the same key, whose counter is another one.
PROVES_S = 1.0
NOT_SIGNED_S = float("-inf")  # when a device signed that has signed nothing


@dataclass
class KnownRobot:
    """What an operator has heard of one robot."""

    slot: int
    address: int
    heard_s: float
    state: State = State.DISCONNECTED
    stopped: bool = False
    echoed: bool = False
    signed: bool = False  # and its echo has a tag that it alone could make
    started: bool = False
    held: bool = False  # something other than a latch keeps it from moving
    causes: ToldCauses = field(default_factory=ToldCauses)  # why it stands, as it tells it
    leaves_s: float | None = None  # when it said farewell, if it has sent no beat since
    report: OperatorReport | None = None  # the newest, since it was last forgotten
    question: OperatorReport | None = None  # that it is asking or waiting about
    tried: int = 0  # echoes whose tag was looked at
    asked_s: float = NOT_HEARD_S  # when it last asked for a proof, so what came before was refused
    # When it last said that somebody asks for a release at the terminal that it serves.
    release_asked_s: float = NOT_HEARD_S


class Operator:
    """Follows all robots of a bus, and sends stops, resets and commands, signed if there is a
    keyring."""

    def __init__(
        self,
        bus: Bus,
        keyring: Keyring | DeviceKeys | None,
        device: DeviceAddress | None = None,
    ) -> None:
        """`keyring`: DeviceKeys for a tool that runs for long. `device`: whose address this operator
        speaks from; none: it claims one of its own."""
        self.keys = keyring if isinstance(keyring, DeviceKeys) else None
        keyring = keyring.keyring if isinstance(keyring, DeviceKeys) else keyring
        self.bus, self.keyring = bus, keyring
        self.device = DeviceAddress(bus) if device is None else device
        self._own_device = device is None
        self.slot = OPERATOR_SLOT if keyring is None else keyring.sender
        self.robots: dict[int, KnownRobot] = {}
        self.slot_of: dict[int, int] = {}
        self.names: dict[int, int] = {}  # address -> NAME, as claimed
        self.unknown: dict[int, float] = {}  # addresses with beats whose slot is not known yet
        self.makers = Makers()
        # Robots known only by a word from an address whose claim was not heard yet: address -> slot.
        self.doubtful: dict[int, int] = {}
        self.shown = ShownStops(keyring)
        self.pressed: set[tuple[int, int, int]] = set()  # dots of ours, the newest press
        self._signed_s = NOT_SIGNED_S
        self.now_s = 0.0

    def hear(self, now_s: float, frame: Frame) -> None:
        """Take one frame, at `now_s` of a clock that never goes back. Frames of other makers and
        malformed ones are ignored."""
        self.now_s = now_s
        if self._own_device:
            self.device.hear(now_s, frame)
        if self.makers.refuse(frame):
            return
        source, message = decode(frame)
        if isinstance(message, Malformed):
            return
        if isinstance(message, AddressClaimed):
            if self.names.get(source, message.name) != message.name:
                self.slot_of.pop(source, None)  # another device: it has to say which robot it is
            self.names[source] = message.name
            if self.makers.claimed(source, message.name):
                self.doubtful.pop(source, None)
            else:
                self._foreign(source)
        if isinstance(message, Member):
            self.slot_of[source] = message.slot
            self.unknown.pop(source, None)
            if message.slot not in self.robots and not self.makers.knows(source):
                self.doubtful[source] = message.slot
                self.robots[message.slot] = KnownRobot(message.slot, source, now_s)
            elif self.doubtful.get(source) != message.slot:
                self.expect((message.slot,))
            self.robots[message.slot].address = source
        if isinstance(message, SilentPosition):
            self.expect((message.slot,))  # it was there, and fell silent before we came
        if isinstance(message, EmergencyStop):
            self.shown.hear_stop(message)
        if isinstance(message, StopsHeld):
            self.shown.hear_held(message)
        if isinstance(message, FleetStop):
            far = RemoteStopDot(message.slot, message.incarnation, message.counter, message.segment)
            self.shown.hear_far(far, message.told)
        if isinstance(message, Challenge):
            self._prove(source, message)
        if isinstance(message, Freshness) and self.signs and self.keyring is not None:
            self.keyring.prove(message, round(now_s * 1e6))
        slot = self.slot_of.get(source)
        if slot is None:
            if isinstance(message, Pose | Heartbeat):
                self.unknown[source] = now_s
            return
        robot = self.robots[slot]
        robot.heard_s = now_s
        if isinstance(message, Challenge) and message.asked == self.slot:
            robot.asked_s = now_s
        if isinstance(message, Pose | Heartbeat):
            if isinstance(message, Heartbeat) and message.leaving:
                robot.leaves_s = now_s if robot.leaves_s is None else robot.leaves_s
                return
            robot.leaves_s = None  # a robot that beats has not left, whatever is said in its name
            robot.state, robot.stopped = State(message.state), message.stopped
            if isinstance(message, Heartbeat):
                robot.started, robot.held = message.started, message.held
                if not (robot.held or robot.stopped):
                    robot.causes.moves()
        elif isinstance(message, Standstill):
            robot.causes.hear(message, round(now_s * 1e6))
        elif isinstance(message, OperatorReport) and message.matter is ReportKind.RELEASE_ASKED:
            robot.release_asked_s = now_s
        elif isinstance(message, OperatorReport):
            robot.report = message
            asking = message.matter in (ReportKind.ASKING, ReportKind.WAITING)
            if asking or message.matter is not ReportKind.REFUSED:
                robot.question = message if asking else None
        elif isinstance(message, EmergencyStop) and message.echo and not message.spent:
            robot.echoed = True
            self._verify(robot, message)

    def _foreign(self, source: int) -> None:
        """Another maker's: what came from there before the claim was no robot's."""
        self.unknown.pop(source, None)
        slot = self.doubtful.pop(source, None)
        if slot is not None:
            self.slot_of.pop(source, None)
            del self.robots[slot]

    def _verify(self, robot: KnownRobot, echo: EmergencyStop) -> None:
        """An echo of a dot that we drew just now cannot be old, whatever the robot's counter is."""
        if self.keyring is None or robot.signed or echo[:3] not in self.pressed:
            return
        if robot.tried < ECHOES_TRIED:
            robot.tried += 1
            robot.signed = self.keyring.wrote(echo, robot.slot)
        if not robot.signed:  # it may have signed more frames than are tried
            question = self.keyring.ask(robot.slot, round(self.now_s * 1e6))
            if question is not None:
                self.device.send(question)

    def expect(self, slots: Iterable[int]) -> None:
        """Robots that are or were there, heard or not: they count until they have confirmed."""
        for slot in slots:
            self.robots.setdefault(slot, KnownRobot(slot, NULL_ADDRESS, NOT_HEARD_S))
            self.doubtful = {a: s for a, s in self.doubtful.items() if s != slot}

    @property
    def signs(self) -> bool:
        """Echoes can be verified: this device holds the secret that robots sign with."""
        return self.keyring is not None and self.keyring.keys.master is not None

    def begin(self) -> None:
        """A press or a phrase begins: robots may have other keys than at the last one, and another tool
        may have signed with this file."""
        if self.keys is not None:
            self.keyring = self.keys.begin()

    def begin_press(self) -> None:
        """What was confirmed before is no confirmation of the press that comes."""
        self.begin()
        self.pressed.clear()
        for robot in self.robots.values():
            robot.echoed = robot.signed = False
            robot.tried = 0

    def confirmed(self, robot: KnownRobot) -> bool:
        """It stands stopped: by its signed echo where that can be verified, else by its own word."""
        return robot.signed if self.signs else robot.stopped or robot.echoed

    def _prove(self, source: int, question: Challenge) -> None:
        """A robot that cannot follow our counter wants to know where it is."""
        if self.keyring is None or self.now_s - self._signed_s > PROVES_S:
            return
        proof = self.keyring.answer(question, round(self.now_s * 1e6))
        if proof is not None:
            if self.keyring.badge is not None:
                self.device.send(self.keyring.badge.told())
            self.device.send(proof, source)

    def left(self, robot: KnownRobot) -> bool:
        """It said that it leaves, and has not beaten since."""
        return robot.leaves_s is not None and self.now_s - robot.leaves_s >= LEFT_S

    @property
    def members(self) -> list[KnownRobot]:
        """All that are or were there and have not left."""
        return [r for _, r in sorted(self.robots.items()) if not self.left(r)]

    @property
    def live(self) -> list[KnownRobot]:
        """The members that were heard recently."""
        return [r for r in self.members if self.now_s - r.heard_s < LIVE_S]

    @property
    def release_asked(self) -> list[int]:
        """Robots at whose terminal somebody asks for a release now. It proves nothing: anybody on the
        bus may ask."""
        return [r.slot for r in self.members if self.now_s - r.release_asked_s < ASKED_S]

    @property
    def silent(self) -> list[KnownRobot]:
        """Members that are not heard now."""
        return [r for r in self.members if self.now_s - r.heard_s >= LIVE_S]

    def send(self, message: Message) -> bool:
        """Send a message from the address of this device. False where the bus does not take it."""
        return self.device.send(message)

    def check_address(self) -> None:
        """Raises AttachError if no address is left for this device: robots hear none of its orders."""
        if self.device.crowded_out:
            raise AttachError(CROWDED_OUT)

    def unnamed(self, since_s: float) -> list[int]:
        """Addresses that sent a beat since then and have not said which robot they are, in order."""
        return sorted(address for address, t_s in self.unknown.items() if t_s >= since_s)

    def ask_who(self) -> None:
        """Ask all robots for their slots."""
        self.send(Request(GROUP_OF[Member].pgn))

    async def listen(self, seconds: float, stops: bool = False) -> None:
        """Hear which robots are there; ask again, because an answer may come before we are on the bus."""
        loop = asyncio.get_running_loop()
        await self.device.held()
        end_s = loop.time() + seconds
        while (left_s := end_s - loop.time()) > LEAST_S:
            self.ask_who()
            if stops:
                self.ask_stops()
            await asyncio.sleep(min(ASK_S, left_s))
        self.now_s = loop.time()

    def ask_work(self) -> None:
        """Somebody tells the registers and the progress of the fleet."""
        self.send(StateSyncRequest(0, 0, REGISTERS, 0))

    def ask_stops(self) -> None:
        """Latched robots answer with the stops they hold."""
        question = self.shown.question
        self.send(StateSyncRequest(question & 0xFFFFFF, question >> 24, STOPS, 0))

    def new_stop(self, reason: int) -> EmergencyStop:
        """An unused dot: two random bytes. The caller tries another if no robot latches."""
        return EmergencyStop(self.slot, randbelow(256), randbelow(256), reason)

    def stop(self, message: EmergencyStop) -> None:
        """Press a stop, and know it as our own."""
        self.pressed.add(message[:3])
        self.send(self._sign(message))

    def clear_far(self, dot: RemoteStopDot) -> None:
        """In all segments; twice, because a frame may be lost. A restricted key cannot."""
        if self.keyring is not None and self.keyring.badge is not None:
            return
        tags = None if self.keyring is None else FleetTags(self.keyring.keys)
        halves = plain_reset(dot) if tags is None else tags.reset(dot)
        for half in (*halves, *halves):
            self.send(half)

    def clear_held(self, digest: int) -> None:
        """All stops of the robots that hold exactly these."""
        self._order(HeldReset(digest, self.slot))

    def clear(self, dot: tuple[int, int, int]) -> None:
        """Send the reset of one stop, named by its dot: slot, incarnation, counter."""
        self._order(EmergencyReset(*dot, self.slot))

    def command(self, command: Command, target: int = EVERYBODY, argument: int = 0) -> None:
        """Send a command to one robot, or to all. `argument` depends on the command: for an answer
        it is the number of the question."""
        self._order(OperatorCommand(command, target, self.slot, argument))

    def send_to(self, slot: int, x_m: float, y_m: float) -> None:
        """Name a place and send one robot there. ValueError where it cannot be said."""
        frames = goal_frames(slot, self.slot, x_m, y_m)
        for frame in frames:
            self._order(frame)
        self.command(Command.SET_GOAL, slot, goal_check(frames[0].value, frames[1].value))

    def _order(self, message: Signed) -> None:
        """With a tag it is said twice: robots act on two frames that agree."""
        for _ in range(1 if self.keyring is None else 2):
            self.send(self._sign(message))

    def _sign(self, message: Signed) -> Signed:
        if self.keys is not None:
            self.keyring = self.keys.newest()
        if self.keyring is None:
            return message
        self._signed_s = self.now_s
        return self.keyring.sign(message)
