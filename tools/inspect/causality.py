"""How a section came to its owner: every frame that changed its register, and the frames that led to it.

A register is a maximum over one order. So for every frame it is known by which field it won, and over
which value. Only frames are evidence: the evidence for a silent robot is the last frame that was heard
from it.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from agent.interface.config import LEASE_US, S
from crdt import Phase
from crdt.claim_register import EPOCH_MAX, Claim, pack
from protocol.frames.fleet_frames import Heartbeat
from protocol.frames.frame import Frame
from protocol.frames.messages import Message
from protocol.frames.safety_frames import (
    EVERYBODY,
    AllImplementsStop,
    Command,
    EmergencyStop,
    OperatorCommand,
)
from protocol.frames.work_frames import StateSyncRequest, StateSyncResponse, TaskClaim, WorkProgress

# Newest steps kept of a section: an epoch has three, and few sections have ten epochs.
STEPS_MAX = 64
RIVALS_MAX = 8  # kept of one step
NOTES_MAX = 256  # newest stops, orders and farewells
# Longest time from a cause to the release that it leads to: a control period and the bus.
NEAR_S = 2.0
Register = TaskClaim | StateSyncResponse


class Evidence(NamedTuple):
    """One frame as heard, and what it means here."""

    t_s: float
    said_by: int | None  # slot; None: a device that is no robot
    kind: str
    frame: Frame
    text: str

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "t_s": round(self.t_s, 6), "said_by": self.said_by, "frame": self.kind,
            "id": f"{self.frame.identifier:08X}", "data": self.frame.data.hex().upper(),
            "text": self.text,
        }  # fmt: skip


@dataclass
class Step:
    """A frame that changed the register."""

    heard: Evidence
    claim: Claim
    because: list[Evidence] = field(default_factory=list)
    rivals: list[Evidence] = field(default_factory=list)  # frames that lost against it
    again: int = 0  # times it was said again

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, with the frames that led to it."""
        return {
            **self.heard.to_dict(), "phase": self.claim.phase.name, "epoch": self.claim.epoch,
            "bid": self.claim.bid, "lamport": self.claim.lamport, "owner": self.claim.owner,
            "because": [e.to_dict() for e in self.because],
            "rivals": [e.to_dict() for e in self.rivals], "again": self.again,
        }  # fmt: skip


class Causality:
    """Hears every frame of a bus or a log, in order."""

    def __init__(self) -> None:
        self._steps: dict[int, deque[Step]] = {}
        self._last: dict[int, Evidence] = {}  # slot -> its newest frame
        self._notes: deque[tuple[int, Evidence]] = deque(
            maxlen=NOTES_MAX
        )  # the robot that it concerns, first
        self._asked: Evidence | None = None  # the newest request for state
        self._worked: dict[int, tuple[Evidence, int]] = {}  # section -> newest progress, how many

    def hear(self, t_s: float, frame: Frame, slot: int | None, message: Message) -> None:
        """Take one decoded frame of robot `slot`; None if the sender has said no slot."""
        match message:
            case TaskClaim() | StateSyncResponse():
                self._register(t_s, frame, slot, message)
            case StateSyncRequest():
                self._asked = _heard(t_s, frame, slot, message, "asked what it had missed")
            case WorkProgress():
                count = self._worked.get(message.section, (None, 0))[1] + 1
                told = _heard(t_s, frame, slot, message, f"told progress, {count} frames of it")
                self._worked[message.section] = told, count
            case EmergencyStop():
                self._note(EVERYBODY, _heard(t_s, frame, slot, message, "emergency stop"))
            case AllImplementsStop(switch=0):
                self._note(EVERYBODY, _heard(t_s, frame, slot, message, "all implements stop"))
            case OperatorCommand():
                text = f"an operator's {Command(message.command).name}"
                self._note(message.target, _heard(t_s, frame, slot, message, text))
            case Heartbeat(leaving=True) if slot is not None:
                self._note(slot, _heard(t_s, frame, slot, message, "said goodbye"))
        if slot is not None:
            self._last[slot] = _heard(t_s, frame, slot, message, "was last heard")

    def chain(self, section: int) -> list[Step]:
        """The kept steps by which a section came to its owner, the oldest first."""
        return list(self._steps.get(section, ()))

    @property
    def sections(self) -> list[int]:
        """Numbers of all sections that a frame has named."""
        return sorted(self._steps)

    # ---------------------------------------------------------------- inside

    def _note(self, whom: int, told: Evidence) -> None:
        self._notes.append((whom, told))

    def _register(self, t_s: float, frame: Frame, slot: int | None, m: Register) -> None:
        claim = Claim(m.epoch, Phase(m.phase), m.bid, m.lamport, m.owner)
        key = pack(m.epoch, m.phase, m.bid, m.lamport, m.owner)
        steps = self._steps.setdefault(m.section, deque(maxlen=STEPS_MAX))
        newest = steps[-1] if steps else None
        if newest is None or key > newest.claim.pack():
            heard = _heard(t_s, frame, slot, m, _says(claim))
            steps.append(Step(heard, claim, self._because(t_s, m, claim, newest)))
            return
        same = next((step for step in reversed(steps) if step.claim == claim), None)
        if same is not None:
            same.again += 1
        elif len(newest.rivals) < RIVALS_MAX:
            text = f"{_says(claim)}, and loses: {_by_what(newest.claim, claim)}"
            newest.rivals.append(_heard(t_s, frame, slot, m, text))

    def _because(
        self, t_s: float, m: Register, claim: Claim, before: Step | None
    ) -> list[Evidence]:
        because = []
        if before is not None:
            because.append(_upon(before, claim))
        if isinstance(m, StateSyncResponse) and self._asked is not None:
            because.append(self._asked)
        if claim.phase is Phase.DONE and m.section in self._worked:
            because.append(self._worked[m.section][0])
        if claim.phase is Phase.FREE:
            because += self._notes_of(claim.owner, t_s)[-1:]
        elif before is not None and claim.epoch > before.claim.epoch:
            because += self._taken_from(before.claim, t_s)
        return because

    def _notes_of(self, slot: int, t_s: float) -> list[Evidence]:
        return [e for whom, e in self._notes if whom in (slot, EVERYBODY) and t_s - e.t_s <= NEAR_S]

    def _taken_from(self, was: Claim, t_s: float) -> list[Evidence]:
        """Another one's claim was raised by an epoch: it had left, or was silent for its lease."""
        if was.phase is Phase.FREE:
            return []
        last = self._last.get(was.owner)
        if last is None:
            return []
        silent_s = t_s - last.t_s
        lease = f", and its lease of {LEASE_US // S} s was over" if silent_s > LEASE_US / S else ""
        return [last._replace(text=f"was last heard, {silent_s:.1f} s before{lease}")]


def _heard(t_s: float, frame: Frame, slot: int | None, message: Message, text: str) -> Evidence:
    return Evidence(t_s, slot, type(message).__name__, frame, text)


def _says(claim: Claim) -> str:
    match claim.phase:
        case Phase.FREE:
            return f"robot {claim.owner} gives it back"
        case Phase.CLAIMED:
            said = f"robot {claim.owner} claims it, bid {claim.bid}, epoch {claim.epoch}"
            return said + _stays(claim)
        case Phase.STARTED:
            return f"robot {claim.owner} starts it{_stays(claim)}"
        case _:
            return f"robot {claim.owner} has done it"


def _stays(claim: Claim) -> str:
    """That no other robot can take it any more, after all hand-overs that a register can count."""
    return f", for good after {EPOCH_MAX} hand-overs" if claim.epoch == EPOCH_MAX else ""


def _upon(before: Step, claim: Claim) -> Evidence:
    """The step before, with the field of the order by which the new one is greater."""
    return before.heard._replace(text=f"{before.heard.text}; now {_by_what(claim, before.claim)}")


def _by_what(more: Claim, less: Claim) -> str:
    """The most significant field by which a register is the greater one."""
    done, own = Phase.DONE, (more.epoch, more.owner) == (less.epoch, less.owner)
    if not own and (more.phase is done) != (less.phase is done):
        return "done work is never undone"
    if more.epoch != less.epoch:
        return f"epoch {more.epoch} is above {less.epoch}"
    if more.phase != less.phase:
        return f"{more.phase.name} is above {less.phase.name}"
    if more.bid != less.bid:
        return f"bid {more.bid} is less than {less.bid}"
    if more.lamport != less.lamport:
        return f"Lamport time {more.lamport} is earlier than {less.lamport}"
    return f"robot {more.owner} is before robot {less.owner}"
