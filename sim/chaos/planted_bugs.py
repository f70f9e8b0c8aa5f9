"""Planted bugs, each a change of one rule, in force only inside of `planted`.

A campaign that does not find these bugs proves nothing when it finds no error. A robot cannot reach
this code, because the package `agent` does not import this file.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

from agent.field.field_mission import FieldMission
from agent.interface.effects import HALT, Drive, Effect, Send
from agent.interface.instants import FOREVER_US, NEVER_US
from agent.motion.bar_guard import BarGuard
from agent.motion.holonomic_motion import HolonomicMotion
from agent.peer import member_conflicts as conflicts
from agent.peer import section_claims as claims
from agent.peer.durable_records import DurableRecords
from agent.peer.frame_origin import Origin, Origins
from agent.peer.implement_check import ImplementCheck
from agent.peer.member_discovery import MemberDiscovery
from agent.peer.membership import Membership
from agent.peer.peer import Peer
from agent.peer.place_jumps import NO_REACH, PlaceJumps
from agent.peer.place_progress import PlaceProgress
from agent.peer.progress_announcements import ProgressAnnouncements
from agent.peer.range_freshness import RangeSensing
from agent.peer.section_claims import SectionClaims
from agent.peer.self_check import SelfCheck
from agent.peer.sense_freshness import Senses
from agent.peer.work_admission import Admission
from agent.runtime.peer_runner import PeerRunner
from agent.safety.standard_stop import OwnButton, ShortcutButtons
from agent.safety.stop_controller import StopController
from crdt import Phase
from crdt.allocation import FieldAllocationCRDT
from crdt.progress import Progress
from crdt.stops import StopSet
from protocol.address import AddressClaim
from protocol.frames.fleet_frames import LeaderElectionVote
from protocol.frames.messages import Message
from protocol.frames.safety_frames import EmergencyStop, Switch
from protocol.frames.work_frames import TaskClaim
from protocol.sync.digest_comparison import Divergence
from protocol.sync.synchronizer import Synchronizer
from sim.fleet.simulated_disk import LogJournal
from sim.world.drive_trains import EXPIRES_US
from sim.world.robot_body import SimulatedBody


@dataclass(frozen=True)
class Mutant:
    """One planted bug: what it replaces where, and the profile that should find it."""

    about: str
    where: Any
    name: str
    change: Callable[[Any], Any]  # takes the correct function and returns the wrong one
    profile: str = "all"


def _constant(value: Any) -> Callable[[Any], Any]:
    return lambda right: lambda *args, **kwargs: value


def _value(value: Any) -> Callable[[Any], Any]:
    return lambda right: value


def _without_halt(right: Any) -> Any:
    def receive_stop(self: StopController, *args: Any) -> Sequence[Effect]:
        causes = dict(self._causes)
        effects = right(self, *args)
        self._causes = causes
        return [e for e in effects if e is not HALT]

    return receive_stop


def _single_shot(right: Any) -> Any:
    def press(self: StopController, *args: Any) -> Any:
        effects = right(self, *args)
        self._own.clear()
        self._repeat_at_us = FOREVER_US
        return [
            e for e in effects if not isinstance(e, Send) or isinstance(e.message, EmergencyStop)
        ]

    return press


def _reset_starts(right: Any) -> Any:
    def manual_reset(self: StopController, now_us: int) -> bool:
        self.stops = StopSet()
        self._causes.clear()
        right(self, now_us)
        return True

    return manual_reset


def _forgets_latch(right: Any) -> Any:
    def recall(self: StopController, recalled: Any) -> None:
        self.held = False

    return recall


def _older_wins(right: Any) -> Any:
    def apply(self: FieldAllocationCRDT, section: int, key: int) -> bool:
        known = self._keys.get(section)
        if known is not None and key != known and (known >> 37 & 7) == (key >> 37 & 7) != 7:
            return False  # the first value stays, whatever the order
        return bool(right(self, section, key))

    return apply


def _last_wins(right: Any) -> Any:
    def apply(self: FieldAllocationCRDT, section: int, key: int) -> bool:
        known = self._keys.get(section)
        if known is not None and key < known:
            self._sums.changing(section, known)
            self._done -= (known >> 48) - (key >> 48)
            self._keys[section] = key
            self._changed()
            return True
        return bool(right(self, section, key))

    return apply


def _replaces(right: Any) -> Any:
    def apply(self: Progress, section: int, block: int, bits: int) -> bool:
        known = self.bits(section, block)
        if known & ~bits:
            self._sums.changing(section << 8 | block, known or None)
            self._blocks[section << 8 | block] = bits & self._allowed(section, block)
            return True
        return bool(right(self, section, block, bits))

    return apply


def _unsynced(right: Any) -> Any:
    def init(self: LogJournal, disk: Any, synced: bool = True, mark: int = 0) -> None:
        right(self, disk, False, mark)

    return init


def _regardless(right: Any) -> Any:
    def persist(self: PeerRunner, records: Any) -> bool:
        assert self.journal is not None
        with suppress(OSError):
            self.journal.write(records)
        return True

    return persist


def _early(right: Any) -> Any:
    def passed(self: FieldMission, view: Any) -> list[int]:
        self.lifted, self.lifted_to_m, self.worst_m = False, 0.0, 0.0
        return list(right(self, view))

    return passed


def _all_again(right: Any) -> Any:
    def stretches(self: FieldMission, section: Any, view: Any, *args: Any) -> Any:
        return right(self, section, view._replace(progress=Progress(self.section_units)), *args)

    return stretches


def _straight_on(right: Any) -> Any:
    def drive(self: HolonomicMotion, here: Any, wish: Any, neighbours: Any, now_us: int) -> Drive:
        return Drive(wish.vx_m_s, wish.vy_m_s, wish.turn_rad_s, wish.tool_on)

    return drive


def _never_expires_body(right: Any) -> Any:
    """The command stays in force for the whole run."""

    def drive(self: SimulatedBody, command: Drive, now_us: int) -> None:
        right(self, command, now_us)
        self.world.rows[self.index, EXPIRES_US] = float("inf")

    return drive


def _ten_times(right: Any) -> Any:
    def init(self: Membership, *args: Any) -> None:
        right(self, *args)
        self.silence_for_us *= 10

    return init


def _unnoticed(right: Any) -> Any:
    def tick(self: Membership, now_us: int) -> list[int]:
        self._oldest_sign_at_us = now_us
        return []

    return tick


def _open(right: Any) -> Any:
    return lambda self, wanted, now_us: wanted


def _permits_all(right: Any) -> Any:
    def hear(self: ShortcutButtons, source: int, name: Any, robot: bool, m: Any, t: int) -> None:
        if m.switch == Switch.PERMIT:
            self._buttons.clear()
        right(self, source, name, robot, m, t)

    return hear


def _deaf(right: Any) -> Any:
    return property(lambda self: False, lambda self, value: None)


def _goes_on_unheard(right: Any) -> Any:
    def unheard(self: SelfCheck, now_us: int) -> str:
        alone = len(self.membership.live) == 1
        return "" if alone or self._sent_at_us != NEVER_US else str(right(self, now_us))

    return unheard


def _keeps_address(right: Any) -> Any:
    def move(self: AddressClaim, now_us: int) -> list[Any]:
        return []

    return move


def _gives_up(right: Any) -> Any:
    def try_again(self: AddressClaim, now_us: int) -> None:
        self._next_at_us = None

    return try_again


def _no_progress_kept(right: Any) -> Any:
    def restore(self: DurableRecords, allocation: Any, progress: Any, vouchers: Any = None) -> Any:
        return right(self, allocation, Progress({}), vouchers)

    return restore


def _unsent(is_kept: Callable[[Message], bool]) -> Callable[[Any], Any]:
    def without(right: Any) -> Any:
        def step(self: Peer, *args: Any) -> Sequence[Effect]:
            return [e for e in right(self, *args) if not isinstance(e, Send) or is_kept(e.message)]

        return step

    return without


def _is_no_vote(message: Message) -> bool:
    return not isinstance(message, LeaderElectionVote)


def _is_no_bid(message: Message) -> bool:
    return not isinstance(message, TaskClaim) or message.phase is not Phase.CLAIMED


MUTANTS: dict[str, Mutant] = {
    "stop-without-brake": Mutant(
        "a heard stop does not brake", StopController, "receive_stop", _without_halt, "press"
    ),
    "gate-open": Mutant("the gate lets everything pass", StopController, "gate", _open, "stop"),
    "reset-clears-all": Mutant(
        "a reset clears what it does not name, here and unseen",
        StopController,
        "manual_reset",
        _reset_starts,
        "press",
    ),
    "no-echo-single-shot": Mutant(
        "a stop is sent once", StopController, "_press", _single_shot, "press"
    ),
    "silence-unnoticed": Mutant(
        "no member ever falls silent", Membership, "tick", _unnoticed, "claims"
    ),
    "silence-ten-times": Mutant(
        "silence is noticed after ten times the limit",
        Membership,
        "__init__",
        _ten_times,
        "claims",
    ),
    "silence-harmless": Mutant(
        "silence does not brake", StopController, "members", _constant(()), "claims"
    ),
    "alone-unheard": Mutant(
        "a robot whose frames do not leave, or that no robot hears, goes on",
        SelfCheck,
        "_unheard",
        _goes_on_unheard,
        "flood",
    ),
    "latch-forgotten": Mutant(
        "a restart forgets the latch and the hold",
        StopController,
        "_recall",
        _forgets_latch,
        "press",
    ),
    "hold-forgotten": Mutant(
        "a stop is not written down", StopSet, "serialize", _constant(b""), "press"
    ),
    "fsync-forgotten": Mutant(
        "the journal does not sync", LogJournal, "__init__", _unsynced, "claims"
    ),
    "rollback-unnoticed": Mutant(
        "a journal that was rolled back is believed", LogJournal, "_rolled_back", _deaf, "claims"
    ),
    "disk-error-ignored": Mutant(
        "what the disk did not store is sent", PeerRunner, "_persist", _regardless, "claims"
    ),
    "old-senses-believed": Mutant(
        "the age of an observation is not checked", Senses, "_old", _constant(""), "body"
    ),
    "frozen-place-believed": Mutant(
        "a place that does not change is not noticed", Senses, "_frozen", _constant(""), "body"
    ),
    "hung-fixes-believed": Mutant(
        "a place that falls back again and again is not noticed",
        PlaceProgress,
        "look",
        _constant(""),
        "fixes",
    ),
    "way-unseen-is-a-jump": Mutant(
        "what a robot drove while it sensed nothing counts as part of a jump",
        PlaceJumps,
        "_reach_from",
        _constant(NO_REACH),
        "stalls",
    ),
    "scans-not-missed": Mutant(
        "a scan that does not arrive is not noticed", RangeSensing, "_wrong", _constant(""), "rays"
    ),
    "implement-not-watched": Mutant(
        "an implement that does not rise is not noticed",
        ImplementCheck,
        "_period",
        _constant(()),
        "implement",
    ),
    "bar-over-things": Mutant(
        "the implement stays down beside people and things",
        BarGuard,
        "must_be_up",
        _constant(False),
        "traffic",
    ),
    "older-claim-wins": Mutant(
        "the register that came first stays", FieldAllocationCRDT, "apply", _older_wins, "split"
    ),
    "last-frame-wins": Mutant(
        "the register that came last stays", FieldAllocationCRDT, "apply", _last_wins, "split"
    ),
    "progress-replaced": Mutant(
        "progress is replaced, not joined", Progress, "apply", _replaces, "split"
    ),
    "lost-claims-kept": Mutant(
        "a lost claim is worked on", SectionClaims, "recheck", _constant([]), "split"
    ),
    "claims-uncontested": Mutant(
        "a claim is work at once", claims, "CONTENTION_US", _value(0), "claims"
    ),
    "claims-unsent": Mutant(
        "a robot starts sections without a claim", Peer, "step", _unsent(_is_no_bid), "claims"
    ),
    "votes-unsent": Mutant(
        "no robot votes for a leader", Peer, "step", _unsent(_is_no_vote), "claims"
    ),
    "never-asks": Mutant(
        "differences are not noticed", Divergence, "on_digest", _constant(False), "split"
    ),
    "never-answers": Mutant(
        "questions are not answered", Synchronizer, "_question", _constant(None), "split"
    ),
    "digest-constant": Mutant(
        "every digest is the same", Divergence, "outgoing_digest", _constant(7), "split"
    ),
    "progress-unannounced": Mutant(
        "progress is not announced", ProgressAnnouncements, "flush", _constant([]), "split"
    ),
    "progress-not-restored": Mutant(
        "progress is not read from the journal",
        DurableRecords,
        "restore",
        _no_progress_kept,
        "claims",
    ),
    "covered-too-soon": Mutant("units that were not worked count", FieldMission, "_passed", _early),
    "units-worked-again": Mutant(
        "units that others have worked are worked once more",
        FieldMission,
        "_stretches",
        _all_again,
        "crash",
    ),
    "avoidance-off": Mutant("no robot avoids another", HolonomicMotion, "drive", _straight_on),
    "commands-never-expire": Mutant(
        "the actuator keeps the last command", SimulatedBody, "drive", _never_expires_body, "crash"
    ),
    "address-kept": Mutant(
        "a lost address is kept without a claim", AddressClaim, "_move", _keeps_address, "claims"
    ),
    "permit-of-any": Mutant(
        "the permit of one shortcut button ends the stop of all",
        ShortcutButtons,
        "on_message",
        _permits_all,
        "devices",
    ),
    "used-stop-ignored": Mutant(
        "a stop whose name was cleared before is ignored",
        StopController,
        "_press_spent",
        _constant(()),
        "devices",
    ),
    "standard-stop-once": Mutant(
        "the standard stop is sent once", OwnButton, "outgoing", _constant(None), "devices"
    ),
    "other-makers-believed": Mutant(
        "every device is one of ours", Origins, "of", _constant(Origin.OURS), "strangers"
    ),
    "another-field-holds": Mutant(
        "a robot of another field holds the fleet after it is gone",
        conflicts,
        "GONE_US",
        _value(1 << 50),
        "strangers",
    ),
    "addresses-gone-for-good": Mutant(
        "a robot that found no address does not try again",
        AddressClaim,
        "_try_again",
        _gives_up,
        "strangers",
    ),
    "impossible-work-joined": Mutant(
        "any section, owner and epoch is joined", Admission, "admits", _constant(True), "strangers"
    ),
    "strangers-unasked": Mutant(
        "no robot asks which member has an address", MemberDiscovery, "answer_due", _deaf, "claims"
    ),
}


@contextmanager
def planted(name: str) -> Iterator[None]:
    """Apply the bug until the end of the block. KeyError for an unknown name."""
    mutant = MUTANTS[name]
    right = mutant.where.__dict__.get(mutant.name)
    with patch.object(mutant.where, mutant.name, mutant.change(right), create=right is None):
        yield
