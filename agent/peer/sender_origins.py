"""Which devices count as ours: the entrance check of proprietary frames and of stops.

`agent/peer/frame_origin.py` says what a claimed NAME means. This part asks for NAMEs that it has
missed, keeps what must not be missed until the answer, and then has it processed.
"""

from collections import Counter
from collections.abc import Mapping
from typing import Any, Final

from agent.interface.config import MS, S
from agent.interface.effects import HALT
from agent.peer import notices
from agent.peer.frame_origin import PROPRIETARY, Origin, Origins
from agent.peer.member_conflicts import Conflicts
from agent.peer.name_discovery import NameDiscovery
from agent.peer.network_join import NetworkJoin
from agent.peer.part import NOTHING, Handler, Header, Outputs, Part, StepContext
from agent.peer.unknown_stop_sources import AnyStop, Doubts
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController
from protocol.frames.codec import Malformed
from protocol.frames.fleet_frames import Heartbeat, Member, Pose
from protocol.frames.identifier import NULL_ADDRESS
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.operator_frames import OperatorGoal
from protocol.frames.safety_frames import (
    Challenge,
    EmergencyReset,
    Freshness,
    HeldReset,
    OperatorCommand,
)
from protocol.frames.trust_frames import OperatorBadge

NAME_PATIENCE_US: Final = 20 * MS  # a claim in transit may arrive after a beat of its sender
# After this a device of ours may have taken the address of another maker's device, and we may have
# missed its claim.
CLAIM_OLD_US: Final = 10 * S
DOUBTED_HOLD_US: Final = 1 * S  # a stop of an unknown sender, while its name is asked for
# A device of ours that has lost its address to another NAME claims again within a second.
CONTENDED_US: Final = 10 * S
SIGNS_OF_LIFE = (Pose, Heartbeat, Member)
SIGNED = (
    EmergencyReset,
    HeldReset,
    OperatorCommand,
    OperatorGoal,
    Challenge,
    Freshness,
    OperatorBadge,
)


class SenderOrigins(Part):
    """The part that decides which frames are taken as frames of our fleet."""

    def __init__(
        self,
        origins: Origins,
        safety: StopController,
        joining: NetworkJoin,
        conflicts: Conflicts,
        name_discovery: NameDiscovery,
    ) -> None:
        self.origins, self.safety, self.joining = origins, safety, joining
        self.conflicts, self.name_discovery = conflicts, name_discovery
        self.doubts = Doubts()
        self.malformed: Counter[str] = Counter()  # reason -> frames
        self._claimed_at_us: dict[int, int] = {}  # address -> when its newest claim was received
        # Address -> until when a device of ours, which another NAME follows there, may still speak.
        self._contended_end_at_us: dict[int, int] = {}

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {AddressClaimed: self._address_claimed, Malformed: self._count_malformed}

    @property
    def due_at_us(self) -> int:
        return self.doubts.due_at_us

    def on_timer(self, ctx: StepContext) -> Outputs:
        """Accept the stops of addresses that did not claim in time, with their reception times."""
        outputs: list[Any] = []
        for address, at_us, stop in self.doubts.overdue(ctx.now_us):
            self.name_discovery.asks.calm(address)
            outputs.append(notices.HeardAgain(address, stop, at_us))
        return outputs

    # ---------------------------------------------------------------- the entrance check

    def refused(self, source: int, message: Message | Malformed, now_us: int) -> Outputs | None:
        """None if a message from an address without a member is taken, else what refusing it does."""
        self.conflicts.heard(source, now_us)
        return self.foreign_group(source, message, now_us)

    def foreign_group(
        self, source: int, message: Message | Malformed, now_us: int
    ) -> Outputs | None:
        """None if the message is no frame of another maker, else what refusing it does."""
        if type(message) not in PROPRIETARY:
            return None
        if source == self.joining.address:
            doubled = self.conflicts.speaks_from_our_address(message, now_us)
            return [*doubled, *self.joining.violated(now_us)]
        origin = self.origins.of(source)
        if origin is Origin.OURS or isinstance(message, Malformed):
            return None
        unclaimed = origin is Origin.UNCLAIMED and self.safety.keyed
        if isinstance(message, SIGNED) and (unclaimed or self._tag_decides(source, now_us)):
            return None
        self.origins.count(origin, message)
        if origin is not Origin.UNCLAIMED:
            if isinstance(message, SIGNS_OF_LIFE):
                self._ask_again(source, now_us)
            return NOTHING
        self.origins.keep(source, message, now_us)
        self.name_discovery.asks.stranger(source, now_us, NAME_PATIENCE_US)
        if isinstance(message, Pose) and self.safety.latched and not message.stopped:
            return self.safety.tell_stops(now_us)  # the sender does not know the stops that hold us
        return NOTHING

    def doubted(self, source: int, message: AnyStop, now_us: int) -> Outputs | None:
        """None if a stop from this address counts as a stop of our fleet, else what it does instead.

        A frame of another maker is not a stop of ours. If no claim of the address is known, stand
        still until the sender has claimed it, and ask for the claim
        (`agent/peer/unknown_stop_sources.py`). With keys the tag decides immediately, also
        where another maker has just claimed the address of our device: both may speak from it.
        """
        origin = self.origins.of(source)
        asks = self.name_discovery.asks
        if origin is Origin.FOREIGN:
            if self._tag_decides(source, now_us):
                return None
            self.origins.count(origin, message)
            if self._ask_again(source, now_us):
                self.origins.keep(source, message, now_us)
            return NOTHING
        if origin is not Origin.UNCLAIMED or source in (self.joining.address, NULL_ADDRESS):
            # A robot without an address presses from the null address; no other device may do that.
            return None
        if self.safety.keyed or self.doubts.believes(source):
            asks.stranger(source, now_us, 0)
            return None
        asks.urge(source, now_us)
        self.origins.count(origin, message)
        end_at_us = self.doubts.hold(source, message, now_us)
        why = f"a stop from address {source}, which no device has claimed"
        held_for_us = max(DOUBTED_HOLD_US, end_at_us - now_us)
        self.safety.raise_cause(StopCause.UNAUTHENTICATED_STOP, now_us, why, held_for_us)
        return [HALT]

    def _tag_decides(self, source: int, now_us: int) -> bool:
        """Whether another maker has claimed the address of our device a moment ago, so that either may
        speak from it, and a tag tells which.

        Without this, who repeats such a claim takes the stop away from panels and robots with keys."""
        return self.safety.keyed and now_us < self._contended_end_at_us.get(source, 0)

    def _ask_again(self, source: int, now_us: int) -> bool:
        """Ask an address of another maker for its NAME again if its claim is old; whether it is.

        The address sends what only our devices send. After a cut of the bus, a device of ours may
        have it."""
        old = now_us - self._claimed_at_us.get(source, 0) >= CLAIM_OLD_US
        if old:
            self.name_discovery.asks.stranger(source, now_us, 0)
        return old

    # ---------------------------------------------------------------- received

    def _address_claimed(self, ctx: StepContext, header: Header, m: AddressClaimed) -> Outputs:
        source, now_us = header.source, ctx.now_us
        outputs: list[Any] = []
        if header.slot is not None and self.joining.changed_hands(source, m):
            outputs.append(notices.AddressTaken(source))
        ours = self.joining.machine.candidate
        claims = self.joining.receive(source, m, now_us)
        if m.name == self.joining.machine.number:
            if source != ours:
                outputs.append(notices.IdentityDoubled(source))
            return [*outputs, *claims]
        outputs += claims
        if source in (NULL_ADDRESS, self.joining.address):
            return outputs
        changes = self.origins.changes(source, m.name)
        if changes or self.conflicts.has_our_name(source):
            outputs.append(notices.ConflictSettled(source))
        if changes and self.origins.of(source) is Origin.OURS:
            self._contended_end_at_us[source] = now_us + CONTENDED_US
        is_known = self.name_discovery.asks.known(source)
        self.origins.claimed(source, m.name)
        self._claimed_at_us[source] = now_us
        if is_known:  # it has sent frames: it may be a member that is not known yet
            outputs.append(notices.RobotNamed(source))
        outputs += [
            notices.HeardAgain(source, stop, at_us) for at_us, stop in self.doubts.end(source)
        ]
        # Now that its NAME is known, as if these messages arrived now.
        kept = self.origins.kept(source, now_us, self.safety.stopped_at_us)
        return [*outputs, *(notices.HeardAgain(source, message, now_us) for message in kept)]

    def _count_malformed(self, ctx: StepContext, header: Header, m: Malformed) -> Outputs:
        self.malformed[m.reason] += 1
        return NOTHING
