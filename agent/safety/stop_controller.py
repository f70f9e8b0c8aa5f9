"""Whether this robot may move: the stop set, every other cause, and the gate before the drive.

Small and separate on purpose. Causes are raised and cleared here and nowhere else; the worst active
one decides. The gate is the last function before `Drive`. What each cause means and what clears it
is declared in `agent/safety/stop_cause.py`; the bounds are in `docs/how/safety_case.md`.
"""

from collections.abc import Collection, Mapping, Sequence
from math import hypot, isfinite

from agent.interface.config import MEMBERSHIP_STABLE_US, MS, STOP_REPEAT_US, STOP_SPACING_US, S
from agent.interface.effects import HALT, Drive, Effect, GatedDrive, Persist, Send, Trace
from agent.interface.identity import SilencePolicy
from agent.interface.instants import FOREVER_US
from agent.safety.command_authentication import CommandAuthority
from agent.safety.standard_stop import STOPS, OwnButton, ShortcutButtons
from agent.safety.stop_cause import CREEP, LEAST, NOT_STARTED, SILENT, WORST, Severity, StopCause
from crdt.stops import RemoteStopDot, RemoteStopSet, StopDot, StopSet, held_digest, next_in_rotation
from protocol.authentication import Keyring
from protocol.frames.operator_frames import OperatorGoal
from protocol.frames.safety_frames import (
    AllImplementsStop,
    Command,
    EmergencyReset,
    EmergencyStop,
    HeldReset,
    OperatorCommand,
    Reason,
    StopsHeld,
)  # fmt: skip

# Keys of durable memory. FAR_KEY holds the stops of other segments.
STOPS_KEY, COUNTER_KEY, HOLD_KEY = "stops", "stop_counter", "hold"
FAR_KEY = "far_stops"
FREE, HELD, LATCHED = b"\0", b"\1", b"\2"  # in HOLD_KEY: a restart resets and starts nothing
CREEP_M_S = 0.5  # highest speed under a SLOW cause
# A stop without a valid tag holds this long after its last frame: a simple panel sends it once a second.
UNAUTHENTICATED_HOLD_US = 1_500 * MS
# Repeat for 2 s; then the heartbeats' stopped bit carries the latch.
# Stop after 1 s if no member is known: we may have just booted.
REPEATS_MAX, REPEATS_ALONE = 400, 200
REPEAT_UNHEARD_US = 50 * MS  # while no frame leaves: repeat slower, and do not count the repeats
# 20 repeats. A member still reporting "not stopped" may hold our dot as cleared; press a new one.
AGAIN_US = 100 * MS
AGAIN_MAX = 3  # further dots for one press; after these, that member cannot receive us at all
TOLD_MAX = 4  # stops sent per reply (2 ms of bus), rotating through the set
ANSWER_SPACING_US = 100 * MS  # minimum spacing of replies to members that report "not stopped"
SPENT_HOLD_US = UNAUTHENTICATED_HOLD_US  # hold after its last frame
SPENT_FORGET_US = 3 * S  # a panel that sends its stop once a second is still pressed within this
RENEWALS_MAX = 8  # further dots for one press because robots report its dot as already used
COUNT_TOLD_MAX = 255  # largest count in STOPS_HELD
# Under these causes no frame of ours leaves.
_MUTE = frozenset({StopCause.UNHEARD, StopCause.BUS_OFF, StopCause.ADDRESS_LOST})
STANDS = (Command.HOLD, Command.STOP, Command.WAIT)  # these start no motion, so one tag is enough


class StopController:
    """The stop set, all other causes, and the last word on every drive command of one robot.

    Methods return effects in the order in which they must be performed: brake, send, persist. All
    times are microseconds on the peer's clock. A dot names one press: slot, incarnation, counter
    (`crdt/stops.py`).
    """

    def __init__(
        self,
        slot: int,
        incarnation: int,
        policy: SilencePolicy,
        keyring: Keyring | None,
        recalled: Mapping[str, bytes],
        now_us: int,
    ) -> None:
        """`slot`: ours. `incarnation`: 16 bits, another number after each loss of memory. `policy`:
        what ends a stop by silence. `keyring`: None in a fleet without keys. `recalled`: durable
        memory as it was before the start; the keys are `STOPS_KEY`, `FAR_KEY`, `COUNTER_KEY` and
        `HOLD_KEY`. A stop set that cannot be read raises BOOT_UNCONFIRMED instead of an exception.
        """
        self.slot, self.incarnation = slot, incarnation & 0xFF
        self.policy, self.authority = policy, CommandAuthority(slot, keyring)
        self.stops, self.far = StopSet(), RemoteStopSet()
        # A stop frame carries only the low byte of the incarnation. A robot without memory therefore
        # starts its counter with the high byte.
        began = bytes((incarnation >> 8 & 0xFF,))
        self.counter = int.from_bytes(recalled.get(COUNTER_KEY, began), "little")
        self._causes: dict[StopCause, str] = {StopCause.NOT_STARTED: "boot"}
        self._expires_at_us: dict[StopCause, int] = {}
        self._live: frozenset[int] = frozenset({slot})
        self._silent: frozenset[int] = frozenset()
        self._stable_at_us = now_us
        self.stopped_at_us = -STOP_SPACING_US  # when the newest stop was pressed or received
        self.last_stop: tuple[int, Reason] | None = None  # slot of the presser, and the reason
        self._reasons: dict[StopDot, Reason] = {}  # reasons of our own presses still being repeated
        self._echoes: dict[StopDot, set[int]] = {}  # of stops that we hold: who has said each
        self._own: dict[StopDot, int] = {}  # dots we repeat as their source -> repeats left
        self._free: set[int] = set()  # members that were not stopped at our press or later
        self._repeat_at_us, self._again, self._pressed_at_us = FOREVER_US, 0, -STOP_SPACING_US
        self._newest: StopDot | None = None  # of our newest press
        self._answered_at_us = -ANSWER_SPACING_US
        self.buttons, self.button = ShortcutButtons(), OwnButton()
        self._asked_at_us = self._repeated_at_us = -ANSWER_SPACING_US
        # Stops sent with a dot that was cleared before: time of the first and of the newest frame.
        self._spent_first_at_us = self._spent_last_at_us = -SPENT_FORGET_US
        self._spent_told_at_us = -ANSWER_SPACING_US
        self._renew_at_us, self._renewals = FOREVER_US, 0
        # Last dot sent by `tell_stops`; the rotation goes on there.
        self._told: StopDot | None = None
        self._recall(recalled)

    def _recall(self, recalled: Mapping[str, bytes]) -> None:
        try:
            if STOPS_KEY in recalled:
                self.stops = StopSet.deserialize(recalled[STOPS_KEY])
            if FAR_KEY in recalled:
                self.far = RemoteStopSet.deserialize(recalled[FAR_KEY])
        except ValueError:
            self._causes[StopCause.BOOT_UNCONFIRMED] = "the stop set on disk is unreadable"
        if self.stops.latched or self.far.latched or recalled.get(HOLD_KEY) == LATCHED:
            self._causes[StopCause.STOP_DOT] = "latched before the restart"
        self.held = recalled.get(HOLD_KEY, FREE) != FREE

    # ---------------------------------------------------------------- state

    @property
    def free(self) -> bool:
        """Whether no cause limits the motion of this robot."""
        return not self._causes

    @property
    def latched(self) -> bool:
        """Whether a cause is active that only a person at this machine ends."""
        causes = self._causes
        return bool(causes) and any(cause.severity is WORST for cause in causes)

    @property
    def severity(self) -> Severity:
        """The worst severity of all active causes."""
        if not self._causes:
            return Severity.CLEAR
        return max(cause.severity for cause in self._causes)

    @property
    def causes(self) -> tuple[tuple[StopCause, str], ...]:
        """The active causes with their details, worst first, then by name."""
        return tuple(
            sorted(self._causes.items(), key=lambda item: (-item[0].severity, item[0].name))
        )

    @property
    def keyed(self) -> bool:
        """Whether this fleet has keys, so that stops and releases need a valid tag."""
        return self.authority.keyring is not None

    @property
    def unconfirmed(self) -> bool:
        """Whether memory was lost and no person has confirmed yet that this machine may go on
        without it.
        """
        return StopCause.BOOT_UNCONFIRMED in self._causes

    @property
    def started(self) -> bool:
        """Whether a start was given since boot and since an operator's hold."""
        return NOT_STARTED not in self._causes

    @property
    def may_move(self) -> bool:
        """Whether no active cause is worse than SLOW."""
        causes = self._causes
        return not causes or all(cause.severity is LEAST for cause in causes)

    def echoed(self, dot: StopDot) -> frozenset[int]:
        """The slots that have sent or echoed this dot."""
        return frozenset(self._echoes.get(dot, ()))

    def holds(self, cause: StopCause) -> bool:
        """Whether this cause is active."""
        return cause in self._causes

    def raise_cause(self, cause: StopCause, now_us: int, detail: str = "", for_us: int = 0) -> None:
        """Make a cause active, or renew it.

        `detail`: what it is about, for people. `for_us`: the cause ends by itself after this many
        microseconds, and not before the end that it had; with 0 it has no end, or keeps that one.
        """
        self._causes[cause] = detail
        if for_us:
            ends_at_us = self._expires_at_us.get(cause, 0)
            self._expires_at_us[cause] = max(ends_at_us, now_us + for_us)

    def clear_cause(self, cause: StopCause, now_us: int) -> None:
        """End a cause; nothing happens if it is not active."""
        self._causes.pop(cause, None)
        self._expires_at_us.pop(cause, None)

    def hold_while(self, cause: StopCause, there: bool, why: str, now_us: int) -> list[Effect]:
        """Raise a protective cause or end it, so that it is active while it is `there`.

        `why`: what it is about, for people. Empty if nothing changes.
        """
        if there == self.holds(cause):
            return []
        if there:
            self.raise_cause(cause, now_us, why)
            return [HALT, Trace("safety", "", cause.name, "PROTECTIVE", why)]
        self.clear_cause(cause, now_us)
        return [Trace("safety", "PROTECTIVE", cause.name, "", "gone")]

    # ---------------------------------------------------------------- stops

    def press(self, reason: Reason, now_us: int, free: Collection[int] = ()) -> Sequence[Effect]:
        """Emergency stop at this machine: brake, send, then persist. Braking waits for nothing.

        `free`: slots of members that are not stopped now. For these, a beat with the stopped bit
        counts as an echo. All other members have to echo the dot itself. A second press within
        `STOP_SPACING_US` is the same press and only brakes.
        """
        # A second press within the spacing is the same press, unless an operator has cleared that one
        # meanwhile. A clock set back does not count as one.
        same = 0 <= now_us - self._pressed_at_us < STOP_SPACING_US
        if same and self._newest in self.stops.active:
            return [HALT]
        self._again, self._renewals, self._free = AGAIN_MAX, RENEWALS_MAX, set(free)
        return self._press(reason, now_us)

    def _press(self, reason: Reason, now_us: int) -> Sequence[Effect]:
        self._pressed_at_us = self.stopped_at_us = now_us
        dot, self.counter = self.stops.unused(self.slot, self.incarnation, self.counter)
        self.stops.press_own(dot)
        self._newest = dot
        self._renew_at_us = FOREVER_US
        self.last_stop, self._reasons[dot] = (self.slot, reason), reason
        self._causes[StopCause.STOP_DOT] = f"pressed here: {reason.name}"
        self._own[dot], self._repeat_at_us = REPEATS_MAX, now_us + STOP_REPEAT_US
        return [
            HALT,
            Send(self._stop(dot, reason)),
            Send(self.button.press(now_us)),
            *self._remember(),
            Trace("safety", "", "PRESSED", "LATCHED", reason.name),
        ]

    def receive_stop(
        self, m: EmergencyStop, source_slot: int | None, now_us: int, source: int | None = None
    ) -> Sequence[Effect]:
        """A stop frame: its first reception brakes, echoes once and persists; later ones only count
        echoes.

        `source_slot`: the slot of the sender, or None if its address is not bound to one. `source`: its
        bus address, for people who look for it; None: not known. A stop
        without a valid tag brakes for `UNAUTHENTICATED_HOLD_US` after its last frame and challenges
        its signer.
        """
        dot = StopDot(m.slot, m.incarnation, m.counter)
        if m.spent:
            return self._hear_spent(dot, source_slot, source, now_us)
        signer = source_slot if m.echo else m.slot
        silent = source_slot is None or not (m.echo or m.slot == source_slot)
        said = () if silent or source_slot is None else (source_slot,)
        if dot in self.stops.active:
            self._echoes.setdefault(dot, set()).update(said)
            return ()
        if not self.authority.believes(m, signer, now_us):
            why = said_by(dot, source)
            self.raise_cause(StopCause.UNAUTHENTICATED_STOP, now_us, why, UNAUTHENTICATED_HOLD_US)
            return [HALT, *self.authority.ask(signer, now_us)]
        if self.stops.is_cleared(dot):  # by an operator, exactly this dot: an echo is late
            return () if m.echo else self._press_spent(dot, now_us, source)
        if self.stops.full:
            return self._hold_more(m.echo, now_us)
        self.stops.press(dot)
        self.stopped_at_us = now_us
        reason = Reason(min(m.reason, max(Reason)))
        self.last_stop = m.slot, reason
        self._renew_at_us = FOREVER_US
        self._causes[StopCause.STOP_DOT] = f"{dot.slot}.{dot.incarnation}.{dot.counter}"
        self._echoes[dot] = {self.slot, *said}
        return [
            HALT,
            Send(self._stop(dot, reason, echo=True)),
            *self._remember(),
            Trace("safety", "", "HEARD_STOP", "LATCHED", f"dot {dot}"),
        ]

    def _press_spent(self, dot: StopDot, now_us: int, source: int | None) -> Sequence[Effect]:
        """A press with a dot that was cleared before.

        These are late frames of an old press, or a new press of a panel that has only this dot or
        whose next dots were cleared in advance. The robot brakes, and its answer tells the presser
        to take another dot. A press that is still sent after `AGAIN_US` is a new one. The first
        robot in slot order that is not latched by then presses with a dot of its own.
        """
        self.press_used(dot, now_us, source)
        rank = sum(slot < self.slot for slot in self._live)
        turn_at_us = max(self._spent_told_at_us + ANSWER_SPACING_US, self._spent_first_at_us)
        if now_us < turn_at_us + rank * STOP_REPEAT_US:
            return [HALT]
        self._spent_told_at_us = now_us
        reason = Reason.OPERATOR_INTERVENTION
        answer = EmergencyStop(dot.slot, dot.incarnation, dot.counter, reason, True, spent=True)
        return [HALT, Send(self.authority.sign(answer))]

    def press_used(
        self, dot: StopDot | RemoteStopDot, now_us: int, source: int | None = None
    ) -> Sequence[Effect]:
        """An authenticated press with a dot that was cleared before: brake. `source`: its bus address.

        If it is still sent after `AGAIN_US`, the first robot in slot order presses with a dot of
        its own, unless a stop latches it already.
        """
        if now_us - self._spent_last_at_us > SPENT_FORGET_US or now_us < self._spent_last_at_us:
            self._spent_first_at_us = now_us
        self._spent_last_at_us = now_us
        self.raise_cause(StopCause.SPENT_STOP, now_us, said_by(dot, source), SPENT_HOLD_US)
        if now_us - self._spent_first_at_us >= AGAIN_US and not self.stops.latched:
            rank = sum(slot < self.slot for slot in self._live)
            self._renew_at_us = min(self._renew_at_us, now_us + rank * STOP_REPEAT_US)
        return [HALT]

    def _hear_spent(
        self, dot: StopDot, source_slot: int | None, source: int | None, now_us: int
    ) -> Sequence[Effect]:
        """A member reports that a press used a cleared dot. If the press is ours, press with a new
        dot.
        """
        self._spent_told_at_us = now_us
        if dot not in self._own:
            why = said_by(dot, source)
            if source_slot is not None:  # a robot's answer to the device that people look for
                why = self._causes.get(StopCause.SPENT_STOP, said_by(dot, None))
            self.raise_cause(StopCause.SPENT_STOP, now_us, why, SPENT_HOLD_US)
            return [HALT]
        if not self._renewals or now_us - self._pressed_at_us < STOP_SPACING_US:
            return ()
        self._renewals -= 1
        return self._press(Reason.OPERATOR_INTERVENTION, now_us)

    def _hold_more(self, echo: bool, now_us: int) -> Sequence[Effect]:
        """More stops than can be held by name.

        The digest of the held stops changes with each press but not with its repetition, so a reset
        that names an earlier digest does not clear this press."""
        first = not self.stops.more
        if not first and (echo or now_us - self._repeated_at_us < STOP_SPACING_US):
            return ()
        self.stops.press_more()
        self._repeated_at_us = now_us
        return [HALT, *self._remember()] if first else ()

    def latch_far(self, dot: RemoteStopDot, now_us: int) -> Sequence[Effect]:
        """An authenticated stop of another segment: brake, then persist."""
        more = self.far.more
        if not self.far.press(dot):
            first = self.far.more and not more
            return [HALT, Persist(FAR_KEY, self.far.serialize())] if first else ()
        self._causes[StopCause.STOP_DOT] = (
            f"{dot.segment}/{dot.slot}.{dot.incarnation}.{dot.counter}"
        )
        return [
            HALT,
            Persist(FAR_KEY, self.far.serialize()),
            self.remember_hold(),
            Trace("safety", "", "HEARD_STOP", "LATCHED", f"{dot}"),
        ]

    def clear_far(self, dot: RemoteStopDot) -> Sequence[Effect]:
        """An authenticated reset that is valid in all segments."""
        if not self.far.clear(dot):
            return ()
        remembered = [Persist(FAR_KEY, self.far.serialize()), self.remember_hold()]
        return [*remembered, Trace("safety", "", "CLEARED", "", f"{dot}")]

    def press_near(self, dot: StopDot, now_us: int) -> Sequence[Effect]:
        """An authenticated stop of this segment that we missed and that came back from another
        segment.
        """
        if self.stops.full and not self.stops.is_cleared(dot):
            return self._hold_more(True, now_us)
        if not self.stops.press(dot):
            return ()
        self.stopped_at_us = now_us
        self._renew_at_us = FOREVER_US
        self._causes[StopCause.STOP_DOT] = f"{dot.slot}.{dot.incarnation}.{dot.counter}"
        return [
            HALT,
            Send(self._stop(dot, Reason.OPERATOR_INTERVENTION, echo=True)),
            *self._remember(),
            Trace("safety", "", "HEARD_STOP", "LATCHED", f"{dot}"),
        ]

    def clear_near(self, dot: StopDot, who: str, now_us: int) -> Sequence[Effect]:
        """Clear one dot of this segment and persist that; no effects if it was cleared before.

        `who`: by whom it was cleared, for the trace. A robot that has not received the stop has missed
        it, and the others stand yet. So it waits for a start, as they do after their reset.
        """
        missed = dot not in self.stops.active and not self.latched
        if not self.stops.clear(dot):
            return ()
        self._end_press(dot)
        held: list[Effect] = []
        if missed:
            self.raise_cause(StopCause.NOT_STARTED, now_us, "a stop that it missed was cleared")
            held = [HALT, Trace("safety", "", "MISSED_STOP", "HELD", f"{dot}")]
        cleared = Trace("safety", "", "CLEARED", "", f"dot {dot} by {who}")
        return [*held, *self._remember(), cleared]

    def beat(self, slot: int, stopped: bool, now_us: int) -> Sequence[Effect]:
        """A member's beat: a stopped bit that was not set before counts as an echo of our press.

        A member whose stopped bit is not set has not received our press. The source of the press
        then presses again with a new dot, up to `AGAIN_MAX` times; other robots send the stops that
        they hold.
        """
        active = self.stops.latched
        if stopped:
            for dot in self._own if slot in self._free else ():
                self._echoes.setdefault(dot, set()).add(slot)
            return ()
        if active:
            self._free.add(slot)
        if self._own and self._again and now_us - self._pressed_at_us >= AGAIN_US:
            self._again -= 1
            return self._press(Reason.OPERATOR_INTERVENTION, now_us)
        return self.tell_stops(now_us) if active else ()

    def tell_stops(self, now_us: int) -> Sequence[Effect]:
        """Echoes of up to `TOLD_MAX` stops that we hold, for members that miss them.

        At most one reply in `ANSWER_SPACING_US`; the next reply goes on where this one ended.
        """
        if now_us - self._answered_at_us < ANSWER_SPACING_US:
            return ()
        self._answered_at_us = now_us
        dots = next_in_rotation(self.stops.active, self._told, TOLD_MAX)
        self._told = dots[-1] if dots else None
        return [Send(self._stop(d, Reason.OPERATOR_INTERVENTION, echo=True)) for d in dots]

    def answer_stops(self, question: int, now_us: int) -> Sequence[Effect]:
        """The answer to an operator's question which stops hold us: some dots by name, and a digest
        of all.

        `question`: the 48-bit nonce of the challenge; it is used once.
        """
        told = self.tell_stops(now_us)
        if now_us - self._asked_at_us < ANSWER_SPACING_US or not self.latched:
            return told
        self._asked_at_us = now_us
        return [*told, Send(self.authority.vouch(self.held_stops, question))]

    @property
    def held_stops(self) -> StopsHeld:
        """How many stops hold this robot, at most `COUNT_TOLD_MAX`, and the digest of all of them;
        no tag yet.
        """
        named, more = len(self.stops.active) + len(self.far.active), self.stops.more + self.far.more
        count = COUNT_TOLD_MAX if more else min(named, COUNT_TOLD_MAX)
        return StopsHeld(self.slot, count, held_digest(self.stops, self.far))

    def receive_held_reset(self, m: HeldReset, now_us: int) -> Sequence[Effect]:
        """An operator's reset of all held stops: valid if its digest matches, so that nothing was
        pressed since our answer.
        """
        if not self.authority.believes(m, m.operator, now_us):
            return self.authority.ask(m.operator, now_us)
        held = self.held_stops
        if not self.authority.agreed(m, now_us) or not held.stops or held.digest != m.digest:
            return ()
        for dot in self.stops.clear_all():
            self._end_press(dot)
        self.far.clear_all()
        cleared = Trace("safety", "", "CLEARED", "", f"all that are held by {m.operator}")
        return [Persist(FAR_KEY, self.far.serialize()), *self._remember(), cleared]

    def receive_reset(self, m: EmergencyReset, now_us: int) -> Sequence[Effect]:
        """An operator's reset of exactly the dot that it names, even if that dot was not received
        yet.
        """
        if not self.authority.believes(m, m.operator, now_us):
            return self.authority.ask(m.operator, now_us)
        if not self.authority.agreed(m, now_us):
            return ()
        dot = StopDot(m.slot, m.incarnation, m.counter)
        return self.clear_near(dot, f"{m.operator}", now_us)

    def receive_implements_stop(
        self, source: int, name: int | None, robot: bool, m: AllImplementsStop, now_us: int
    ) -> Sequence[Effect]:
        """The standard frame, from any device. Each button is a level that holds while it is
        repeated.

        `source`: bus address. `name`: the NAME that this address has claimed, or None. `robot`: the
        sender is a fleet member.
        """
        self.buttons.on_message(source, name, robot, m, now_us)
        if robot:
            self.button.on_message(m, now_us)
        held_for_us, held = (
            self.buttons.ends_at_us() - now_us,
            StopCause.IMPLEMENTS_STOP in self._causes,
        )
        if held_for_us <= 0:
            self.clear_cause(StopCause.IMPLEMENTS_STOP, now_us)
            return ()
        holder = self.buttons.holder(now_us)
        about = f"address {source if holder is None else holder}"
        self._expires_at_us.pop(StopCause.IMPLEMENTS_STOP, None)  # a permit may end it earlier
        self.raise_cause(StopCause.IMPLEMENTS_STOP, now_us, about, held_for_us)
        return [HALT] if m.switch in STOPS or not held else ()

    def say_button(self, live: Collection[int], now_us: int) -> Sequence[Effect]:
        """With a beat: the standard frame, if an emergency stop holds us or has just ended.

        `live`: slots of the live members; the lowest one sends first.
        """
        latched = StopCause.STOP_DOT in self._causes
        if not latched and not self.button.speaks:
            return ()
        rank = sum(slot < self.slot for slot in live)
        said = self.button.outgoing(latched, rank, now_us)
        return () if said is None else [Send(said)]

    def accept_order(
        self, m: OperatorCommand | OperatorGoal, now_us: int
    ) -> Sequence[Effect] | None:
        """None if the order has authority. Otherwise the effects to perform instead of the order.

        Orders in `STANDS` start no motion and need one valid frame; all others need two equal ones.
        """
        if not self.authority.believes(m, m.operator, now_us):
            return self.authority.ask(m.operator, now_us)
        stands = isinstance(m, OperatorCommand) and m.command in STANDS
        return None if stands or self.authority.agreed(m, now_us) else ()

    # ---------------------------------------------------------------- people at this machine

    def manual_reset(self, now_us: int) -> bool:
        """Unlatch this machine; returns False if it is refused.

        It is refused while a dot is not cleared, or while a cause is active that never clears.
        """
        if self.stops.latched or self.far.latched or StopCause.DISK_ERROR in self._causes:
            return False
        for cause in (StopCause.STOP_DOT, StopCause.BOOT_UNCONFIRMED):
            self._causes.pop(cause, None)
        return True

    def waits_for_start(self, named: bool) -> bool:
        """Whether a start would end a cause; `named`: one for this machine alone."""
        ends = (StopCause.NOT_STARTED, StopCause.PLACE_FROZEN)
        return any(map(self.holds, ends)) or (named and self.holds(StopCause.PLACE_LOST))

    def start(self, now_us: int, named: bool = False) -> Sequence[Effect]:
        """A person starts this machine: NOT_STARTED and PLACE_FROZEN end. PLACE_LOST ends only by a
        start that is for this machine alone (`named`): a start of the whole fleet does not vouch for
        the place of each robot."""
        self.clear_cause(StopCause.NOT_STARTED, now_us)
        self.clear_cause(StopCause.PLACE_FROZEN, now_us)
        if named:
            self.clear_cause(StopCause.PLACE_LOST, now_us)
        return [self.remember_hold()]

    def hold(self, now_us: int) -> Sequence[Effect]:
        """An operator holds this robot until the next start, also over a restart."""
        self.raise_cause(StopCause.NOT_STARTED, now_us, "held by an operator")
        return [HALT, self.remember_hold()]

    def remember_hold(self) -> Persist:
        """Persist what a person still has to do at this machine, so that it survives a restart."""
        self.held = not self.started
        return Persist(HOLD_KEY, LATCHED if self.latched else HELD if self.held else FREE)

    # ---------------------------------------------------------------- members and time

    def members(
        self, live: frozenset[int], silent: frozenset[int], now_us: int
    ) -> Sequence[Effect]:
        """The membership has changed. New silence brakes immediately; the policy ends that stop
        later.

        `live`: slots that are received, our own included. `silent`: slots that fell silent without
        leaving.
        """
        brake = bool(silent - self._silent)
        self._live, self._silent, self._stable_at_us = live, silent, now_us
        if brake:
            self.clear_cause(StopCause.CREEP, now_us)
            self.raise_cause(StopCause.MEMBER_SILENT, now_us, f"silent {sorted(silent)}")
            return [HALT, Trace("safety", "", "SILENCE", "PROTECTIVE", f"{sorted(silent)}")]
        return ()

    @property
    def due_at_us(self) -> int:
        """The earliest time at which `on_tick` has something to do."""
        deadline = min(self._repeat_at_us, self._renew_at_us)
        if not self._causes:  # only causes expire
            return deadline
        if self._settles:
            deadline = min(deadline, self._stable_at_us + MEMBERSHIP_STABLE_US)
        for expires_at_us in self._expires_at_us.values():
            deadline = min(deadline, expires_at_us)
        return deadline

    def on_tick(self, now_us: int) -> Sequence[Effect]:
        """Whatever is due now: causes end, stops are repeated, a press that was due to us is made."""
        if now_us < self.due_at_us:
            return ()
        for cause in [
            c for c, expires_at_us in self._expires_at_us.items() if expires_at_us <= now_us
        ]:
            self.clear_cause(cause, now_us)
        self._end_silence(now_us)
        if now_us >= self._renew_at_us:
            self._renew_at_us = FOREVER_US
            if not self.stops.latched:
                return self.press(Reason.OPERATOR_INTERVENTION, now_us)
        return self._repeat(now_us) if now_us >= self._repeat_at_us else ()

    @property
    def _settles(self) -> bool:
        """Whether a stable membership would clear or change a cause."""
        if SILENT in self._causes:
            return not self._silent or self.policy is not SilencePolicy.STOP
        return CREEP in self._causes and not self._silent

    def _end_silence(self, now_us: int) -> None:
        if not self._settles or now_us < self._stable_at_us + MEMBERSHIP_STABLE_US:
            return
        self.clear_cause(StopCause.MEMBER_SILENT, now_us)
        if self._silent and self.policy is SilencePolicy.SLOW:
            self.raise_cause(StopCause.CREEP, now_us, f"silent {sorted(self._silent)}")
        else:
            self.clear_cause(StopCause.CREEP, now_us)

    def _repeat(self, now_us: int) -> Sequence[Effect]:
        """As the source of a stop, repeat it every 5 ms until every live member has echoed it.

        A repeat that no node can hear does not count. Meanwhile another robot may have stopped the
        members, so their stopped bit no longer counts as an echo.
        """
        sends, others = list[Effect](), self._live - {self.slot}
        unheard = not _MUTE.isdisjoint(self._causes)
        if unheard:
            self._free.clear()
        for dot, left in sorted(self._own.items()):
            enough = left <= (0 if others else REPEATS_MAX - REPEATS_ALONE)
            if enough or (others and others <= self._echoes.get(dot, set())):
                del self._own[dot]
                self._reasons.pop(dot, None)
                continue
            self._own[dot] = left - (not unheard)
            reason = self._reasons.get(dot, Reason.OPERATOR_INTERVENTION)
            sends.append(Send(self._stop(dot, reason)))
        pause_for_us = REPEAT_UNHEARD_US if unheard else STOP_REPEAT_US
        self._repeat_at_us = now_us + pause_for_us if self._own else FOREVER_US
        return sends

    # ---------------------------------------------------------------- the gate

    def gate(self, wanted: Drive, now_us: int) -> GatedDrive:
        """The last function before the actuator: what of the wanted drive the active causes permit.

        The result is the drive itself, the same curve at no more than `CREEP_M_S` under a SLOW
        cause, or HALT.
        """
        if not isfinite(wanted.vx_m_s + wanted.vy_m_s + wanted.turn_rad_s):
            return HALT  # no actuator knows what to do with it
        if not self._causes:
            return GatedDrive(wanted)
        severity = self.severity
        if severity >= Severity.PAUSE:
            return HALT
        if severity is Severity.SLOW:
            speed_m_s = hypot(wanted.vx_m_s, wanted.vy_m_s)
            if speed_m_s > CREEP_M_S:
                share = CREEP_M_S / speed_m_s
                slower = wanted._replace(  # the turn rate too, so the curve keeps its radius
                    vx_m_s=wanted.vx_m_s * share,
                    vy_m_s=wanted.vy_m_s * share,
                    turn_rad_s=wanted.turn_rad_s * share,
                )
                return GatedDrive(slower)
        return GatedDrive(wanted)

    # ---------------------------------------------------------------- inside

    def _end_press(self, dot: StopDot) -> None:
        """A stop was cleared: it is repeated no more, and who has said it does not matter."""
        self._own.pop(dot, None)
        self._reasons.pop(dot, None)
        self._echoes.pop(dot, None)

    def _stop(self, dot: StopDot, reason: Reason, echo: bool = False) -> EmergencyStop:
        message = EmergencyStop(dot.slot, dot.incarnation, dot.counter, reason, echo)
        return self.authority.sign(message)

    def _remember(self) -> list[Effect]:
        stops, counter = self.stops.serialize(), self.counter.to_bytes(4, "little")
        return [Persist(STOPS_KEY, stops), Persist(COUNTER_KEY, counter), self.remember_hold()]


def said_by(dot: StopDot | RemoteStopDot, source: int | None) -> str:
    """The detail of a cause: which device says a stop, and which one. `source`: bus address, or None."""
    return f"dot {dot}" if source is None else f"address {source} says dot {dot}"
