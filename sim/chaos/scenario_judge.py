"""Runs one scenario with every checker. They observe bodies, frames, disks and what people do.

No check asks a robot for its belief. There are three exceptions: its replicas, at the end (L1, L5) and
after a restart before it has received any frame (S13); what it has stored, while its disk is full (S13);
and its own address, which says on which bus it can be heard (S1, S18).
"""

from collections import Counter
from collections.abc import Callable
from functools import partial
from math import dist, hypot
from operator import attrgetter
from typing import Any, Final, NamedTuple

import numpy as np
from shapely.geometry import Point as Spot

from agent.interface.config import ACTUATOR_TTL_US, CONTROL_PERIOD_US, MS, S, beat_of
from agent.interface.effects import Effect
from agent.motion.implement_clearance import LEAD_M
from agent.peer.implement_check import RISES_WITHIN_US
from agent.peer.journal_recovery import LOST, remembers
from agent.peer.place_jumps import AGE_MAX_US
from agent.peer.sense_freshness import STEADY_US
from agent.runtime import peer_runner
from protocol.address import RETRY_MAX_US
from protocol.frames.frame import Frame
from protocol.frames.messages import GROUP_OF
from protocol.frames.network_frames import AddressClaimed
from sim.chaos.durability_rules import STANDS, Worked, losses, lost, unknown
from sim.chaos.effect_observer import EffectObserver
from sim.chaos.fault_profiles import UNSEEN_M, is_link_trouble, span_of
from sim.chaos.protocol_rules import NEVER_US, RuleViolation
from sim.chaos.unit_knowledge import UnitKnowledge, units_of
from sim.fleet.event_loop import EventLoop
from sim.fleet.fault_injector import PUSHED_M_S
from sim.fleet.outcome import FieldOutcome
from sim.fleet.simulated_disk import Disk, LogJournal
from sim.fleet.simulated_fleet import Cluster, Record
from sim.fleet.stop_monitor import NOBODY, motions
from sim.runs.field_run import FieldRun
from sim.runs.protocol_run import ProtocolRun
from sim.runs.run import RunProgress
from sim.scenarios import scenario as kinds
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.protocol_setup import ProtocolSetup
from sim.scenarios.scenario import DRILLS, Fault, Scenario, is_drawn
from sim.world.checkers import MOVES, ExclusiveWorkChecker, Violation
from sim.world.contacts import THING, TOUCH_M
from sim.world.coverage_truth import coverage, sample_points
from sim.world.drive_trains import VX, VY
from sim.world.implement_contacts import things_under_bars, was_there
from sim.world.protocol_world import ProtocolWorld
from sim.world.repeated_work import RepeatedWorkChecker
from sim.world.walls import AT_X, AT_Y, HALF_X, HALF_Y
from sim.world.world import World

RUNNER_LOG = peer_runner.log
SLACK_US = 20 * MS  # a control tick, and a frame that blocks
# After this time from the last reset, no robot may still be stopped and all data must be exchanged.
RELEASED_S = 12.0
# Limit for a stop if all robots are on one bus, whatever is lost: 20 copies, and a tick.
DELIVERED_US = 120 * MS
# After a trouble of links or members: all robots know what each of them knew before.
EXCHANGED_US = round(RELEASED_S * S)
STANDARD_US = 5 * S  # after a press; by then the first frame is forgotten, if it was the only one
FORGET_US = 3 * S  # of silence, ISO 11783-7
# After this time without trouble of links and members, all robots receive each other.
SETTLED_US = 3 * S
LEFT_US = 50 * MS  # frames under way when an address was lost are on the bus by then
# A robot that is pushed may touch something for this long, and any robot what has come into the field. A
# long push lasts longer.
EXCUSED_US = 3 * S
# A robot whose senses are wrong, or whose implement is stuck, may draw it over something until this much
# later: its place is found again meanwhile.
CLEAR_US: Final = 3 * S
HIDDEN_M: Final = 1.5  # from the hull of another robot, whose place explains echoes
AT_FENCE_M: Final = 0.35  # from a thing to a fence, which explains echoes
SEES_WRONG: Final = (
    kinds.NoRays, kinds.StuckRays, kinds.NoisyRays, kinds.Blind, kinds.Jumped, kinds.Drifting,
    kinds.Late, kinds.Frozen, kinds.HungFixes, kinds.DeafWheels, kinds.Slipping, kinds.StuckImplement,
    kinds.Freeze,
)  # fmt: skip
ROLLS_ON_US = 1 * S  # after the touch of a robot that a person pushes
# A slow body that pushes another one is never deep in it. Bodies that only met part again at once.
LEANS_US = 200_000
# The latest observation is one period old at most, expires one period after its limit, and that is
# noticed one control period later.
SENSELESS_US = AGE_MAX_US + 2 * CONTROL_PERIOD_US + SLACK_US
# How far a robot may be told to stand after its implement should be up, or begins to be told so late:
# the senses are one period old, the check notices a period later, and a command expires.
STAYS_DOWN_US = RISES_WITHIN_US + 2 * CONTROL_PERIOD_US + ACTUATOR_TTL_US + SLACK_US
# Distance of a robot that starts to drive while its position is frozen, and brakes again.
STARTING_M = 0.5
# How far the place of a robot falls back, and how far the robot is told to drive beyond it.
HUNG_M = 0.5 + 1.1
STOOD_M = 0.01  # a body that is less far away than this has not moved
# Copies are lost, but no robot is cut off.
LOSSY = (kinds.Loss, kinds.Omission, kinds.Duplicate, kinds.Errors)
# Frames in the name of a robot that is dead, or a clock that shows a time at which it was alive.
HEARD_AGAIN = (
    kinds.Clone,
    kinds.Twin,
    kinds.Foreign,
    kinds.Nonsense,
    kinds.Forger,
    kinds.ClockJump,
)
CLAIM_PRIORITY = GROUP_OF[AddressClaimed].priority
CLAIM_PF = 0xEE  # of an identifier: ADDRESS_CLAIMED
# A robot closer than this to a line is on it; a robot on another line passes at a greater distance.
ON_LINE_M = 0.2
# Ground that may be left at a machine that is dead at the end: units of 5 m on which it may stand
# (a stopping distance of 3 m, and two bodies beside it), and half an implement.
DEAD_M = 12.0
WHOLE: Final = 0.9999  # of the ground that can be reached: a field of 10,000 samples may lack one
# A body that steers leaves samples where rings of a drawn field bend (docs/measured/fields.md): five of
# 7,300 were most in 80 such runs. The two rings end two widths from the fence.
BENT: Final = 0.999
RINGS_WIDTHS: Final = 2.0
UNNOTICED_M = 0.3  # two control periods at full speed


def _outranks_claims(babble: kinds.Babble) -> bool:
    number = babble.identifier
    return (babble.priority if number is None else number >> 26) < CLAIM_PRIORITY


class _FrozenPlace(NamedTuple):
    """A robot whose place stands still, or falls back again and again."""

    driven_m: float  # its true way until then
    end_at_us: int
    unnoticed_m: frozenset[float]  # the distances that it may drive before each of its faults shows
    # How often its senses were away meanwhile, or a person started it. Then it knows nothing of the place
    # before, and drives until the fault shows again.
    again: int = 0


class StopEarly(Exception):
    """A violation was found, and only the first one is wanted."""


class ScenarioJudge:
    """A run under all checkers; `run` plays it, then `broken`, `faults` and `outcome` say what
    happened."""

    def __init__(self, scenario: Scenario, first_only: bool = False) -> None:
        """`first_only`: end the run within a second of the first violation."""
        self.first_only = first_only
        self.scenario, self.span = scenario, span_of(scenario)
        plain = scenario.with_engine("contact_free")
        self.any_setting = ProtocolSetup(plain) if scenario.mission in DRILLS else FieldSetup(plain)
        self.witness = EffectObserver(scenario.fleet.robots)
        # Called with robot, time of the simulation and effect, after the checkers.
        self.on_effect: Record | None = None
        self.broken: list[RuleViolation] = []
        self.outcome: FieldOutcome | None = None
        self._applied: list[tuple[float, Fault]] = []
        # Dead robot -> watches of the robots that must stand, and from when on each of them must.
        self._silences: dict[int, dict[int, int]] = {}
        self._off_at_us: dict[int, int] = {}  # when each robot was last switched off, or hung
        self._delivering: dict[int, int] = {}  # watch of a stop -> until when it is being sent
        # Seconds at which all robots received each other, in a field under another policy than `stop`.
        self._all_told_at_s: set[int] = set()
        self._trouble_at_us = 0  # the newest trouble of a link or a member
        self._cut_ends_at_us = SETTLED_US  # until then, some robots may be unable to receive
        self._lies: list[tuple[int, int]] = []  # from when to when a thief speaks with a stolen key
        # Address -> since when it is lost, NAME, slot.
        self._lost: dict[int, tuple[int, bytes, int]] = {}
        self._settled = False  # `RELEASED_S` is over
        # x, y, radius (m) of ground that may be left.
        self._left: list[tuple[float, float, float]] = []
        self._blind: dict[int, list[int]] = {}  # watches of robots that have lost their sensors
        self._blind_ends_at_us: dict[int, int] = {}  # until when each machine senses nothing
        self._frozen: dict[int, _FrozenPlace] = {}
        self._jumps: dict[int, list[int]] = {}  # of them, those whose place is wrong
        # The newest of these of a robot: its watch, when the jump began and when it ends.
        self._newest_jump: dict[int, tuple[int, int, int]] = {}
        self._far_m: dict[int, float] = {}  # by which the newest jump of its place is wrong
        self._hangs: dict[int, int] = {}  # until when a process does nothing, microseconds
        self._repeats: dict[int, int] = {}  # until when the senses repeat themselves, microseconds
        self._unsure: dict[int, int] = {}  # until when a robot believes no place, microseconds
        # Where wheels stood when they answered again: a robot that has not moved since has no place.
        self._deaf_at: dict[int, tuple[float, float]] = {}
        self._by_hand: dict[int, int] = {}  # until when a person pushes a robot, microseconds
        # Ways with the implement down against the command, m, of robots whose implement is stuck.
        self._dragged_m: dict[int, float] = {}
        # Of each robot whose implement is watched: when the last of its faults ends, microseconds.
        self._stuck_ends_at_us: dict[int, int] = {}
        # Of each robot: pairs of looks between which its implement was down against its command.
        self._spans_down: dict[int, list[tuple[int, int]]] = {}
        self._pushes: list[tuple[int, int, int]] = []  # (robot, begin, end), microseconds
        # (robot, begin, end): it is pushed, and may touch something.
        self._excused: list[tuple[int, int, int]] = []
        # (begin, end, number of the newest thing before it): something comes into the field, and robots
        # may touch it. What walks gets a new number with each step.
        self._comes: list[tuple[int, int, int]] = []
        # For how long robots were told to drive in a contact that went on after its excuse, microseconds;
        # by its beginning and its first robot.
        self._pressing_for_us: Counter[tuple[int, int]] = Counter()
        self._looks_at_contacts = False
        self._sees_wrong: list[
            tuple[int, int, int]
        ] = []  # the same of its senses and its implement
        self._units = UnitKnowledge(EXCHANGED_US)

    def run(self) -> "ScenarioJudge":
        """Play the scenario to its end, or to the first violation with `first_only`, and judge what
        is left to judge.

        Robots log nothing meanwhile: a disk that fails because the scenario says so is no news."""
        spoke, RUNNER_LOG.disabled = RUNNER_LOG.disabled, True
        try:
            return self._play()
        finally:
            RUNNER_LOG.disabled = spoke

    def _play(self) -> "ScenarioJudge":
        run: ProtocolRun | FieldRun
        if isinstance(self.any_setting, ProtocolSetup):
            run = ProtocolRun(self.any_setting, attach=self._attach)
        else:
            run = FieldRun(self.any_setting, attach=self._attach)
        run.recorder = self.witness
        if self.first_only:
            run.told = self._enough
        try:
            self.outcome = run.run()
        except StopEarly:
            self._moved()
            self._exclusive_work(self._together)
        # A failed assertion of a robot or of the simulation counts as a violation.
        except Exception as problem:
            text = f"{type(problem).__name__}: {problem}"
            self.broken.append(RuleViolation("S15", self.cluster.host.now_us() / 1e6, text))
        self._applied = run.faults
        if self.outcome is not None:
            self._judge(self.outcome)
        self.broken += self.witness.broken
        self.broken.sort(key=lambda broken: broken.t_s)
        return self

    def _enough(self, moment: RunProgress) -> None:
        moved = any(checker.violations for _, checker in self._moving)
        if self.broken or self.witness.broken or moved or self._together:
            raise StopEarly

    @property
    def faults(self) -> Counter[str]:
        """The number of faults of each kind that were applied before the repairs."""
        return Counter(f.kind for _, f in self._applied if f.at_s <= self.span.calm_at_s)

    def _attach(self, cluster: Cluster) -> None:
        self.cluster, self.witness.clock = cluster, cluster.host.now_us
        if self.on_effect is not None:
            cluster.record = partial(self._observe, self.on_effect)
        for slot in range(self.scenario.fleet.robots):
            cluster.journals[slot] = LogJournal(Disk())
        self.protocol_world = cluster.world if isinstance(cluster.world, ProtocolWorld) else None
        if self.protocol_world is not None:
            stops = self.scenario.fleet.silence == "stop"
            self.protocol_world.counts = self._can_know if stops else self._all_told
        else:
            for second in range(round(self.scenario.run.time_limit_s)):
                self._at(second * S, self._note_units)
                if self.scenario.fleet.silence != "stop":
                    self._at(second * S, self._hear_all)
        self.silence, self.delivery = motions(cluster.world), motions(cluster.world)
        self.senseless = motions(cluster.world)
        cluster.on_power = self._power
        cluster.on_lie = self.witness.words.lied
        cluster.on_order = lambda m: self.witness.words.ordered(m, cluster.host.now_us())
        for fault in self.scenario.fault:
            self._watch(fault)
        span = self.span
        if any(
            isinstance(f, kinds.Reset) and f.at_s == span.start_at_s for f in self.scenario.fault
        ):
            self._at(round((span.start_at_s + RELEASED_S) * 1e6), self._all_released)

    def _observe(self, on_effect: Record, slot: int, now_us: int, effect: Effect) -> None:
        self.witness(slot, now_us, effect)
        on_effect(slot, self.cluster.host.now_us(), effect)

    def _at(self, t_us: int, call: Callable[[], object]) -> None:
        assert isinstance(self.cluster.host, EventLoop)
        self.cluster.host.at(t_us, call)

    def _watch(self, fault: Fault) -> None:
        """Call the checkers at a fault: before it at its time, and after it a moment later."""
        at_us = round(fault.at_s * 1e6)
        # Before the clone itself counts as trouble.
        if isinstance(fault, kinds.Clone) and fault.wins:
            self._at(at_us, partial(self._loses_address, fault.robot))
        if isinstance(fault, SEES_WRONG):
            end_at_us = at_us + round(fault.for_s * S) + CLEAR_US
            self._sees_wrong.append((fault.robot, at_us, end_at_us))
        if is_link_trouble(fault):
            lossy = isinstance(fault, LOSSY)
            end_at_us = 0 if lossy else at_us + round(getattr(fault, "for_s", 0.0) * S) + SETTLED_US
            self._at(at_us, partial(self._troubled, end_at_us, isinstance(fault, HEARD_AGAIN)))
            if end_at_us:  # a press at the same time is not sent completely either
                self._at(at_us + 1, self._interrupted)
        match fault:
            case kinds.Estop(robot=robot):
                self._at(at_us, partial(self._pressed, robot))
            case kinds.Freeze(robot=robot, for_s=for_s):
                self._at(at_us, partial(self._lapses, robot))
                end_at_us = at_us + round(for_s * S)
                self._at(at_us, partial(self.witness.words.hangs, robot, end_at_us))
                self._at(at_us, partial(self._hangs.__setitem__, robot, end_at_us))
                self._at(at_us, partial(self._hides_jump, robot))
                self._at(at_us, partial(self._unsure_until, robot, end_at_us))
            case kinds.Pushed(robot=robot, dx_m=dx_m, dy_m=dy_m):
                let_go_at_us = at_us + round(hypot(dx_m, dy_m) / PUSHED_M_S * S) + CONTROL_PERIOD_US
                self._at(at_us, partial(self._by_hand.__setitem__, robot, let_go_at_us))
                self._pushes.append((robot, at_us, let_go_at_us))
                excused_for_us = max(EXCUSED_US, let_go_at_us + ROLLS_ON_US - at_us)
                self._at(at_us, partial(self._excuse, robot, excused_for_us))
                self._at(at_us + excused_for_us, self._excuse_ends)
                self._at(at_us, partial(self._sees_again, robot))
                self._at(at_us, partial(self._shoved, robot, at_us + 1))
                self._at(let_go_at_us + ROLLS_ON_US, partial(self._is_let_go, robot))
            case kinds.Jumped(robot=robot, for_s=for_s, dx_m=dx_m, dy_m=dy_m):
                far_m, end_at_us = hypot(dx_m, dy_m), at_us + round(for_s * S)
                self._at(at_us, partial(self._place_jumps, robot, far_m, end_at_us))
                self._at(at_us, partial(self._unsure_until, robot, end_at_us))
            case kinds.Blind(robot=robot, for_s=for_s):
                end_at_us = at_us + round(for_s * S)
                self._at(at_us, partial(self._unsure_until, robot, end_at_us))
                self._at(at_us, partial(self._goes_blind, robot, end_at_us))
            case kinds.Drifting(robot=robot, for_s=for_s):
                self._at(at_us, partial(self._unsure_until, robot, at_us + round(for_s * S)))
            case kinds.NoRays(robot=robot, for_s=for_s):
                end_at_us = at_us + round(for_s * S)
                self._at(at_us, partial(self._shows, robot, end_at_us, self._loses_senses))
            case kinds.DeafWheels(robot=robot, for_s=for_s):
                self._at(at_us, partial(self._last_command_holds, robot))
                self._at(at_us + round(for_s * S), partial(self._wheels_answer, robot))
            case kinds.Late(robot=robot, by_s=by_s, for_s=for_s) if by_s * S > AGE_MAX_US:
                end_at_us = at_us + round(for_s * S)
                self._at(at_us, partial(self._unsure_until, robot, end_at_us))
                self._at(at_us, partial(self._loses_senses, robot, end_at_us))
            case kinds.Reset():  # includes a start
                for robot in range(self.scenario.fleet.robots):
                    self._at(at_us, partial(self._tries_again, robot))
            case kinds.Order(robot=robot, order="start"):
                self._at(at_us, partial(self._tries_again, robot))
                self._at(at_us, partial(self._vouched_for, robot))
            case kinds.Frozen(robot=robot, for_s=for_s):
                end_at_us = at_us + round(for_s * S)
                self._at(at_us, partial(self._place_freezes, robot, end_at_us, STARTING_M))
                self._at(at_us, partial(self._repeat, robot, end_at_us))
                self._at(at_us, partial(self._hides_jump, robot))
                self._at(at_us, partial(self._unsure_until, robot, end_at_us))
            case kinds.HungFixes(robot=robot, for_s=for_s):
                end_at_us = at_us + round(for_s * S)
                self._at(at_us, partial(self._place_freezes, robot, end_at_us, HUNG_M))
                self._at(at_us, partial(self._repeat, robot, end_at_us))
                self._at(at_us, partial(self._unsure_until, robot, end_at_us))
            case kinds.StuckImplement(robot=robot, for_s=for_s):
                self._at(at_us, partial(self._implement_sticks, robot, at_us + round(for_s * S)))
            case kinds.DiskFull(robot=robot, for_s=for_s):
                self._at(at_us + round(for_s * S) - 1, partial(self._keeps_silent, robot))
            case kinds.ClockJump(robot=robot):
                self._at(at_us, self._interrupted)  # for any robot that was pressed
                self._at(at_us, partial(self.witness.words.leaps, robot))
            case kinds.Nonsense(what="claims", for_s=for_s):
                # Robots that it drove from every address try again after `RETRY_MAX_US`.
                taken_ends_at_us = at_us + round(for_s * S) + RETRY_MAX_US + 2 * S
                self._at(at_us, partial(self._no_robots_meet, taken_ends_at_us))
            case kinds.Forger(for_s=for_s, position="inside"):
                self._lies.append((at_us, at_us + round(for_s * S)))
            case kinds.Foreign(claims=True):
                self._at(at_us, self._unsure_of_name)
            case kinds.Foreign(claims=False):
                self._at(at_us, self.witness.words.without_name)
            case kinds.Babble(for_s=for_s):
                self._at(at_us, partial(self._no_robots_meet, at_us + round(for_s * S)))
                if _outranks_claims(fault):  # meanwhile no other device can show its NAME
                    self._at(at_us, self.witness.words.without_name)
            case kinds.Box() | kinds.Person() | kinds.PassingVehicle():
                self._at(at_us - 1, partial(self._thing_comes, at_us))
                self._at(at_us + EXCUSED_US, self._excuse_ends)

    # ---------------------------------------------------------------- while it runs

    def _now_us(self) -> int:
        now_us = self.cluster.host.now_us()
        self.cluster.world.advance(now_us)
        return now_us

    def _troubled(self, end_at_us: int, heard: bool) -> None:
        """`heard`: robots may hear again of one that is dead."""
        self._trouble_at_us = self.cluster.host.now_us()
        self._cut_ends_at_us = max(self._cut_ends_at_us, end_at_us)
        self._part(end_at_us)
        if end_at_us:
            self._interrupted()
        for slot in list(self._silences):
            self._unsure_of_silence(slot, heard)

    def _loses_address(self, slot: int) -> None:
        """S18: if it must have received the better claim, it sends nothing more from that
        address."""
        cluster, now_us = self.cluster, self.cluster.host.now_us()
        faults = cluster.segment.wire.faults
        if not cluster.is_up(slot) or faults.loss or faults.omission:
            return
        peer = cluster.robots[slot].peer
        # The part of the bus with the tool.
        beside = cluster.segment.wire.nodes[cluster.node_of(slot)].island == 0
        if now_us >= self._cut_ends_at_us and self._one_bus and beside and peer.address is not None:
            name = peer.identity.name.pack().to_bytes(8, "little")
            self._lost[peer.address] = now_us + LEFT_US, name, slot
            self._overhear()

    def _overhear(self) -> None:
        """Listen to the bus while there are lost addresses to check."""
        taps = [tap for tap in self.cluster.segment.taps if tap != self._overheard]
        self.cluster.segment.taps = [*taps, *([self._overheard] if self._lost else [])]

    def _overheard(self, t_us: int, frame: Frame) -> None:
        """Handle every frame on the bus."""
        address = frame.identifier & 0xFF
        if address not in self._lost:
            return
        lost_at_us, name, _ = self._lost[address]
        if frame.identifier >> 16 & 0xFF == CLAIM_PF:
            # Claimed again by a device that may not know of the loss.
            if frame.data == name or t_us >= lost_at_us:
                del self._lost[address]
        elif t_us >= lost_at_us:
            del self._lost[address]
            self._add(
                "S18", t_us / 1e6, f"a frame comes from address {address}, which its robot has lost"
            )

    def _loses_senses(self, slot: int, end_at_us: int) -> int | None:
        """S19: it stands until its sensors work again. Returns the number of the watch, if any."""
        now_us = self._now_us()
        if end_at_us - now_us <= SENSELESS_US or not self.cluster.is_up(slot):
            return None
        watch = self.senseless.press(now_us, SENSELESS_US, (slot,))
        self._blind.setdefault(slot, []).append(watch)
        self._at(end_at_us, partial(self._sees_again, slot, watch))
        return watch

    def _goes_blind(self, slot: int, end_at_us: int) -> None:
        """S19: a robot that is off now stands from its boot on. One that was never on has no fault."""
        if slot in self.cluster.robots:
            self._blind_ends_at_us[slot] = max(self._blind_ends_at_us.get(slot, 0), end_at_us)
        self._loses_senses(slot, end_at_us)

    def _is_let_go(self, slot: int) -> None:
        """S19: no person moves it any more. One that still senses nothing stands."""
        if self._now_us() < self._blind_ends_at_us.get(slot, 0):
            self._loses_senses(slot, self._blind_ends_at_us[slot])

    def _shows(self, slot: int, end_at_us: int, call: Callable[[int, int], object]) -> None:
        """S19: `call` as soon as a fault of the senses can show, if it lasts until then. It does not
        while the process hangs, nor while the senses repeat what they said before."""
        shows_at_us = max(self._repeats.get(slot, 0), self._hangs.get(slot, 0))
        if shows_at_us <= self.cluster.host.now_us():
            call(slot, end_at_us)
        elif shows_at_us < end_at_us:
            self._at(shows_at_us, partial(self._shows, slot, end_at_us, call))

    def _repeat(self, slot: int, end_at_us: int) -> None:
        """Its senses repeat themselves, until then at least."""
        self._repeats[slot] = max(self._repeats.get(slot, 0), end_at_us)

    def _wheels_answer(self, slot: int) -> None:
        """They did not, for a time."""
        self._now_us()
        self._deaf_at[slot] = self.cluster.world.body(slot).position

    def _unsure_until(self, slot: int, end_at_us: int) -> None:
        """It has no place until then, and believes none until its senses have been steady."""
        end_at_us += STEADY_US + 2 * CONTROL_PERIOD_US
        self._unsure[slot] = max(self._unsure.get(slot, 0), end_at_us)

    def _place_jumps(self, slot: int, far_m: float, end_at_us: int) -> None:
        """S19: as without senses. A jump no longer than its way to standstill cannot be told from that
        way, if it begins while the robot has no place that it believes, or before it has moved since it
        told its wheels to drive in vain, or while a person moves it against its wheels. It believes none
        for a while after another jump, too."""
        now_us = self._now_us()
        self._far_m[slot] = far_m
        at, deaf_at = self.cluster.world.body(slot).position, self._deaf_at.get(slot)
        stands = deaf_at is not None and dist(at, deaf_at) < STOOD_M
        unsure = self._blind.get(slot) or now_us < self._unsure.get(slot, 0)
        held = now_us < self._by_hand.get(slot, 0)
        if far_m < UNSEEN_M and (stands or unsure or held):
            self._vouched_for(slot)  # what it showed before does not show any more
            return
        self._shows(slot, end_at_us, self._sees_jump)

    def _sees_jump(self, slot: int, end_at_us: int) -> None:
        """The newest jump is what shows, if several began while none could."""
        if self._far_m[slot] < UNSEEN_M and self._now_us() < self._unsure.get(slot, 0):
            return
        watch = self._loses_senses(slot, end_at_us)
        if watch is not None:
            self._jumps.setdefault(slot, []).append(watch)
            self._newest_jump[slot] = watch, self._now_us(), end_at_us

    def _hides_jump(self, slot: int) -> None:
        """Its process hangs, or its senses repeat themselves, before they have told it of a jump that has
        just begun."""
        watch, begun_at_us, end_at_us = self._newest_jump.get(slot, (-1, 0, 0))
        hidden = self._now_us() - begun_at_us <= CONTROL_PERIOD_US
        if hidden and watch in self._blind.get(slot, ()):
            self._sees_again(slot, watch)
            self._shows(slot, end_at_us, self._sees_jump)

    def _vouched_for(self, slot: int) -> None:
        """A person starts it, and says so that its place is right; or its place is near again."""
        for watch in self._jumps.pop(slot, ()):
            self._sees_again(slot, watch)

    def _sees_again(self, slot: int, watch: int | None = None) -> None:
        """Its sensors work again, or a person moves it by hand."""
        for number in list(self._blind.get(slot, ())):
            if watch in (None, number):
                self._blind[slot].remove(number)
                self.senseless.release(number)
        if watch is None:
            self._frozen.pop(slot, None)
        else:
            self._tries_again(slot)

    def _tries_again(self, slot: int) -> None:
        """If its place is frozen, it drives until it has noticed so once more."""
        frozen = self._frozen.get(slot)
        if frozen is not None:
            self._frozen[slot] = frozen._replace(again=frozen.again + 1)

    def _place_freezes(self, slot: int, end_at_us: int, unnoticed_m: float) -> None:
        """S19: it notices this when it drives, and stops within its distance limit."""
        now_us, let_go_at_us = self._now_us(), self._by_hand.get(slot, 0)
        if now_us < let_go_at_us:  # until then a person moves it, not its wheels
            if let_go_at_us < end_at_us:
                self._at(let_go_at_us, partial(self._place_freezes, slot, end_at_us, unnoticed_m))
        elif self.protocol_world is None and self.cluster.is_up(slot):
            now_m = self.cluster.world.body(slot).track.driven_m
            before = self._frozen.get(slot, _FrozenPlace(now_m, end_at_us, frozenset()))
            self._frozen[slot] = _FrozenPlace(
                before.driven_m,
                max(before.end_at_us, end_at_us),
                before.unnoticed_m | {unnoticed_m, self._brakes_m(slot, now_us)},
                before.again,
            )
            self._at(end_at_us, partial(self._thaws, slot))

    def _brakes_m(self, slot: int, now_us: int) -> float:
        """What a robot that was told to turn back drives on before it does."""
        world = self.cluster.world
        body, told = world.robots[slot], world.robots[slot].commanded(now_us)
        if body.speed_m_s == 0.0:
            return 0.0
        vx_m_s, vy_m_s = world.motion[body.index, VX : VY + 1].tolist()
        if vx_m_s * told.vx_m_s + vy_m_s * told.vy_m_s >= 0.0:
            return 0.0
        return body.speed_m_s**2 / (2 * self.scenario.fleet.acceleration_m_s2)

    def _thaws(self, slot: int) -> None:
        """A fault of its place ends; the way is judged when the last of those that overlap does."""
        now_us, frozen = self._now_us(), self._frozen.get(slot)
        if frozen is None or now_us < frozen.end_at_us:
            return
        del self._frozen[slot]
        body = self.cluster.world.robots[slot]
        way_m = body.track.driven_m - frozen.driven_m
        most_m = body.chassis.speed_m_s * (SENSELESS_US / S + body.chassis.stopping_for_s / 2)
        if way_m > (1 + frozen.again) * (most_m + sum(frozen.unnoticed_m)):
            what = f"robot {slot} drives {way_m:.1f} m while its place is frozen"
            self._add("S19", now_us / 1e6, what)

    def _implement_sticks(self, slot: int, end_at_us: int) -> None:
        """One watch for each robot: faults that overlap are one fault, and its way counts once."""
        if self.protocol_world is not None:
            return
        watched = slot in self._stuck_ends_at_us
        self._stuck_ends_at_us[slot] = max(self._stuck_ends_at_us.get(slot, 0), end_at_us)
        if not watched:
            self._dragged_m[slot] = 0.0
            self._drags(slot, None)

    def _drags(self, slot: int, before: tuple[int, float, float] | None) -> None:
        """S22: how far it drives with its implement down, by its true state, against the command in
        force. `before`: the time and its place at the last look, if it was so then; looks are a
        control period apart."""
        now_us, body = self._now_us(), self.cluster.world.robots[slot]
        against = body.tool_on and not body.commanded(now_us).tool_on
        against = against and now_us >= self._by_hand.get(slot, 0)
        here = (now_us, *body.position) if against else None
        way_m = 0.0
        if here is not None and before is not None:
            self._spans_down.setdefault(slot, []).append((before[0], now_us))
            way_m = self._dragged_m[slot] + hypot(here[1] - before[1], here[2] - before[2])
        self._dragged_m[slot] = way_m
        most_m = body.chassis.speed_m_s * (STAYS_DOWN_US / S + body.chassis.stopping_for_s / 2)
        if way_m > most_m:
            what = f"robot {slot} drives {way_m:.1f} m with its implement down against its command"
            self._add("S22", now_us / 1e6, what)
        if way_m <= most_m and now_us < self._stuck_ends_at_us[slot]:
            self._at(now_us + CONTROL_PERIOD_US, partial(self._drags, slot, here))
        else:
            del self._stuck_ends_at_us[slot]

    def _keeps_silent(self, slot: int) -> None:
        """S13: while its disk is full, it sends nothing that would have to be on the disk.

        Stops are sent all the same. So are units, in answers, because they are worked and other
        robots store them.
        """
        journal = self.cluster.journals[slot]
        if isinstance(journal, LogJournal) and self.cluster.is_up(slot):
            disk = LogJournal(Disk(journal.disk.read()), mark=journal.mark)
            for missing in losses(self.witness.told[slot], disk.load()):
                if missing != STANDS and not missing.startswith(("stops", "units")):
                    t_s = self.cluster.host.now_us() / 1e6
                    self._add("S13", t_s, f"robot {slot} sends {missing} although its disk is full")
                    return

    def _excuse(self, slot: int, for_us: int) -> None:
        now_us = self.cluster.host.now_us()
        self._excused.append((slot, now_us, now_us + for_us))

    def _thing_comes(self, at_us: int) -> None:
        self._comes.append((at_us, at_us + EXCUSED_US, self.cluster.world.newest_thing))

    def _excuse_ends(self) -> None:
        """S17: from now on a robot that still touches something must not press on it."""
        if not self._looks_at_contacts:
            self._look_at_contacts()

    def _look_at_contacts(self) -> None:
        """Note which robots are told to drive while they touch something, until nothing touches."""
        now_us, world = self._now_us(), self.cluster.world
        touching = [c for c in world.contacts if c.last_at_us >= now_us - CONTROL_PERIOD_US]
        for contact in touching:
            slots = (contact.first, contact.second)
            told = [world.robots[slot].commanded(now_us) for slot in slots if slot is not None]
            if any(drive.vx_m_s or drive.vy_m_s for drive in told):
                self._pressing_for_us[contact.t_us, contact.first] += CONTROL_PERIOD_US
        self._looks_at_contacts = bool(touching)
        if touching:
            self._at(now_us + CONTROL_PERIOD_US, self._look_at_contacts)

    def _shoved(self, slot: int, moved_at_us: int) -> None:
        """A person is about to move a robot; by `moved_at_us` it is done."""
        if self.protocol_world is None and self.cluster.is_up(slot):
            before = self.cluster.world.body(slot).position
            self._at(moved_at_us, partial(self._unnoticed, slot, before))

    def _unnoticed(self, slot: int, before: tuple[float, float]) -> None:
        """A lowered implement was moved past a strip of ground, by less than a working robot could
        detect from its speed: a push ends where there is no room."""
        after = self.cluster.world.body(slot).position
        if hypot(after[0] - before[0], after[1] - before[1]) < UNNOTICED_M:
            reach_m = self.setting.field.implement_width_m / 2 + 2 * UNNOTICED_M
            self._left.append((*before, reach_m))

    def _pressed(self, slot: int) -> None:
        if not self.cluster.is_up(slot):
            return
        now_us = self._now_us()
        self.witness.words.pressed(slot, now_us)
        if (
            now_us >= self._cut_ends_at_us
            and self._one_bus
            and self.cluster.robots[slot].peer.address is not None
        ):
            up = [robot.slot for robot in self.cluster.running]
            watch = self.delivery.press(now_us, DELIVERED_US, up)
            self._delivering[watch] = now_us + DELIVERED_US
            self._at(now_us + self._stand_for_us, partial(self._delivered, watch))
            self._at(now_us + STANDARD_US, partial(self._implements_stand, slot, now_us))

    def _implements_stand(self, slot: int, pressed_at_us: int) -> None:
        """S20: an implement that forgets a button after 3 s of silence stands as long as the
        fleet."""
        now_us, words = self.cluster.host.now_us(), self.witness.words
        stood = (
            words.speakers[slot].stopped and words.speakers[slot].stopped_at_us <= pressed_at_us + S
        )
        calm = self._trouble_at_us < pressed_at_us and self._one_bus and self.cluster.is_up(slot)
        if stood and calm and now_us - words.implements_stop_at_us > FORGET_US:
            self._add(
                "S20", now_us / 1e6, f"robot {slot} is stopped, and no robot tells the implements"
            )

    def _delivered(self, watch: int) -> None:
        if self._delivering.pop(watch, None) is not None:
            self.delivery.release(watch)

    def _no_robots_meet(self, end_at_us: int) -> None:
        """Until then robots that have not met may be unable to: no address is free, or no frame gets
        through."""
        self.cluster.look()
        self.cluster.acquaintance.addresses_taken(end_at_us)

    def _unsure_of_name(self) -> None:
        """A device claims an address while robots may miss the claim."""
        faults = self.cluster.segment.wire.faults
        if self._now_us() < self._cut_ends_at_us or faults.loss or faults.omission:
            self.witness.words.without_name()

    def _interrupted(self) -> None:
        """A stop that is being sent may not be sent completely, so only the silence limit
        applies."""
        now_us = self.cluster.host.now_us()
        for watch in [watch for watch, end_at_us in self._delivering.items() if now_us < end_at_us]:
            self._delivered(watch)
        self.cluster.stops.interrupted(now_us - DELIVERED_US)

    @property
    def _one_bus(self) -> bool:
        """Whether all robots that are switched on are on one working bus."""
        wire = self.cluster.segment.wire
        nodes = [wire.nodes[robot.bus.node] for robot in self.cluster.running]
        off = any(node.off_ends_at_us is not None or node.tec for node in nodes)
        return not wire.faults.deaf and not off and len({node.island for node in nodes}) == 1

    def _can_know(self, one: int, other: int) -> bool:
        """Whether one of two robots must stand, or can hear that the other one works.

        Two robots that were switched on behind a cut, and have never met, know nothing of each other.
        A thief that lies about sections is believed until its revocation (`docs/how/trust.md`).
        """
        now_us = self.cluster.host.now_us()
        if any(begin_at_us <= now_us < end_at_us for begin_at_us, end_at_us in self._lies):
            return False
        self.cluster.look()
        met = self.cluster.acquaintance.met
        if met(one, other) or met(other, one):
            return True
        return self._one_bus and self.cluster.host.now_us() >= self._cut_ends_at_us

    def _all_told(self, one: int, other: int) -> bool:
        """Whether all robots have received each other for so long that a split has healed."""
        faults = self.cluster.segment.wire.faults
        lossy = faults.loss or faults.omission or faults.error
        now_us = self.cluster.host.now_us()
        # A babbler holds up the frames that reconcile two parts even after the cut itself.
        calm = now_us - self._trouble_at_us > SETTLED_US and now_us >= self._cut_ends_at_us
        return calm and self._one_bus and not lossy

    def _note_units(self) -> None:
        """Once a second in a field, and before a robot dies or starts: robots that are up know the units
        that were told since."""
        speakers = self.witness.words.speakers
        up = [robot.slot for robot in self.cluster.running]
        own = {slot: units_of(speakers[slot].own_progress) for slot in up}
        self._units.told(own, self.cluster.host.now_us())

    def _part(self, end_at_us: int) -> None:
        """Robots may be unable to hear each other until then."""
        self._at(self._units.parts(self.cluster.host.now_us(), end_at_us), self._exchange_units)

    def _exchange_units(self) -> None:
        up = [robot.slot for robot in self.cluster.running]
        self._units.exchanged(up, self.cluster.host.now_us())

    def _hear_all(self) -> None:
        """Once a second in a field under another policy than `stop`."""
        now_us = self.cluster.host.now_us()
        if self._all_told(NOBODY, NOBODY):
            self._all_told_at_s.add(now_us // S)

    @property
    def _stand_for_us(self) -> int:
        return beat_of(self.scenario.fleet.robots).silence_for_us + SLACK_US

    def _silent_for_us(self, slot: int) -> int:
        """After this the death of a robot is noticed. Beats that somebody imitates count until its proofs
        end, and then it has to be silent."""
        hidden = self.cluster.stops.is_imitated(slot, self.cluster.host.now_us())
        life_for_us = beat_of(self.scenario.fleet.robots).life_for_us
        return self._stand_for_us + (life_for_us if hidden else 0)

    def _dies(self, slot: int) -> None:
        """S6: if links are without trouble, all robots that have met it must stand until it is
        back."""
        cluster, now_us = self.cluster, self._now_us()
        calm = now_us - self._trouble_at_us > SETTLED_US
        if cluster.is_up(slot) and calm and self.scenario.fleet.silence == "stop":
            met = cluster.acquaintance.met
            others = [robot.slot for robot in cluster.running if met(robot.slot, slot)]
            silent_for_us = self._silent_for_us(slot)
            watch = self.silence.press(now_us, silent_for_us, others)
            self._silences.setdefault(slot, {})[watch] = now_us + silent_for_us
        if cluster.is_up(slot):
            # A process that hung noticed nothing meanwhile.
            hung_at_us = cluster.acquaintance.hang_began_at_us(slot, now_us)
            self._off_at_us[slot] = now_us if hung_at_us is None else hung_at_us
        self._trouble_at_us = now_us
        self._note_units()
        own = self.witness.words.speakers[slot].own_progress  # units of others are on no disk
        self._units.forgets(slot, set(units_of(own)))
        self._lapses(slot)

    def _lapses(self, slot: int) -> None:
        if self.cluster.is_up(slot):
            self._interrupted()
            self._last_command_holds(slot)

    def _last_command_holds(self, slot: int) -> None:
        """Until it expires in the actuator: no other one arrives there."""
        for checker in (self.cluster.stops.checker, self.silence, self.delivery, self.senseless):
            checker.lapses(slot, self.cluster.host.now_us())

    def _heard_of(self, slot: int) -> None:
        """It is back, and all may go on."""
        self._unsure_of_silence(slot, heard=True)

    def _unsure_of_silence(self, slot: int, heard: bool) -> None:
        """S6: it can no longer be determined when robots notice its death. Those that had to know it by
        now stand on, if no one speaks in its name."""
        watches, now_us = self._silences.pop(slot, {}), self.cluster.host.now_us()
        noticed = {number: due for number, due in watches.items() if due <= now_us and not heard}
        for number in watches.keys() - noticed.keys():
            self.silence.release(number)
        if noticed:
            self._silences[slot] = noticed

    def _knows_no_silence(self, slot: int, remembers: bool) -> None:
        """It boots, and has never received those that are dead. If it has kept its memory, it stands on
        for those whose silence it had noticed. All others stand as before."""
        for watches in self._silences.values():
            for number, due_at_us in list(watches.items()):
                noticed = due_at_us <= self._off_at_us.get(slot, NEVER_US)
                if (remembers and noticed) or slot not in self.silence.bound(number):
                    continue
                if self.silence.bound(number) == {slot}:
                    del watches[number]
                self.silence.release(number, (slot,))

    def _power(self, slot: int, on: bool) -> None:
        """A robot is about to be switched on or to die."""
        if not on:
            self._dies(slot)
            return
        now_us = self._now_us()
        self._lost = {address: lost for address, lost in self._lost.items() if lost[2] != slot}
        self._heard_of(slot)
        if now_us < self._blind_ends_at_us.get(slot, 0):
            self._at(now_us, partial(self._loses_senses, slot, self._blind_ends_at_us[slot]))
        self._trouble_at_us = now_us
        self._cut_ends_at_us = max(self._cut_ends_at_us, now_us + SETTLED_US)
        self._part(self._cut_ends_at_us)
        self._note_units()
        journal = self.cluster.journals[slot]
        recalled = journal.load()
        if LOST in recalled and not (isinstance(journal, LogJournal) and journal.restored):
            self._add("S13", now_us / 1e6, f"robot {slot} has lost what it had written")
        self._knows_no_silence(slot, remembers(recalled))
        if not remembers(recalled):
            self._units.forgets(slot)
            self.cluster.stops.forgets(slot)
            self.witness.forget(slot)
            return
        self.witness.words.restarts(slot, self._worked)
        missing = lost(self.witness.told[slot], recalled, self._worked)
        if missing and not (missing == STANDS and slot in self.witness.released):
            self._add("S13", now_us / 1e6, f"robot {slot} forgets {missing}")
        self._at(now_us, partial(self._reads, slot))

    @property
    def _worked(self) -> Worked | None:
        """What was worked in truth, if this world keeps it by units."""
        return None if self.protocol_world is None else self.protocol_world.worked

    def _reads(self, slot: int) -> None:
        """It has read its disk, and has received no frame yet."""
        peer = self.cluster.robots[slot].peer
        known = self._units.known_at_us
        self._units.forgets(slot, {unit for unit in known if peer.progress.has(*unit)})
        told = self.witness.told[slot]
        missing = unknown(told, peer.allocation, peer.progress, self._worked)
        if missing:
            t_s = self.cluster.host.now_us() / 1e6
            self._add("S13", t_s, f"robot {slot} does not read {missing}")

    def _all_released(self) -> None:
        now_us, speakers = self.cluster.host.now_us(), self.witness.words.speakers
        self._settled = True
        self.witness.words.questions.clear()
        up = [robot.slot for robot in self.cluster.running]
        standing = [slot for slot in up if speakers[slot].stopped]
        if standing:
            self._add("L2", now_us / 1e6, f"robots {standing} are still stopped")
        votes = [speakers[slot].votes for slot in up]
        if len(up) > 1 and not any(votes):
            self._add("L7", now_us / 1e6, f"no leader: none of the robots {up} has voted")
        for election in sorted({number for known in votes for number in known}):
            newest = [known[election] for known in votes if election in known]
            term = max(vote.term for vote in newest)
            tally = Counter(vote.candidate for vote in newest if vote.term == term)
            if max(tally.values()) * 2 <= len(up):
                self._add("L7", now_us / 1e6, f"no leader of election {election}: {dict(tally)}")

    # ---------------------------------------------------------------- at the end

    def _judge(self, outcome: FieldOutcome) -> None:
        world, end_at_s = self.cluster.world, outcome.simulated_s
        self._moved()
        self._contacts()
        self._implements_over_things()
        self._repeated_work()
        bodies = self.protocol_world is None
        self._exclusive_work(self._exclusive(world) if bodies else self._together)
        if not outcome.replicas_equal:
            self._add("L1", end_at_s, "replicas differ")
        questions = self.witness.words.questions
        if self._settled and questions.total() > self.scenario.fleet.robots:
            what = (
                f"long after the calm began robots still ask for what they lack: {dict(questions)}"
            )
            self._add("L1", end_at_s, what)
        whole = outcome.reached >= WHOLE or self._accounted_for(world, outcome.reached)
        if not (outcome.finished and whole):
            what = f"finished: {outcome.finished}, coverage {outcome.coverage:.2%}"
            self._add("L5", end_at_s, what)
        else:
            self._all_units_told()

    def _all_units_told(self) -> None:
        """Check that the fleet knows all worked units, not only that sections are done."""
        world = self.protocol_world
        if world is None:
            return
        told = sum(bits.bit_count() for bits in self.witness.words.units.values())
        untold = sum(world.units.values()) - told
        if untold:
            self._add(
                "L5", world.now_us / 1e6, f"finished, and {untold} units were never announced"
            )

    def _accounted_for(self, world: World, reached: float) -> bool:
        """Whether all unworked ground lies around machines that stayed switched off, where a person has
        moved one a little, or on rings of a drawn field where bodies that steer leave some."""
        if self.protocol_world is not None:
            return False
        slots, left = range(self.scenario.fleet.robots), [*self._left]
        for body in (world.robots[slot] for slot in slots if not self.cluster.is_up(slot)):
            left.append((*body.position, DEAD_M))
        bent = reached >= BENT
        if not (left or bent):
            return False
        field = self.setting.field
        raster = sample_points(field.polygon, field.implement_width_m, field.overlap_m)
        tracks = {slot: body.track for slot, body in world.robots.items()}
        can = self.setting.ground(raster).cells
        missed = coverage(raster, tracks, field.implement_width_m, can).missed
        return all(
            any(hypot(x_m - at_x_m, y_m - at_y_m) < reach_m for at_x_m, at_y_m, reach_m in left)
            or (bent and self._is_on_rings(x_m, y_m))
            for x_m, y_m in missed
        )

    def _is_on_rings(self, x_m: float, y_m: float) -> bool:
        """Whether rings of a drawn field, which bend, are driven there by bodies that steer."""
        field = self.setting.field
        if self.scenario.fleet.drive == "mecanum" or not is_drawn(self.scenario.field.file):
            return False
        away_m = field.polygon.boundary.distance(Spot(x_m, y_m))
        return bool(away_m < RINGS_WIDTHS * field.implement_width_m)

    @property
    def _moving(self) -> list[tuple[str, Any]]:
        return [
            ("S1", self.cluster.stops),
            ("S1", self.delivery),
            ("S6", self.silence),
            ("S19", self.senseless),
        ]

    def _moved(self) -> None:
        for rule, checker in self._moving:
            for violation in [v for v in checker.violations if not self._run_into(v)][:1]:
                self._add(rule, violation.t_us / 1e6, f"robots {violation.slots}: {violation.what}")

    def _run_into(self, violation: Violation) -> bool:
        """Whether a robot that a person pushes touches this one, so that it moves without being told."""
        return violation.what == MOVES and any(
            {robot, *violation.slots} == {contact.first, contact.second}
            and begin_at_us <= contact.t_us <= end_at_us
            and contact.t_us <= violation.t_us <= contact.last_at_us + ROLLS_ON_US
            for robot, begin_at_us, end_at_us in self._pushes
            for contact in self.cluster.world.contacts
        )

    @property
    def _together(self) -> list[Violation]:
        return [] if self.protocol_world is None else self.protocol_world.together

    def _exclusive_work(self, found: list[Violation]) -> None:
        for violation in found[:1]:
            self._add("S7", violation.t_us / 1e6, f"robots {violation.slots}: {violation.what}")

    def _contacts(self) -> None:
        for contact in self.cluster.world.contacts:
            slots = {contact.first, contact.second}
            spans = [(begin, end) for slot, begin, end in self._excused if slot in slots]
            if contact.against.startswith(THING):
                number = int(contact.against.removeprefix(THING))
                spans += [(begin, end) for begin, end, newest in self._comes if number > newest]
            # A contact that goes on after its excuse is over is one like any other, unless the robots
            # in it stand.
            stands = self._pressing_for_us[contact.t_us, contact.first] < LEANS_US
            excused = any(
                begin <= contact.t_us < end and (stands or contact.last_at_us < end + LEANS_US)
                for begin, end in spans
            )
            for_us = contact.last_at_us - contact.t_us
            if (contact.depth_m > TOUCH_M or for_us >= LEANS_US) and not excused:
                how = f"{contact.depth_m * 100:.0f} cm into"
                if contact.depth_m <= TOUCH_M:
                    how = f"leans for {for_us / S:.1f} s on"
                self._add(
                    "S17", contact.t_us / 1e6, f"robot {contact.first} {how} {contact.against}"
                )
                return

    def _implements_over_things(self) -> None:
        """S23: by true places. What moves may have come under the bar by itself."""
        world = self.cluster.world
        if self.protocol_world is not None or not world.things:
            return
        field, radius_m = self.setting.field, self.scenario.fleet.radius_m
        tracks = {slot: body.track.to_array() for slot, body in world.robots.items()}
        points = {slot: body.track for slot, body in world.robots.items()}
        for over in things_under_bars(points, world.things, field.implement_width_m):
            excused = any(
                over.slot == slot and begin_at_us <= over.t_us < end_at_us
                for slot, begin_at_us, end_at_us in (*self._excused, *self._sees_wrong)
            ) or any(
                begin <= over.t_us < end and not was_there(world.things, over.thing, begin)
                for begin, end, _ in self._comes
            )
            at, half_m = (
                Spot(over.thing[AT_X], over.thing[AT_Y]),
                hypot(*over.thing[HALF_X : HALF_Y + 1]),
            )
            at_fence = field.polygon.boundary.distance(at) < half_m + AT_FENCE_M
            beside = any(
                hypot(
                    float(np.interp(over.t_us, track[:, 0], track[:, 1])) - at.x,
                    float(np.interp(over.t_us, track[:, 0], track[:, 2])) - at.y,
                )
                < half_m + radius_m + HIDDEN_M
                for slot, track in tracks.items()
                if slot != over.slot
            )
            if over.stood and not (excused or at_fence or beside):
                what = f"the implement of robot {over.slot} is drawn over {at.x:.1f}, {at.y:.1f}"
                self._add("S23", over.t_us / 1e6, what)
                return

    def _repeated_work(self) -> None:
        """S24: by true places, of units that are told and of robots that hear each other."""
        world = self.cluster.world
        if self.protocol_world is not None:
            return
        tracks = {slot: body.track for slot, body in world.robots.items()}
        checker = RepeatedWorkChecker(self.setting.field.sections, ON_LINE_M)
        for each in checker.repeated(tracks, self._units.known_at_us):
            astray = any(
                each.slot == slot
                and each.begun_at_us < end_at_us
                and begin_at_us < each.ended_at_us
                for slot, begin_at_us, end_at_us in (*self._excused, *self._sees_wrong)
            )
            if not (astray or self._units.is_apart(each.begun_at_us)):
                section, unit = each.unit
                what = f"robot {each.slot} works unit {unit} of S{section}, which was told before"
                self._add("S24", each.begun_at_us / 1e6, what)
                return

    @property
    def setting(self) -> FieldSetup:
        """The field; a protocol run has none."""
        assert isinstance(self.any_setting, FieldSetup)
        return self.any_setting

    def _exclusive(self, world: World) -> list[Any]:
        field = self.setting.field
        sections = {number: list(section.swaths) for number, section in enumerate(field.sections)}
        tracks = {slot: body.track for slot, body in world.robots.items()}
        checker = ExclusiveWorkChecker(sections, ON_LINE_M, least_m=LEAD_M + 0.5)
        found = checker.violations(tracks, self._spans_down)
        if self.scenario.fleet.silence == "stop":
            return found
        told = [self._since_told(each) for each in found]
        return sorted((each for each in told if each is not None), key=attrgetter("t_us"))

    def _since_told(self, both: Violation) -> Violation | None:
        """From the first second of it on in which all robots had received each other; None: in none."""
        first, last = both.t_us // S, both.last_at_us // S
        told = [second for second in range(first, last + 1) if second in self._all_told_at_s]
        return both._replace(t_us=max(both.t_us, told[0] * S)) if told else None

    def _add(self, rule: str, t_s: float, what: str) -> None:
        self.broken.append(RuleViolation(rule, t_s, what))
