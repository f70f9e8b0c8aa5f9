"""Forged, replayed, changed, reordered and truncated frames of every kind against a fleet with keys.

The attacker is on the bus and holds no key. It hears every frame, and keeps those it likes. Beside it
the fleet works: claims and progress go on being made. The judge knows what honest robots have claimed
and covered, because it told them to, and compares it with the replica of every robot after each
`CHECK_EVERY` frames. After each frame it compares states and drives. A forged frame may brake: a drive
may become slower, and an address that is stolen takes its robot off the bus for a moment.
"""

from collections import Counter
from collections.abc import Iterator
from random import Random

from agent.interface.config import S
from agent.interface.lifecycle import State
from crdt.claim_register import Phase, owner_of, phase_of
from protocol.frames.codec import decode
from protocol.frames.fleet_frames import Heartbeat, Member, Pose
from protocol.frames.frame import Frame
from protocol.frames.messages import GROUP_OF, GROUPS
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import AllImplementsStop, EmergencyStop
from protocol.frames.segment_frames import FleetStop
from protocol.frames.trust_frames import Proof
from sim.rigs.keyed_rig import SECTIONS, UNITS, KeyedRig
from tools.bench.figure import Figure

FRAMES, QUICK_FRAMES = 10_000_000, 6_000
TRIAL_FRAMES = 100_000  # of one fleet, which works during the first third
CHECK_EVERY = 500
TIMERS_EVERY = 4  # frames between two looks at what is due: robots are late by 2 ms at most
WORK_EVERY = 4_000  # frames between two sections that honest robots work
CLAIM_SHARE = 0.001  # address claims of everybody else: more would only keep robots off the bus
KINDS = ("forged", "replayed", "changed", "reordered", "truncated", "guessed proof")
# A robot whose address was stolen joins again, and compares replicas before it goes on.
ALLOWED = frozenset((State.IDLE, State.DISCONNECTED, State.SYNCHRONIZING))
FULL_M_S = 2.0  # what the mission of the rig wants
PRIORITY = 6
_CLAIM = GROUP_OF[AddressClaimed].pgn
# What brakes by design. In every second trial the attacker leaves it out, so that robots drive and the
# judge of motions has something to see.
BRAKES = (EmergencyStop, AllImplementsStop, FleetStop, Pose, Heartbeat, AddressClaimed)


class ForgeryTrial:
    """A keyed fleet at work, the attacker, and the judge."""

    def __init__(self, seed: int) -> None:
        self.seed, self.rng = seed, Random(f"{seed}/forged frames")
        self.quiet = seed % 2 == 1
        self.rig = KeyedRig(seed)
        self.tried: Counter[str] = Counter()
        self.broken: list[str] = []
        self.braked = 0  # frames after which some robot stood that drove before
        self.driven = 0  # frames at which some robot drove
        self.worked: dict[int, int] = {}  # section -> slot that honestly claimed it
        self._pile: list[Frame] = []  # frames to send in another order
        self._units: dict[int, int] = {}

    def run(self, frames: int) -> None:
        """Send so many frames of the attacker, and judge."""
        for number in range(frames):
            if number % WORK_EVERY == 0:
                self._work()
            kind, frame = self._next()
            self.tried[kind] += 1
            self.driven += any(drive.vx_m_s > 0 for drive in self.rig.drives.values())
            drove = {slot for slot, drive in self.rig.drives.items() if drive.vx_m_s > 0}
            send = self.rig.inject if number % TIMERS_EVERY == 0 else self.rig.inject_late
            send(frame)
            self._judge_motion(drove, kind, number)
            if number % CHECK_EVERY == 0:
                self._judge_replicas(number)
            if len(self.broken) > 10:
                return
        self.rig.run_for(10 * S)
        self._judge_replicas(frames)

    # ---------------------------------------------------------------- the honest fleet

    def _work(self) -> None:
        """A robot that is on the bus claims the next section and covers units of it."""
        section = len(self.worked)
        able = [slot for slot, peer in self.rig.peers.items() if peer.address is not None]
        if section >= SECTIONS or not able:
            return
        slot = self.rng.choice(able)
        self.worked[section] = slot
        self._units[section] = UNITS // 2
        self.rig.work(slot, section, UNITS // 2)

    # ---------------------------------------------------------------- the attacker

    def _address(self) -> int:
        rng = self.rng
        addresses = [p.address for p in self.rig.peers.values() if p.address is not None]
        if addresses and rng.random() < 0.7:
            return rng.choice(addresses)
        return rng.randrange(256)

    def _next(self) -> tuple[str, Frame]:
        while True:
            kind = KINDS[self.rng.randrange(len(KINDS))]
            frame = self._frame(kind)
            if not self.quiet or not isinstance(decode(frame)[1], BRAKES):
                return kind, frame

    def _frame(self, kind: str) -> Frame:
        rng, recorded = self.rng, self.rig.recorded
        if kind == "forged":
            layout = GROUPS[rng.randrange(len(GROUPS))]
            if layout.pgn == _CLAIM and rng.random() > CLAIM_SHARE * len(GROUPS):
                layout = GROUP_OF[Member]
            return self._of(layout.pgn, layout.priority, self._data(layout.length))
        if kind == "guessed proof":
            tag = rng.randbytes(8)
            return self._of(GROUP_OF[Proof].pgn, PRIORITY, bytes((rng.randrange(3),)) + tag[1:])
        if kind == "reordered":
            if not self._pile:
                self._pile = [recorded[-1 - k] for k in range(min(12, len(recorded)))]
                rng.shuffle(self._pile)
            return self._pile.pop()
        frame = recorded[rng.randrange(len(recorded))]
        if kind == "replayed":
            newest = recorded[-1 - rng.randrange(min(40, len(recorded)))]
            return rng.choice((frame, newest))
        if kind == "truncated":
            return Frame(frame.identifier, frame.data[: rng.randrange(8)])
        data = bytearray(frame.data)
        if data and type(decode(frame)[1]) is not AddressClaimed:
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        return Frame(frame.identifier, bytes(data))

    def _data(self, length: int) -> bytes:
        """Small numbers more often than chance has them, so that sections and slots exist."""
        rng = self.rng
        if rng.random() < 0.5:
            return rng.randbytes(length)
        return bytes(
            rng.choice((0, 1, 2, rng.randrange(9), rng.randrange(256))) for _ in range(length)
        )

    def _of(self, pgn: int, priority: int, data: bytes) -> Frame:
        addressed = pgn >> 8 & 0xFF < 240
        low = self._address() << 8 if addressed else 0
        return Frame(priority << 26 | pgn << 8 | low | self._address(), data)

    # ---------------------------------------------------------------- the judge

    def _judge_motion(self, drove: set[int], kind: str, number: int) -> None:
        for slot, peer in self.rig.peers.items():
            drive = self.rig.drives[slot]
            if not (0 <= drive.vx_m_s <= FULL_M_S and drive.vy_m_s == 0 and not drive.turn_rad_s):
                self.broken.append(f"frame {number}, {kind}: robot {slot} drives {drive}")
            works = peer.state is State.WORKING and slot in self.worked.values()
            if peer.state not in ALLOWED and not works:
                self.broken.append(f"frame {number}, {kind}: robot {slot} is {peer.state.name}")
            self.braked += slot in drove and drive.vx_m_s == 0

    def _judge_replicas(self, number: int) -> None:
        """Each register and each unit was claimed and covered by the robot that was told to."""
        for slot, peer in self.rig.peers.items():
            for section, key in peer.allocation.entries().items():
                if self.worked.get(section) != owner_of(key) or phase_of(key) == Phase.DONE:
                    self.broken.append(f"by frame {number}: robot {slot} has {section}: {key:#x}")
            for section in range(SECTIONS):
                if peer.progress.covered(section) > self._units.get(section, 0):
                    self.broken.append(f"by frame {number}: robot {slot} has units of {section}")


def trial(frames: int, seed: int = 1) -> ForgeryTrial:
    """Play one trial with so many frames of the attacker."""
    played = ForgeryTrial(seed)
    played.run(frames)
    return played


def figures(quick: bool, seed: int = 1, frames: int | None = None) -> Iterator[Figure]:
    """Frames of an outsider that changed a replica, a state or a motion, except to brake.

    A trial has `TRIAL_FRAMES` at most, and a seed of its own."""
    count = frames or (QUICK_FRAMES if quick else FRAMES)
    tried, taken = Counter[str](), Counter[str]()
    broken: list[str] = []
    braked = driven = trials = 0
    while (left := count - trials * TRIAL_FRAMES) > 0:
        played = trial(min(left, TRIAL_FRAMES), seed + trials)
        trials += 1
        tried += played.tried
        braked += played.braked
        driven += played.driven
        broken += [f"seed {played.seed}, {what}" for what in played.broken]
        for peer in played.rig.peers.values():
            checker = peer.proven.checker
            assert checker is not None, "the rig has keys"
            taken["honest proofs taken"] += checker.accepted
            taken["refused"] += checker.bad
            taken["stale"] += checker.stale
            taken["frames dropped"] += checker.dropped
    scope = (
        f"{trials} trials: {_listed(tried)}; {braked} times a robot braked, a robot drove at "
        f"{driven} of them; of three robots: "
        f"{_listed(taken)}" + "".join(f"; {what}" for what in broken[:3])
    )
    yield Figure(
        f"frames of an outsider that changed a replica, a state or a motion, of {count}",
        len(broken), "frames", "0", not broken, "odds of one tag: 2^-40", scope,
    )  # fmt: skip


def _listed(counts: Counter[str]) -> str:
    return ", ".join(f"{number} {what}" for what, number in sorted(counts.items()))
