"""Forged, replayed and held-back reset frames, at the safety of a robot that stands latched.

An attacker hears every frame, keeps those it likes, changes them and sends its own. The bench plays this
twice: as fast as a bus can carry frames, where the lock-out refuses most of them, and slowly enough that
every tag is checked. A tag is right by chance with odds of 2^-24, which may well happen in a million
frames. A reset needs two of them that agree, and only such a pair is counted as accepted.
"""

from collections import Counter
from collections.abc import Iterator
from random import Random

from agent.interface.effects import Persist
from agent.interface.identity import SilencePolicy
from agent.safety.stop_controller import StopController
from crdt.stops import StopDot, StopSet
from protocol.authentication import BAD_MAX, BAD_WINDOW_US, KEY_SIZE, SESSION_US, Keyring, Keys
from protocol.frames.safety_frames import EMERGENCY_RESET, Challenge, EmergencyReset, EmergencyStop
from tools.bench.figure import Figure

FRAMES, QUICK_FRAMES = 1_000_000, 20_000
BUS_SPACING_US = 640  # between frames of a saturated bus
SLOW_SPACING_US = BAD_WINDOW_US // (BAD_MAX - 1) + 1  # never enough bad tags for a lock-out
OPERATOR, PRESSER, ROBOT = 249, 1, 0
TAG_MAX = (1 << 24) - 1
KEPT = 512  # frames the attacker remembers
LUNCH = 0.02  # share of its turns after which the operator says nothing until its session is over
KINDS = ("guess", "replay", "change", "held back", "other kind", "other fleet")


class ForgeryAttack:
    """One latched robot, its operator, and an attacker between them."""

    def __init__(self, seed: int, spacing_us: int, operates_every: int) -> None:
        self.rng = rng = Random(f"{seed}/forgery/{spacing_us}")
        keys = Keys(rng.randbytes(KEY_SIZE), rng.randbytes(KEY_SIZE))
        foreign = Keys(rng.randbytes(KEY_SIZE), rng.randbytes(KEY_SIZE))
        self.spacing_us, self.operates_every, self.now_us = spacing_us, operates_every, 0
        self.keyring = Keyring(keys, ROBOT, rng.randbytes(KEY_SIZE))
        self.safety = StopController(ROBOT, 1, SilencePolicy.STOP, self.keyring, {}, 0)
        self.operator = Keyring(Keys(None, keys.operator), OPERATOR, b"")
        self.presser = Keyring(keys, PRESSER, b"")
        self.stranger = Keyring(foreign, OPERATOR, b"")
        self.heard: list[EmergencyReset] = []  # by the robot and the attacker
        # Counter and frame; the robot never got it.
        self.held: list[tuple[int, EmergencyReset]] = []
        self.stops: list[EmergencyStop] = []
        self.presses = self.legitimate = 0
        self.tried: Counter[str] = Counter()
        self.accepted: Counter[str] = Counter()
        self.right_by_chance = 0  # tags
        self.press()

    def press(self) -> None:
        """Another stop, whose dot nobody has cleared."""
        self.presses += 1
        dot = StopDot(PRESSER, self.presses >> 8 & 0xFF, self.presses & 0xFF)
        # One at a time: a long history is not the point.
        self.safety.stops, self.dot = (StopSet(), dot)
        self.safety.stops.press(dot)
        stop = self.presser.sign(EmergencyStop(*dot, 1))
        self.stops = [*self.stops[-KEPT:], stop]

    def run(self, frames: int) -> None:
        """Send so many forged frames, with the operator at work in between, and count what is
        accepted."""
        for number in range(frames):
            self.now_us += self.spacing_us
            if number % self.operates_every == 0:
                self.operate()
            kind = KINDS[self.rng.randrange(len(KINDS))]
            frame = self.attack(kind)
            before = self.keyring.accepted
            effects = self.safety.receive_reset(frame, self.now_us)
            self.tried[kind] += 1
            self.right_by_chance += self.keyring.accepted - before
            self.accepted[kind] += any(isinstance(effect, Persist) for effect in effects)

    def operate(self) -> None:
        """The operator resets; some of its frames reach the attacker and not the robot."""
        if self.rng.random() < LUNCH:
            self.now_us += SESSION_US + 1
            return
        for _ in range(4):  # the first may only cause a question, because two frames have to agree
            frame = self.operator.sign(EmergencyReset(*self.dot, OPERATOR))
            if self.rng.random() < 0.3:
                self.held = [*self.held[-KEPT:], (self.operator.sent, frame)]
                continue
            before, cleared = self.keyring.accepted, False
            for effect in self.safety.receive_reset(frame, self.now_us):
                cleared = cleared or isinstance(effect, Persist)
                question = getattr(effect, "message", None)
                if isinstance(question, Challenge):
                    proof = self.operator.answer(question, self.now_us)
                    if proof is not None:
                        self.safety.authority.prove(proof, self.now_us)
            if self.keyring.accepted > before:
                self.heard = [*self.heard[-KEPT:], frame]
            if cleared:
                self.legitimate += 1
                self.press()
                break

    def stale(self) -> EmergencyReset | None:
        """A frame that was held back, and then overtaken by a newer one or by the session's end."""
        proven_us = self.keyring._proven_at_us.get(OPERATOR, -SESSION_US)
        over = self.now_us - proven_us > SESSION_US
        newest = self.keyring.heard.get(OPERATOR, 0)
        old = [frame for counter, frame in self.held[-20:] if over or counter < newest]
        return self.rng.choice(old) if old else None

    def attack(self, kind: str) -> EmergencyReset:
        """A frame of one kind of attack: a guess, a replay, a change of a heard frame, or one held
        back."""
        rng = self.rng
        wanted = EmergencyReset(*self.dot, OPERATOR)
        guess = wanted._replace(freshness=rng.randrange(256), tag=rng.randint(0, TAG_MAX))
        if kind == "replay" and self.heard:
            return rng.choice(self.heard)
        if kind == "change" and self.heard:
            data = bytearray(EMERGENCY_RESET.pack(rng.choice(self.heard)))
            data[rng.randrange(8)] ^= 1 << rng.randrange(8)
            return EMERGENCY_RESET.unpack(bytes(data))
        if kind == "held back":
            return self.stale() or guess
        if kind == "other kind":
            stop = rng.choice(self.stops)
            return wanted._replace(freshness=stop.freshness, tag=stop.tag)
        if kind == "other fleet":
            return self.stranger.sign(wanted)
        return guess


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Forged resets that were accepted, at the speed of the bus and slowly."""
    frames = QUICK_FRAMES if quick else FRAMES
    for name, spacing_us, operates_every in (
        ("at bus speed", BUS_SPACING_US, 50), ("every tag looked at", SLOW_SPACING_US, 3),
    ):  # fmt: skip
        siege = ForgeryAttack(seed, spacing_us, operates_every)
        siege.run(frames)
        accepted, ring = sum(siege.accepted.values()), siege.keyring
        scope = (
            f"{', '.join(f'{n} {kind}' for kind, n in siege.tried.items())}; beside them "
            f"{siege.legitimate} of the operator's taken; {siege.right_by_chance} tags right by "
            f"chance, which released nobody; refused: {ring.bad} bad tags, "
            f"{ring.stale} stale, {ring.unproven} without proof, {ring.ignored} locked out"
        )
        yield Figure(
            f"forged, replayed or stale resets accepted, {frames} {name}", accepted, "frames", "0",
            accepted == 0, "odds of two tags that agree: 2^-48", scope,
        )  # fmt: skip
