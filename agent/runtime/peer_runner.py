"""The only code that waits: passes frames, observations and time into a peer, and performs its
effects.

The same runner works on a robot (real time) and in `headland run` (virtual time). Frames are
processed when they arrive; the timer fires at the peer's deadline.
"""

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Sequence

from agent.interface.config import CONTROL_PERIOD_US, LEAVES_WITHIN_US, S
from agent.interface.effects import HALT, Drive, Effect, Persist, Send, Trace
from agent.interface.ports import Body, Bus, Confirming, Journal
from agent.peer.inputs import BusState, DiskFailed, Input, Leave, Received, Sensed, Timer
from agent.peer.peer import Peer
from protocol.frames.agreement_frames import AgreementMessage
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import LeaderElectionVote, Pose
from protocol.frames.frame import Frame
from protocol.frames.identifier import NULL_ADDRESS
from protocol.frames.messages import GROUP_OF, Message
from protocol.frames.safety_frames import EmergencyStop
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress

log = logging.getLogger(__name__)

# Frames whose only deadlines are those of any sign of life; most frames of a large fleet are these. A
# mission says what it has to say with the next beat.
QUIET_PGNS = frozenset(GROUP_OF[kind].pgn for kind in (Pose, AgreementMessage))
# What these messages say is on the disk before it is said, and still known after a restart.
ON_DISK_FIRST = (TaskClaim, StateSyncResponse, WorkProgress, LeaderElectionVote)
TIMER = Timer()
INBOX_MAX = 4096  # frames: two seconds of a full bus; a peer that is further behind drops the rest


def _is_press(message: Message) -> bool:
    """Whether this is a press, which a robot also sends without an address.

    Its dot names the robot, and its tag proves it. Echoes need an address, because simultaneous
    echoes of several robots under one identifier would destroy each other's frames.
    """
    return isinstance(message, EmergencyStop) and not message.echo


class PeerRunner:
    """Runs one peer on a bus, a body and a journal in an asyncio loop."""

    def __init__(
        self,
        peer: Peer,
        bus: Bus,
        body: Body | None,
        journal: Journal | None,
        on_effect: Callable[[int, Effect], None] | None = None,
        clock: Callable[[], int] | None = None,
    ) -> None:
        """`body`: None for a peer without sensors and actuators of its own. `journal`: None if
        nothing is kept durably. `on_effect`: called with the time and each effect after it was
        performed. `clock`: the time in microseconds; None: the time of the loop.
        """
        self.peer, self.bus, self.body, self.journal = peer, bus, body, journal
        self.on_effect = on_effect
        self.dropped = 0  # frames that found the inbox full
        self._inbox: deque[Frame] = deque()
        self.clock = self.now_us if clock is None else clock  # microseconds
        self._listening = False
        self._wake: asyncio.Future[None] | None = None
        self._armed_at_us = 0  # when the timer fires
        self._failure: Exception | None = None
        self._disk_failed = False
        self._remembers = journal is None  # the first thing that is stored is who we are
        self._taken = True  # whether the bus accepted the last frame
        self._confirming = bus if isinstance(bus, Confirming) else None
        self._freeze_ends_at_us = 0  # 0: not frozen

    @staticmethod
    def now_us() -> int:
        """The time of the running asyncio loop, microseconds."""
        return round(asyncio.get_running_loop().time() * 1e6)

    def perform(self, effects: Sequence[Effect]) -> None:
        """Perform the effects in order, without waiting: all of one input before the next input.

        If a record could not be made durable, the effects that depend on it are not sent. After that
        only effects that stop the robot are performed.
        """
        now_us, durable = self.clock(), True
        records: list[Persist] = []
        for effect in effects:
            if isinstance(effect, Persist):
                records.append(effect)
                continue
            if records:
                durable = self._persist(records) and durable
                records = []
            if isinstance(effect, Send):
                if not durable and not isinstance(effect.message, EmergencyStop):
                    continue
                if self._disk_failed and not self._may_say(effect.message):
                    continue  # it may tell what the disk did not take
                source = self.peer.address if effect.source is None else effect.source
                if source is None and _is_press(effect.message):
                    source = NULL_ADDRESS
                if source is not None:
                    frame = encode(effect.message, source, effect.destination)
                    if self.peer.check.clogged and not self.peer.check.lets_out(frame, now_us):
                        continue  # earlier frames are not being sent
                    self._taken = self.bus.send(frame)
            elif isinstance(effect, Drive):
                if self._disk_failed:
                    effect = HALT  # nothing moves a robot whose disk has failed
                if self.body is not None:
                    self.body.drive(effect, now_us)
            elif isinstance(effect, Trace) and log.isEnabledFor(logging.INFO):
                log.info("%.3f robot %d: %s", now_us / 1e6, self.peer.slot, " ".join(effect))
            if self.on_effect is not None:
                self.on_effect(now_us, effect)
        if records:
            self._persist(records)

    def _persist(self, records: list[Persist]) -> bool:
        """Whether the records are durable.

        A disk that has failed once is not used again: after an error it is unknown which earlier
        writes are still only in its cache.
        """
        if self.journal is None:
            return True
        if self._disk_failed:
            return False
        try:
            self.journal.write(records)
            self._remembers = True
        except OSError as problem:
            self._disk_failed = True
            log.error("robot %d: the journal failed: %s", self.peer.slot, problem)
            self.perform(self.peer.step(DiskFailed(), self.clock()))
        return not self._disk_failed

    def _may_say(self, message: Message) -> bool:
        """Whether a robot whose disk has failed may send this.

        One whose disk failed at its start does not join: after a restart it would use its incarnation
        again, and a stop could pass for an old one."""
        if isinstance(message, EmergencyStop):
            return True
        return self._remembers and not isinstance(message, ON_DISK_FIRST)

    def operate(self, *calls: Input) -> None:
        """An operator's calls, between two other inputs: `runner.operate(Press(reason))`."""
        for call in calls:
            self.perform(self.peer.step(call, self.clock()))
        self._nudge()

    async def leave(self) -> None:
        """Leave the fleet with a farewell, when the robot stands or after `LEAVES_WITHIN_US`.

        `run` must be running. The others brake for a robot that goes while it moves."""
        self.operate(Leave())
        end_at_us = self.clock() + LEAVES_WITHIN_US
        while self.peer.departure.leaving and self.clock() < end_at_us:
            await asyncio.sleep(CONTROL_PERIOD_US / S)
        if self.peer.departure.leaving:
            self.operate(Leave())

    def _on_frame(self, frame: Frame) -> None:
        """A frame, on the thread of the loop: processed immediately, unless this process is
        frozen.
        """
        if self._freeze_ends_at_us or not self._listening:
            if len(self._inbox) >= INBOX_MAX:
                self.dropped += 1
            else:
                self._inbox.append(frame)
            return
        try:
            self._process(frame)
        except (
            Exception
        ) as problem:  # a broken invariant of ours: it must end the task, not a callback
            self._failure = problem
            self._nudge()

    def _process(self, frame: Frame) -> bool:
        """Process a frame; returns whether the peer's deadline may have changed."""
        effects = self.peer.step(Received(frame), self.clock())
        if effects:
            self.perform(effects)
        elif frame.identifier >> 8 & 0x3FFFF in QUIET_PGNS:
            return False  # nine frames in ten; it had no effects, so the deadline is unchanged
        if self.peer.due_at_us < self._armed_at_us:
            self._nudge()
        return True

    def freeze(self, for_s: float) -> None:
        """Fault injection: this process stands still for `for_s` seconds and then continues."""
        self._freeze_ends_at_us = self.clock() + round(for_s * 1e6)
        self._nudge()

    def _nudge(self) -> None:
        if self._wake is not None and not self._wake.done():
            self._wake.set_result(None)

    async def run(self) -> None:
        """Run until cancelled. Raises the exception of a broken invariant, if there is one."""
        loop, peer = asyncio.get_running_loop(), self.peer
        self.bus.subscribe(self._on_frame)
        while True:
            self._armed_at_us = peer.due_at_us
            self._wake, self._listening = loop.create_future(), True
            timer = loop.call_at(self._armed_at_us / 1e6, self._nudge)
            try:
                await self._wake
            finally:
                timer.cancel()
            if self._failure is not None:
                raise self._failure
            if self._freeze_ends_at_us:
                await asyncio.sleep(max(0, self._freeze_ends_at_us - self.clock()) / 1e6)
                self.thaw()
            self.on_tick()

    def thaw(self) -> None:
        """End the freeze and process the waiting frames."""
        self._freeze_ends_at_us = 0
        while self._inbox:
            self._process(self._inbox.popleft())

    def on_tick(self) -> None:
        """Give the peer the state of the bus, an observation and the time, if it is due."""
        now_us, peer = self.clock(), self.peer
        if now_us >= self._armed_at_us or now_us >= peer.due_at_us:
            sent = None if self._confirming is None else self._confirming.sent
            effects = peer.step(BusState(self.bus.health, self._taken, sent), now_us)
            if effects:
                self.perform(effects)
            if self.body is not None and peer.wants_observation(now_us):
                peer.step(Sensed(self.body.sense(now_us)), now_us)
            self.perform(peer.step(TIMER, now_us))
