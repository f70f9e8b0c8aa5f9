"""Rules about the frames of robots, judged from the frames and from what people did.

S2 and S3: a robot that has held a stop does not report its release before an operator has cleared
that stop. S4: after a reset no robot works before a start. S7: a robot starts claimed work only
after every robot has had the time for a better claim. S8: a press creates a stop with a new name.
S9: a robot never takes back what it has sent of a register, of progress, or of its operations, not
even over restarts; so a released claim does not return (S11). S16: one vote a term, one leader a
term. S21: no robot sends a stop of a machine that does not exist.
"""

from collections import Counter, defaultdict
from typing import NamedTuple

from agent.interface.config import CONTENTION_US, STOP_SPACING_US
from agent.interface.lifecycle import WORKING
from crdt import Phase
from crdt.claim_register import pack
from crdt.stops import StopDot
from protocol.frames.fleet_frames import Heartbeat, LeaderElectionVote, Member, Pose
from protocol.frames.key_frames import KeysHeld
from protocol.frames.messages import Message
from protocol.frames.safety_frames import (
    EVERYBODY,
    AllImplementsStop,
    Command,
    EmergencyReset,
    EmergencyStop,
    OperatorCommand,
    Switch,
)
from protocol.frames.work_frames import StateSyncRequest, StateSyncResponse, TaskClaim, WorkProgress
from sim.chaos.durability_rules import Worked, true_units
from sim.fleet.foreign_devices import PANEL

HALF_U16 = 0x8000  # operations are counted modulo 2^16 on the wire
NEVER_US = -1
CONTESTED_US = CONTENTION_US * 98 // 100  # by the robot's clock, which may drift by half a percent


class RuleViolation(NamedTuple):
    """Which rule was broken when, with a sentence that says how."""

    rule: str
    t_s: float
    what: str


class RobotStatements:
    """What one robot has sent so far, since it last lost its memory."""

    def __init__(self) -> None:
        self.incarnation = -1
        self.operations = -1
        self.generation = 0  # of the keys that it uses
        self.registers: dict[int, int] = {}  # of all sections that it has sent
        self.own: dict[int, int] = {}  # those that it wrote itself, which are on its disk
        self.progress: dict[tuple[int, int], int] = {}
        # New units of sections it has claimed: its own work, which is on its disk before it is
        # sent. Units relayed for other robots are not on this robot's disk.
        self.own_progress: dict[tuple[int, int], int] = {}
        self.claimed_at_us: dict[int, int] = {}  # section -> when it sent its claim
        self.claims_unknown = (
            False  # its clock was set, or it may have claimed before it lost its memory
        )
        self.dots: set[StopDot] = set()  # every stop that it has pressed or echoed
        self.stopped = False
        self.stopped_at_us = NEVER_US  # since when it reports it, in a stop frame or a beat
        # the newest order to reset it; then the newest order to start it
        self.reset_at_us = NEVER_US
        self.start_at_us = NEVER_US
        self.asks_start = False  # it was reset, and has not been started since
        self.pressed_at_us = NEVER_US
        self.unnamed = False  # the stop of that press has not been sent yet
        self.old_name: StopDot | None = None  # the only stop that it has sent since the press
        self.votes: dict[int, LeaderElectionVote] = {}  # newest of each election


class ProtocolRules:
    """Judges every frame that robots send against what they sent before and what people cleared."""

    def __init__(self, robots: int) -> None:
        self.robots = robots
        self.speakers: defaultdict[int, RobotStatements] = defaultdict(RobotStatements)
        self.broken: list[RuleViolation] = []
        self.cleared: set[StopDot] = set()
        # A device without a claim has sent; its stops latch, to be safe.
        self.unknown_device = False
        # (section, block) -> bits that any robot has sent.
        self.units: dict[tuple[int, int], int] = {}
        self._lies: dict[tuple[int, int], int] = {}  # units that a thief has told
        self.questions: Counter[int] = Counter()  # questions of each robot for entries it lacks
        self.implements_stop_at_us = NEVER_US  # when a robot last sent the standard stop
        self._said_at_us: dict[StopDot, int] = {}  # when a stop was first sent, by any robot
        self._resumes_at_us: dict[int, int] = {}  # when the process of a robot runs on
        self._votes: dict[tuple[int, int, int], int] = {}  # voter, election, term -> candidate
        # (election, term, candidate) -> voters.
        self._voters: defaultdict[tuple[int, int, int], set[int]] = defaultdict(set)

    def hangs(self, slot: int, end_at_us: int) -> None:
        """The process of a robot hangs. Then it reads what was sent meanwhile, in that order."""
        self._resumes_at_us[slot] = max(end_at_us, self._resumes_at_us.get(slot, NEVER_US))

    # ---------------------------------------------------------------- what people do

    def pressed(self, slot: int, now_us: int) -> None:
        """Call before the robot gets the press."""
        speaker = self.speakers[slot]
        if now_us - speaker.pressed_at_us >= STOP_SPACING_US or speaker.pressed_at_us == NEVER_US:
            speaker.pressed_at_us, speaker.unnamed, speaker.old_name = now_us, True, None

    def ordered(self, order: Message, now_us: int) -> None:
        """Handle an operator's frame, whether or not any robot receives it."""
        if isinstance(order, EmergencyReset):
            self.cleared.add(StopDot(order.slot, order.incarnation, order.counter))
        elif isinstance(order, OperatorCommand):
            for slot in range(self.robots):
                if order.target in (slot, EVERYBODY):
                    if order.command == Command.MANUAL_RESET:
                        self.speakers[slot].reset_at_us = now_us
                    elif order.command == Command.START:
                        self.speakers[slot].start_at_us = now_us

    def without_name(self) -> None:
        """A device with an unknown NAME has sent a frame, so S21 cannot be judged from now on."""
        self.unknown_device = True

    def leaps(self, slot: int) -> None:
        """Its clock is set, so its waiting time after a claim cannot be measured from outside."""
        self.speakers[slot].claimed_at_us.clear()
        self.speakers[slot].claims_unknown = True

    def restarts(self, slot: int, worked: Worked | None = None) -> None:
        """A restart with its memory kept. Entries of other robots that it relayed were never on
        disk, nor were lies of a thief. `worked`: as in `durability_rules.lost`."""
        speaker = self.speakers[slot]
        speaker.registers = dict(speaker.own)
        speaker.progress = {
            place: true_units(WorkProgress(*place, bits), worked)
            for place, bits in speaker.own_progress.items()
        }

    def forgets(self, slot: int) -> None:
        """Its memory is lost; from now on it counts as another robot of the same slot."""
        has_sent = self.speakers[slot].incarnation >= 0
        self.speakers[slot] = RobotStatements()
        self.speakers[slot].claims_unknown = has_sent
        for key in [key for key in self._votes if key[0] == slot]:
            del self._votes[key]
        for voters in self._voters.values():
            voters.discard(slot)

    def lied(self, message: Message) -> None:
        """A thief says this. Units that a robot repeats are not its own work, also if it is working
        one of them at that time."""
        if isinstance(message, WorkProgress):
            place = message.section, message.block
            self._lies[place] = self._lies.get(place, 0) | message.bits

    # ---------------------------------------------------------------- frames of robots

    def said(self, slot: int, now_us: int, message: Message) -> None:
        """Judge one message that robot `slot` has sent, at the time of the observer's clock."""
        speaker = self.speakers[slot]
        if speaker.old_name is not None and now_us > speaker.pressed_at_us:
            self._add(
                "S8", now_us, f"robot {slot} gives a new stop an old name, {speaker.old_name}"
            )
            speaker.old_name = None
        kind = type(message)
        if isinstance(message, Pose):
            self._pose(slot, speaker, now_us, message)
        elif isinstance(message, AllImplementsStop):
            if message.switch == Switch.STOP:
                self.implements_stop_at_us = now_us
        elif isinstance(message, EmergencyStop):
            if not message.spent:  # a report of a used name is not a stop
                self._stop(slot, speaker, now_us, message)
        elif isinstance(message, Heartbeat):
            ahead = (message.operations - speaker.operations) & 0xFFFF
            if speaker.operations >= 0 and ahead >= HALF_U16:
                self._add("S9", now_us, f"robot {slot} counts its operations backwards")
            speaker.operations = message.operations
        elif isinstance(message, KeysHeld) and message.switched:
            if message.generation > speaker.generation:  # what a revoked member said is void
                speaker.generation = message.generation
                speaker.registers.clear()
                speaker.own.clear()
                speaker.progress.clear()
                speaker.own_progress.clear()
        elif isinstance(message, TaskClaim | StateSyncResponse):
            m = message
            key = pack(m.epoch, Phase(m.phase), m.bid, m.lamport, m.owner)
            if key < speaker.registers.get(m.section, 0):
                self._add("S9", now_us, f"robot {slot} takes back what it sent about S{m.section}")
            speaker.registers[m.section] = key
            if kind is TaskClaim:
                speaker.own[m.section] = key
            if kind is TaskClaim and m.owner == slot:
                self._claim(slot, speaker, now_us, m.section, Phase(m.phase))
        elif isinstance(message, WorkProgress):
            place = message.section, message.block
            if speaker.progress.get(place, 0) & ~message.bits:
                self._add("S9", now_us, f"robot {slot} takes back units of S{message.section}")
            speaker.progress[place] = message.bits
            known = self.units.get(place, 0)
            if message.section in speaker.own:
                own, lies = speaker.own_progress.get(place, 0), self._lies.get(place, 0)
                speaker.own_progress[place] = own | message.bits & ~known & ~lies
            self.units[place] = known | message.bits
        elif kind is StateSyncRequest:
            self.questions[slot] += 1
        elif isinstance(message, LeaderElectionVote):
            self._vote(slot, speaker, now_us, message)
        elif isinstance(message, Member):
            if message.incarnation != speaker.incarnation and speaker.incarnation >= 0:
                self._add("S8", now_us, f"robot {slot} changes its incarnation, memory kept")
            speaker.incarnation = message.incarnation

    def _pose(self, slot: int, speaker: RobotStatements, now_us: int, pose: Pose) -> None:
        if pose.stopped and not speaker.stopped:
            if not speaker.dots:  # else it reported it in the stop frame, before this beat
                speaker.stopped_at_us = now_us
        elif speaker.stopped and not pose.stopped:
            speaker.asks_start = True
            if speaker.reset_at_us < speaker.stopped_at_us:
                self._add("S2", now_us, f"robot {slot} is released, and no person has reset it")
        if not pose.stopped and speaker.dots:
            held = speaker.dots - self.cleared
            if held:
                self._add("S3", now_us, f"robot {slot} is released from {sorted(held)[0]}")
            speaker.dots.clear()
        if speaker.asks_start and speaker.start_at_us > speaker.stopped_at_us:
            speaker.asks_start = False
        if speaker.asks_start and pose.state == WORKING:
            self._add("S4", now_us, f"robot {slot} works after a reset without a start")
            speaker.asks_start = False
        speaker.stopped = pose.stopped

    def _stop(self, slot: int, speaker: RobotStatements, now_us: int, stop: EmergencyStop) -> None:
        dot = StopDot(stop.slot, stop.incarnation, stop.counter)
        new = speaker.unnamed and speaker.pressed_at_us == now_us
        if new and stop.slot == slot and not stop.echo:
            # An old stop may be repeated in the microsecond of the press, before the new one.
            speaker.unnamed = dot in speaker.dots or dot in self.cleared
            speaker.old_name = dot if speaker.unnamed else None
        said_at_us = self._said_at_us.setdefault(dot, now_us)
        if not speaker.stopped and not speaker.dots:
            # Orders that a hung robot received after the stop come after it, although it reads all
            # of them at once.
            resumes = self._resumes_at_us.get(slot) == now_us
            speaker.stopped_at_us = said_at_us if resumes else now_us
        speaker.dots.add(dot)
        if stop.slot >= self.robots and stop.slot != PANEL and not self.unknown_device:
            self._add(
                "S21",
                now_us,
                f"robot {slot} sends a stop of machine {stop.slot}, which does not exist",
            )

    def _claim(
        self, slot: int, speaker: RobotStatements, now_us: int, section: int, phase: Phase
    ) -> None:
        if phase is Phase.CLAIMED:
            speaker.claimed_at_us[section] = now_us
            return
        claimed_at_us = speaker.claimed_at_us.pop(section, None)
        if phase is not Phase.STARTED:
            return
        if claimed_at_us is None and not speaker.claims_unknown:
            self._add("S7", now_us, f"robot {slot} starts S{section}, which it has not claimed")
        elif claimed_at_us is not None and now_us - claimed_at_us < CONTESTED_US:
            self._add("S7", now_us, f"robot {slot} starts S{section}, which is still contested")

    def _vote(
        self, slot: int, speaker: RobotStatements, now_us: int, vote: LeaderElectionVote
    ) -> None:
        key = slot, vote.election, vote.term
        before = self._votes.get(key)
        if before is None:
            self._votes[key] = vote.candidate
            cast = vote.election, vote.term, vote.candidate
            self._voters[cast].add(slot)
            if len(self._voters[cast]) * 2 > self.robots:
                for (election, term, candidate), voters in self._voters.items():
                    same = (election, term) == cast[:2] and candidate != vote.candidate
                    if same and len(voters) * 2 > self.robots:
                        self._add("S16", now_us, f"two leaders in term {term}")
        elif before != vote.candidate:
            self._add("S16", now_us, f"robot {slot} votes twice in term {vote.term}")
        speaker.votes[vote.election] = vote

    def _add(self, rule: str, now_us: int, what: str) -> None:
        # Only the first violation of each rule.
        if not any(broken.rule == rule for broken in self.broken):
            self.broken.append(RuleViolation(rule, now_us / 1e6, what))
