"""Conflicts with other machines: a different field description, or our own identity.

Such a conflict lasts while that machine sends frames. It ends when the machine agrees, when
another device claims its address, or when it was not received for `GONE_US`. A device that takes the
address later has no part in it.

Two machines with one identity may also share one address, because equal NAMEs do not contend. Then
each receives beats from its own address that it did not send. A driver may loop back our own frames,
so these are recognised. Two machines with different NAMEs may meet on one address when a cut bus
heals. An address claim separates them, so they get a second for that.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

from agent.interface.config import S
from agent.interface.effects import HALT, Effect, Trace
from agent.peer import notices
from agent.peer.network_join import NetworkJoin
from agent.peer.part import NOTHING, Listener, Outputs, Part, StepContext
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController
from protocol.frames.codec import packed
from protocol.frames.fleet_frames import Heartbeat, Pose

GONE_US = 5 * S  # a robot sends at least five beats a second
TOLD_APART_US = 1 * S  # a claim, its answer, and the move to another address take 0.25 s
OURS_US = 2 * S  # frames that we sent from an earlier address may still be looped back
SAID_MAX = 64  # own beats that may still be looped back: 2 s of them


class Conflicts(Part):
    """The part that holds this robot while another machine contradicts its identity or field."""

    def __init__(self, safety: StopController, joining: NetworkJoin) -> None:
        self.safety, self.joining = safety, joining
        self._cause_of: dict[int, StopCause] = {}  # address of the other machine
        self._ends_at_us: dict[int, int] = {}  # if nothing more is received from that address
        self._why: dict[int, str] = {}  # for people, by address
        self._said: deque[tuple[type, bytes]] = deque(maxlen=SAID_MAX)
        # since when another machine sends from our address
        self._doubled_first_at_us: int | None = None
        self._doubled_last_at_us = -GONE_US

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {
            notices.FieldDiffers: self._field_differs,
            notices.IdentityDoubled: lambda ctx, n: self.claims_our_name(n.address, ctx.now_us),
            notices.ConflictSettled: self._settled,
        }

    def _field_differs(self, ctx: StepContext, notice: notices.FieldDiffers) -> Outputs:
        return self.found(StopCause.CONFIG_MISMATCH, notice.address, notice.why, ctx.now_us)

    def _settled(self, ctx: StepContext, notice: notices.ConflictSettled) -> Outputs:
        self.settled(notice.address, ctx.now_us)
        return NOTHING

    # ---------------------------------------------------------------- others

    def found(self, cause: StopCause, address: int, why: str, now_us: int) -> Sequence[Effect]:
        """That machine cannot work with us: stand still while it sends frames."""
        new = self._cause_of.get(address) is not cause
        self._cause_of[address], self._ends_at_us[address] = cause, now_us + GONE_US
        self._why[address] = why
        self.safety.raise_cause(cause, now_us, self._detail(cause, now_us), GONE_US)
        told = [Trace("safety", "", cause.name, "PROTECTIVE", f"address {address}")] if new else []
        return [HALT, *told]

    def heard(self, address: int, now_us: int) -> None:
        """A frame of that address: a known conflict still exists, so extend its stop."""
        cause = self._cause_of.get(address)
        if cause is None or address == self.joining.address:
            return  # at our own address, `speaks_from_our_address` tells our frames from others
        if now_us >= self._ends_at_us[address]:
            del self._cause_of[address]
        else:
            self._ends_at_us[address] = now_us + GONE_US
            self.safety.raise_cause(cause, now_us, self._detail(cause, now_us), GONE_US)

    def has_our_name(self, address: int) -> bool:
        """Whether a device at this address was found to have our identity."""
        return self._cause_of.get(address) is StopCause.DUPLICATE_ID

    def settled(self, address: int, now_us: int) -> None:
        """End the conflict: the machine agrees, or another device has its address."""
        cause = self._cause_of.pop(address, None)
        if cause is None:
            return
        detail = self._detail(cause, now_us)
        if not detail:
            self.safety.clear_cause(cause, now_us)
        elif self.safety.holds(cause):
            self.safety.raise_cause(cause, now_us, detail)

    def _detail(self, cause: StopCause, now_us: int) -> str:
        """Which machine the cause is about, of several the one that was found first; empty: none."""
        for address, found in self._cause_of.items():
            if found is cause and now_us < self._ends_at_us[address]:
                return f"address {address}: {self._why[address]}"
        return ""

    # ---------------------------------------------------------------- ourselves

    def say(self, beat: Pose | Heartbeat) -> None:
        """Remember our own beacon or heartbeat as it is sent."""
        self._said.append((type(beat), packed(beat)))

    def claims_our_name(self, address: int, now_us: int) -> Sequence[Effect]:
        """A claim of our NAME, or a MEMBER frame with our slot, from an address that is not ours."""
        if self.joining.spoke_from(address, now_us - OURS_US):
            return ()
        return self.found(StopCause.DUPLICATE_ID, address, "it has our identity", now_us)

    def speaks_from_our_address(self, message: object, now_us: int) -> Sequence[Effect]:
        """A received frame with our own source address."""
        if not isinstance(message, Pose | Heartbeat):
            return ()
        if (type(message), packed(message)) in self._said:
            return ()
        if self._doubled_first_at_us is None or now_us - self._doubled_last_at_us > GONE_US:
            self._doubled_first_at_us = now_us
        self._doubled_last_at_us = now_us
        if now_us - self._doubled_first_at_us < TOLD_APART_US:
            return ()
        address = self.joining.address
        assert address is not None
        return self.found(StopCause.DUPLICATE_ID, address, "it has our identity", now_us)
