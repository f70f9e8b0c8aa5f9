"""Whether this robot may move: the stop set, every other cause, and the gate before the drive.

Small and separate on purpose. Causes are raised and cleared here and nowhere else; the worst active
one decides. The gate is the last function before `Drive`. What each cause means and what clears it
is declared in `agent/safety/stop_cause.py`; the bounds are in `docs/stopping.md`.
"""

from collections.abc import Collection, Mapping, Sequence
from math import hypot

from agent.interface.config import MEMBERSHIP_STABLE_US, MS, STOP_REPEAT_US, STOP_SPACING_US, S
from agent.interface.effects import HALT, Drive, Effect, Persist, Send, Trace
from agent.interface.identity import SilencePolicy
from agent.safety.command_authority import CommandAuthority
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

STOPS_KEY, COUNTER_KEY, HOLD_KEY = "stops", "stop_counter", "hold"
FAR_KEY = "far_stops"  # of other segments
FREE, HELD, LATCHED = b"\0", b"\1", b"\2"  # in HOLD_KEY: a restart resets and starts nothing
CREEP_M_S = 0.5
UNAUTHENTICATED_HOLD_US = 1 * S  # a stop without a valid tag holds this long after its last frame
# 2 s; then the heartbeats' stopped bit carries the latch. 1 s by who knows nobody: it may have just come.
REPEATS_MAX, REPEATS_ALONE = 400, 200
REPEAT_UNHEARD_US = 50 * MS  # nothing leaves: not faster, and without counting
AGAIN_US = 100 * MS  # 20 repeats: who still beats as if nothing was may know our dot as cleared
AGAIN_MAX = 3  # further dots for one press; beyond it that member cannot hear us at all
TOLD_MAX = 4  # stops told at a time to who does not know them: 2 ms of bus; in turns
ANSWER_SPACING_US = 100 * MS  # a member that beats unlatched is told again at most this often
SPENT_HOLD_US = 1_500 * MS  # after its last frame; a simple panel says its stop once a second
SPENT_FORGET_US = 3 * S  # a panel that says its stop once a second says it still
RENEWALS_MAX = 8  # further dots for one press because robots say that it was used before
COUNT_TOLD_MAX = 255  # of STOPS_HELD
FOREVER = 1 << 62
STANDS = (Command.HOLD, Command.STOP, Command.WAIT)  # one tag is enough for what moves nobody


class StopController:
    def __init__(
        self,
        slot: int,
        incarnation: int,
        policy: SilencePolicy,
        keyring: Keyring | None,
        recalled: Mapping[str, bytes],
        now_us: int,
    ) -> None:
        self.slot, self.incarnation = slot, incarnation & 0xFF
        self.policy, self.authority = policy, CommandAuthority(slot, keyring)
        self.stops, self.far = StopSet(), RemoteStopSet()
        # A stop says an incarnation's low byte alone: a life without memory counts from the other one.
        began = bytes((incarnation >> 8 & 0xFF,))
        self.counter = int.from_bytes(recalled.get(COUNTER_KEY, began), "little")
        self._causes: dict[StopCause, str] = {StopCause.NOT_STARTED: "boot"}
        self._expires_us: dict[StopCause, int] = {}
        self._live: frozenset[int] = frozenset({slot})
        self._silent: frozenset[int] = frozenset()
        self._stable_us = now_us
        self.last_stop: tuple[int, Reason] | None = None  # who pressed it, and why
        self._reasons: dict[StopDot, Reason] = {}  # of our own presses that are being repeated
        self._echoes: dict[StopDot, set[int]] = {}
        self._own: dict[StopDot, int] = {}  # dots we repeat as their source -> repeats left
        self._free: set[int] = set()  # at our press, or since: members that did not stand stopped
        self._repeat_us, self._again, self._pressed_us = FOREVER, 0, -STOP_SPACING_US
        self._answered_us = -ANSWER_SPACING_US
        self.buttons, self.button = ShortcutButtons(), OwnButton()
        self._asked_us = self._more_us = -ANSWER_SPACING_US
        # Stops that are said with a name that was cleared before: since when, and the newest frame.
        self._spent_since_us = self._spent_us = -SPENT_FORGET_US
        self._spent_told_us, self._renew_us, self._renewals = -ANSWER_SPACING_US, FOREVER, 0
        self._told: StopDot | None = None  # the last of those told to who did not know them
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
        """Nothing keeps it from moving as it wishes."""
        return not self._causes

    @property
    def latched(self) -> bool:
        return any(cause.severity is WORST for cause in self._causes)

    @property
    def severity(self) -> Severity:
        if not self._causes:
            return Severity.CLEAR
        return max(cause.severity for cause in self._causes)

    @property
    def causes(self) -> tuple[tuple[StopCause, str], ...]:
        return tuple(
            sorted(self._causes.items(), key=lambda item: (-item[0].severity, item[0].name))
        )

    @property
    def keyed(self) -> bool:
        """Whether a tag says who may stop and release."""
        return self.authority.keyring is not None

    @property
    def unconfirmed(self) -> bool:
        """Memory was lost: nobody has yet said that this machine may forget it."""
        return StopCause.BOOT_UNCONFIRMED in self._causes

    @property
    def started(self) -> bool:
        return NOT_STARTED not in self._causes

    @property
    def may_move(self) -> bool:
        return all(cause.severity is LEAST for cause in self._causes)

    def echoed(self, dot: StopDot) -> frozenset[int]:
        return frozenset(self._echoes.get(dot, ()))

    def holds(self, cause: StopCause) -> bool:
        return cause in self._causes

    def raise_cause(self, cause: StopCause, now_us: int, detail: str = "", for_us: int = 0) -> None:
        self._causes[cause] = detail
        if for_us:
            self._expires_us[cause] = now_us + for_us

    def clear_cause(self, cause: StopCause, now_us: int) -> None:
        self._causes.pop(cause, None)
        self._expires_us.pop(cause, None)

    # ---------------------------------------------------------------- stops

    def press(self, reason: Reason, now_us: int, free: Collection[int] = ()) -> Sequence[Effect]:
        """Emergency stop here: brake, send, then remember. Braking waits for nobody. `free`: members that
        do not stand stopped. Of these a beat that says so is an echo; others have to say the dot."""
        if 0 <= now_us - self._pressed_us < STOP_SPACING_US:
            return [HALT]  # the same hand on the same button; a clock set back is no such hand
        self._again, self._renewals, self._free = AGAIN_MAX, RENEWALS_MAX, set(free)
        return self._press(reason, now_us)

    def _press(self, reason: Reason, now_us: int) -> Sequence[Effect]:
        self._pressed_us = now_us
        dot, self.counter = self.stops.unused(self.slot, self.incarnation, self.counter)
        self.stops.press_own(dot)
        self._renew_us = FOREVER
        self.last_stop, self._reasons[dot] = (self.slot, reason), reason
        self._causes[StopCause.STOP_DOT] = f"pressed here: {reason.name}"
        self._own[dot], self._repeat_us = REPEATS_MAX, now_us + STOP_REPEAT_US
        return [
            HALT,
            Send(self._stop(dot, reason)),
            Send(self.button.press(now_us)),
            *self._remember(),
            Trace("safety", "", "PRESSED", "LATCHED", reason.name),
        ]

    def receive_stop(
        self, m: EmergencyStop, source_slot: int | None, now_us: int
    ) -> Sequence[Effect]:
        """First reception: brake, echo once, remember. Later ones count echoes."""
        dot = StopDot(m.slot, m.incarnation, m.counter)
        if m.spent:
            return self._hear_spent(dot, now_us)
        signer = source_slot if m.echo else m.slot
        if source_slot is not None and (m.echo or m.slot == source_slot):
            self._echoes.setdefault(dot, set()).add(source_slot)
        if dot in self.stops.active:
            return ()
        if not self.authority.believes(m, signer, now_us):
            self.raise_cause(
                StopCause.UNAUTHENTICATED_STOP, now_us, f"dot {dot}", UNAUTHENTICATED_HOLD_US
            )
            return [HALT, *self.authority.ask(signer, now_us)]
        if self.stops.is_cleared(dot):  # an operator has cleared exactly this one: an echo is late
            return () if m.echo else self._press_spent(dot, now_us)
        if self.stops.full:
            return self._hold_more(m.echo, now_us)
        self.stops.press(dot)
        reason = Reason(min(m.reason, max(Reason)))
        self.last_stop = m.slot, reason
        self._renew_us = FOREVER
        self._causes[StopCause.STOP_DOT] = f"{dot.slot}.{dot.incarnation}.{dot.counter}"
        self._echoes.setdefault(dot, set()).add(self.slot)
        return [
            HALT,
            Send(self._stop(dot, reason, echo=True)),
            *self._remember(),
            Trace("safety", "", "HEARD_STOP", "LATCHED", f"dot {dot}"),
        ]

    def _press_spent(self, dot: StopDot, now_us: int) -> Sequence[Effect]:
        """A press with a name that was cleared before: late frames of an old press, or a new one of a
        panel that has only this name, or whose next names somebody has had cleared. It brakes, and the
        answer tells the presser to take another name. A press that is said still after `AGAIN_US` is
        new: the first robot in slot order that is not latched by then presses in its own name."""
        self.press_used(dot, now_us)
        rank = sum(slot < self.slot for slot in self._live)
        turn_us = max(self._spent_told_us + ANSWER_SPACING_US, self._spent_since_us)
        if now_us < turn_us + rank * STOP_REPEAT_US:
            return [HALT]
        self._spent_told_us = now_us
        reason = Reason.OPERATOR_INTERVENTION
        answer = EmergencyStop(dot.slot, dot.incarnation, dot.counter, reason, True, spent=True)
        return [HALT, Send(self.authority.sign(answer))]

    def press_used(self, dot: StopDot | RemoteStopDot, now_us: int) -> Sequence[Effect]:
        """A press, believed, with a name that was cleared before. It brakes; where it is said still after
        `AGAIN_US`, the first robot in slot order presses in its own name, unless a stop latches it."""
        if now_us - self._spent_us > SPENT_FORGET_US or now_us < self._spent_us:
            self._spent_since_us = now_us
        self._spent_us = now_us
        self.raise_cause(StopCause.SPENT_STOP, now_us, f"dot {dot}", SPENT_HOLD_US)
        if now_us - self._spent_since_us >= AGAIN_US and not self.stops.latched:
            rank = sum(slot < self.slot for slot in self._live)
            self._renew_us = min(self._renew_us, now_us + rank * STOP_REPEAT_US)
        return [HALT]

    def _hear_spent(self, dot: StopDot, now_us: int) -> Sequence[Effect]:
        """Somebody is pressed with a name that was used before. If it is we, we take another."""
        self._spent_told_us = now_us
        if dot not in self._own:
            self.raise_cause(StopCause.SPENT_STOP, now_us, f"dot {dot}", SPENT_HOLD_US)
            return [HALT]
        if not self._renewals or now_us - self._pressed_us < STOP_SPACING_US:
            return ()
        self._renewals -= 1
        return self._press(Reason.OPERATOR_INTERVENTION, now_us)

    def _hold_more(self, echo: bool, now_us: int) -> Sequence[Effect]:
        """More stops than are held by name. The digest of what is held changes with each press, but not
        with its repetition: a reset of what was told before does not clear it."""
        first = not self.stops.more
        if not first and (echo or now_us - self._more_us < STOP_SPACING_US):
            return ()
        self.stops.press_more()
        self._more_us = now_us
        return [HALT, *self._remember()] if first else ()

    def latch_far(self, dot: RemoteStopDot, now_us: int) -> Sequence[Effect]:
        """A stop of another segment, believed: brake, remember."""
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
        """A reset that holds in all segments, believed."""
        if not self.far.clear(dot):
            return ()
        remembered = [Persist(FAR_KEY, self.far.serialize()), self.remember_hold()]
        return [*remembered, Trace("safety", "", "CLEARED", "", f"{dot}")]

    def press_near(self, dot: StopDot, now_us: int) -> Sequence[Effect]:
        """A stop of this segment that we have missed, told from elsewhere and believed."""
        if self.stops.full and not self.stops.is_cleared(dot):
            return self._hold_more(True, now_us)
        if not self.stops.press(dot):
            return ()
        self._renew_us = FOREVER
        self._causes[StopCause.STOP_DOT] = f"{dot.slot}.{dot.incarnation}.{dot.counter}"
        return [
            HALT,
            Send(self._stop(dot, Reason.OPERATOR_INTERVENTION, echo=True)),
            *self._remember(),
            Trace("safety", "", "HEARD_STOP", "LATCHED", f"{dot}"),
        ]

    def clear_near(self, dot: StopDot, who: str) -> Sequence[Effect]:
        if not self.stops.clear(dot):
            return ()
        self._own.pop(dot, None)
        self._echoes.pop(dot, None)
        return [*self._remember(), Trace("safety", "", "CLEARED", "", f"dot {dot} by {who}")]

    def beat(self, slot: int, stopped: bool, now_us: int) -> Sequence[Effect]:
        """A member's beat: who stands and did not before has heard of our press; who moves has not."""
        active = self.stops.latched
        if stopped:
            for dot in self._own if slot in self._free else ():
                self._echoes.setdefault(dot, set()).add(slot)
            return ()
        if active:
            self._free.add(slot)
        if self._own and self._again and now_us - self._pressed_us >= AGAIN_US:
            self._again -= 1
            return self._press(Reason.OPERATOR_INTERVENTION, now_us)
        return self.tell_stops(now_us) if active else ()

    def tell_stops(self, now_us: int) -> Sequence[Effect]:
        """The stops we hold, to whoever does not know them; seldom, whoever asks."""
        if now_us - self._answered_us < ANSWER_SPACING_US:
            return ()
        self._answered_us = now_us
        dots = next_in_rotation(self.stops.active, self._told, TOLD_MAX)
        self._told = dots[-1] if dots else None
        return [Send(self._stop(d, Reason.OPERATOR_INTERVENTION, echo=True)) for d in dots]

    def answer_stops(self, question: int, now_us: int) -> Sequence[Effect]:
        """Somebody asks what holds us: some dots by name, all in sum. `question`: 48 bits, used once."""
        told = self.tell_stops(now_us)
        if now_us - self._asked_us < ANSWER_SPACING_US or not self.latched:
            return told
        self._asked_us = now_us
        return [*told, Send(self.authority.vouch(self.held_stops, question))]

    @property
    def held_stops(self) -> StopsHeld:
        named, more = len(self.stops.active) + len(self.far.active), self.stops.more + self.far.more
        count = COUNT_TOLD_MAX if more else min(named, COUNT_TOLD_MAX)
        return StopsHeld(self.slot, count, held_digest(self.stops, self.far))

    def receive_held_reset(self, m: HeldReset, now_us: int) -> Sequence[Effect]:
        """Clears all that holds us, where that is what it names: nothing was pressed since we told it."""
        if not self.authority.believes(m, m.operator, now_us):
            return self.authority.ask(m.operator, now_us)
        held = self.held_stops
        if not self.authority.agreed(m, now_us) or not held.stops or held.digest != m.digest:
            return ()
        for dot in self.stops.clear_all():
            self._own.pop(dot, None)
            self._echoes.pop(dot, None)
        self.far.clear_all()
        cleared = Trace("safety", "", "CLEARED", "", f"all that are held by {m.operator}")
        return [Persist(FAR_KEY, self.far.serialize()), *self._remember(), cleared]

    def receive_reset(self, m: EmergencyReset, now_us: int) -> Sequence[Effect]:
        """Clears exactly the dot it names, pressed here or not yet heard of."""
        if not self.authority.believes(m, m.operator, now_us):
            return self.authority.ask(m.operator, now_us)
        if not self.authority.agreed(m, now_us):
            return ()
        dot = StopDot(m.slot, m.incarnation, m.counter)
        return self.clear_near(dot, f"{m.operator}")

    def receive_implements_stop(
        self, source: int, name: int | None, robot: bool, m: AllImplementsStop, now_us: int
    ) -> Sequence[Effect]:
        """The standard frame, from any device: each button is a level that holds while it is repeated.

        `name`: that the source address has claimed. `robot`: it is a member of the fleet."""
        self.buttons.hear(source, name, robot, m, now_us)
        if robot:
            self.button.heard(m, now_us)
        held_us, held = self.buttons.until_us() - now_us, StopCause.IMPLEMENTS_STOP in self._causes
        if held_us <= 0:
            self.clear_cause(StopCause.IMPLEMENTS_STOP, now_us)
            return ()
        self.raise_cause(StopCause.IMPLEMENTS_STOP, now_us, f"address {source}", held_us)
        return [HALT] if m.switch in STOPS or not held else ()

    def say_button(self, live: Collection[int], now_us: int) -> Sequence[Effect]:
        """With a beat: the standard frame, where an emergency stop holds us or has just ended."""
        latched = StopCause.STOP_DOT in self._causes
        if not latched and not self.button.speaks:
            return ()
        rank = sum(slot < self.slot for slot in live)
        said = self.button.say(latched, rank, now_us)
        return () if said is None else [Send(said)]

    def accept_order(
        self, m: OperatorCommand | OperatorGoal, now_us: int
    ) -> Sequence[Effect] | None:
        """None: it has authority. Otherwise what to do about it."""
        if not self.authority.believes(m, m.operator, now_us):
            return self.authority.ask(m.operator, now_us)
        stands = isinstance(m, OperatorCommand) and m.command in STANDS
        return None if stands or self.authority.agreed(m, now_us) else ()

    # ---------------------------------------------------------------- people at this machine

    def manual_reset(self, now_us: int) -> bool:
        """Unlatch. Refused while a dot is not cleared or a cause that never clears is there."""
        if self.stops.latched or self.far.latched or StopCause.DISK_ERROR in self._causes:
            return False
        for cause in (StopCause.STOP_DOT, StopCause.BOOT_UNCONFIRMED):
            self._causes.pop(cause, None)
        return True

    def start(self, now_us: int) -> Sequence[Effect]:
        self.clear_cause(StopCause.NOT_STARTED, now_us)
        self.clear_cause(StopCause.PLACE_FROZEN, now_us)
        return [self.remember_hold()]

    def hold(self, now_us: int) -> Sequence[Effect]:
        self.raise_cause(StopCause.NOT_STARTED, now_us, "held by an operator")
        return [HALT, self.remember_hold()]

    def remember_hold(self) -> Persist:
        """What a person has still to do at this machine, for the time after a restart."""
        self.held = not self.started
        return Persist(HOLD_KEY, LATCHED if self.latched else HELD if self.held else FREE)

    # ---------------------------------------------------------------- members and time

    def members(
        self, live: frozenset[int], silent: frozenset[int], now_us: int
    ) -> Sequence[Effect]:
        """The membership changed. Silence brakes at once; the policy ends it later."""
        brake = bool(silent - self._silent)
        self._live, self._silent, self._stable_us = live, silent, now_us
        if brake:
            self.clear_cause(StopCause.CREEP, now_us)
            self.raise_cause(StopCause.MEMBER_SILENT, now_us, f"silent {sorted(silent)}")
            return [HALT, Trace("safety", "", "SILENCE", "PROTECTIVE", f"{sorted(silent)}")]
        return ()

    @property
    def deadline_us(self) -> int:
        deadline = min(self._repeat_us, self._renew_us)
        if not self._causes:  # what expires is a cause
            return deadline
        if self._settles:
            deadline = min(deadline, self._stable_us + MEMBERSHIP_STABLE_US)
        for expires_us in self._expires_us.values():
            deadline = min(deadline, expires_us)
        return deadline

    def tick(self, now_us: int) -> Sequence[Effect]:
        if now_us < self.deadline_us:
            return ()
        for cause in [c for c, expires_us in self._expires_us.items() if expires_us <= now_us]:
            self.clear_cause(cause, now_us)
        self._end_silence(now_us)
        if now_us >= self._renew_us:
            self._renew_us = FOREVER
            if not self.stops.latched:
                return self.press(Reason.OPERATOR_INTERVENTION, now_us)
        return self._repeat(now_us) if now_us >= self._repeat_us else ()

    @property
    def _settles(self) -> bool:
        """A stable membership will change something."""
        if SILENT in self._causes:
            return not self._silent or self.policy is not SilencePolicy.STOP
        return CREEP in self._causes and not self._silent

    def _end_silence(self, now_us: int) -> None:
        if not self._settles or now_us < self._stable_us + MEMBERSHIP_STABLE_US:
            return
        self.clear_cause(StopCause.MEMBER_SILENT, now_us)
        if self._silent and self.policy is SilencePolicy.SLOW:
            self.raise_cause(StopCause.CREEP, now_us, f"silent {sorted(self._silent)}")
        else:
            self.clear_cause(StopCause.CREEP, now_us)

    def _repeat(self, now_us: int) -> Sequence[Effect]:
        """As the source: every 5 ms until every live member has echoed. What nobody can hear has not been
        said: it does not count."""
        sends, others = list[Effect](), self._live - {self.slot}
        unheard = StopCause.UNHEARD in self._causes
        for dot, left in sorted(self._own.items()):
            enough = left <= (0 if others else REPEATS_MAX - REPEATS_ALONE)
            if enough or (others and others <= self._echoes.get(dot, set())):
                del self._own[dot]
                self._reasons.pop(dot, None)
                continue
            self._own[dot] = left - (not unheard)
            reason = self._reasons.get(dot, Reason.OPERATOR_INTERVENTION)
            sends.append(Send(self._stop(dot, reason)))
        pause_us = REPEAT_UNHEARD_US if unheard else STOP_REPEAT_US
        self._repeat_us = now_us + pause_us if self._own else FOREVER
        return sends

    # ---------------------------------------------------------------- the gate

    def gate(self, wanted: Drive, now_us: int) -> Drive:
        """The last function before the actuator."""
        if not self._causes:
            return wanted
        severity = self.severity
        if severity >= Severity.PAUSE:
            return HALT
        if severity is Severity.SLOW:
            speed_m_s = hypot(wanted.vx_m_s, wanted.vy_m_s)
            if speed_m_s > CREEP_M_S:
                share = CREEP_M_S / speed_m_s
                return wanted._replace(  # all of it: what steers keeps its curve
                    vx_m_s=wanted.vx_m_s * share,
                    vy_m_s=wanted.vy_m_s * share,
                    turn_rad_s=wanted.turn_rad_s * share,
                )
        return wanted

    # ---------------------------------------------------------------- inside

    def _stop(self, dot: StopDot, reason: Reason, echo: bool = False) -> EmergencyStop:
        message = EmergencyStop(dot.slot, dot.incarnation, dot.counter, reason, echo)
        return self.authority.sign(message)

    def _remember(self) -> list[Effect]:
        stops, counter = self.stops.serialize(), self.counter.to_bytes(4, "little")
        return [Persist(STOPS_KEY, stops), Persist(COUNTER_KEY, counter), self.remember_hold()]
