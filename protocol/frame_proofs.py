"""Proofs: one truncated AES-CMAC authenticates a batch of frames of one sender.

A frame of 8 bytes has no room for a tag, so a PROOF frame follows up to `BATCH_MAX` frames. Its tag
covers the sender, its bus address, the fleet's time, and the different frames in order of their
group and data, because controllers reorder by priority. A frame that is lost spoils its batch;
anti-entropy repairs that as it repairs a lost frame.

**Freshness.** All robots share a *fleet time* in ticks. It starts at a random value of 55 bits when a
fleet is switched on, so no recording of an earlier day falls into its window. It only goes forward:
each robot takes the greatest time that was proven to it. A device that boots asks for it with a nonce.
Each sender uses a tick once, and a receiver accepts each once, `BACK` ticks late at most.
New keys begin a new time, which is drawn from them: so what a thief has made of the time ends with its
revocation, and no robot has to tell the others where the new time begins.

**Keys.** Each sender has its own key, derived from the fleet's master secret, or from the operator's
secret for operator devices. Each robot can derive all of them, because it must verify. So a stolen
robot can sign as others until the keys are rotated (`docs/how/trust.md`).

The tag has 40 bits, and at most `TRIES_MAX` sets of frames are tried against one proof.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import combinations
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from protocol.authentication import KEY_SIZE, OPERATOR_FIRST, Keys
from protocol.ciphers import derived_key, mac_of
from protocol.frames.messages import GROUP_OF
from protocol.frames.trust_frames import (
    COUNT_BITS,
    MOMENT_BITS,
    PROOF_TAG_BITS,
    WORD_BITS,
    FleetTimeTold,
    OperatorBadge,
    Proof,
    TimeQuestion,
)
from protocol.operator_badges import Badge, BadgeBook
from protocol.units import MS, S

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.cmac import CMAC

TICK_US: Final = 8 * MS  # a burst of sync has a proof every 17 ms
BATCH_MAX: Final = 8  # frames under one proof; they take 17 ms of the share that sync may use
assert BATCH_MAX < 1 << COUNT_BITS
# A proof is accepted this late and this early. A bus that is full delays it by less; a proof that an
# attacker holds back proves life no longer than this.
BACK: Final = 1 * S // TICK_US
AHEAD: Final = 1 * S // TICK_US
assert BACK + AHEAD < 1 << MOMENT_BITS
TRIES_MAX: Final = 8  # sets of frames that are tried: foreign frames may be among those held
HELD_MAX: Final = 32  # unproven frames of one address: four batches
HELD_FOR_US: Final = 1_500 * MS  # longer than the longest pause between two proofs of a robot
WAITING_MAX: Final = 2  # proofs of one address that wait for frames that are still in a queue
WAITS_FOR_US: Final = 250 * MS
TOOL_TIME_US: Final = 5 * S  # a device that hears no proofs asks again after this
START_BITS: Final = WORD_BITS - 1  # bits of the random start of the fleet's time
# The fleet's time starts above FIRST, so that it stays positive where a clock goes back, by centuries
# if need be. An answer can move a known time to JUMP_LAST, and teach one that is unknown up to
# TOLD_LAST. A thief can answer as it likes, and each of its proofs moves the time by `AHEAD` at most.
# So the time comes from JUMP_LAST to TOLD_LAST, and from there to the last one that a FLEET_TIME frame
# can tell, in 2.2 million years, or by 7 * 10^13 proofs: 1,100 years of a bus that is full of them.
FIRST: Final = 1 << 40
_QUARTER: Final = 1 << START_BITS - 2
JUMP_LAST: Final = 5 * _QUARTER
TOLD_LAST: Final = 6 * _QUARTER
assert FIRST + (1 << START_BITS) < JUMP_LAST < TOLD_LAST < (1 << WORD_BITS) - _QUARTER

Words = tuple[bytes, ...]  # groups and data of frames, each once, in order
# Cached tags: 50 kB. Peers in one process check one proof within milliseconds. A robot alone checks each
# proof once: its cache is full in seconds, and one of 4096 filled for hours, up to 1.6 MB.
SUMS_MAX = 1 << 7


@lru_cache(maxsize=1024)
def _key(secret: bytes, info: bytes) -> bytes:
    return derived_key(secret, info, KEY_SIZE)


@lru_cache(maxsize=1024)
def _running(key: bytes) -> "CMAC":
    return mac_of(key)


@lru_cache(maxsize=SUMS_MAX)
def _sum(key: bytes, content: bytes) -> bytes:
    """The CMAC of the content under a key, 16 bytes."""
    mac = _running(key).copy()
    mac.update(content)
    return mac.finalize()


def word_of(message: Any) -> bytes:
    """What a tag covers of one frame: its group, 3 bytes, and its data."""
    layout = GROUP_OF[type(message)]
    return layout.pgn.to_bytes(3, "little") + layout.pack(message)


class ProofKeys:
    """The keys of all senders under the secrets that this device holds."""

    BACKBONE_TAG: Final = 8  # bytes of a tag of the backbone, where there is room

    def __init__(self, keys: Keys, badges: BadgeBook | None = None) -> None:
        """`badges`: those that a robot has heard; None in a device, which holds its own secret."""
        self.keys, self.badges = keys, badges

    def rekey(self, keys: Keys) -> None:
        """Other secrets from now on."""
        self.keys = keys

    def of(self, sender: int) -> bytes | None:
        """The key of a sender for proofs; None if its secret is not held here."""
        secret = self._secret(sender)
        return None if secret is None else _key(secret, b"headland proof" + bytes((sender,)))

    def _secret(self, sender: int) -> bytes | None:
        operators = self.keys.operator
        if sender < OPERATOR_FIRST:
            return self.keys.master
        if operators is None or self.badges is None:
            return operators
        return self.badges.of(sender).secret(operators)

    def of_time(self, asker: int) -> bytes | None:
        """The key for telling the fleet's time. `asker`: the slot of a robot, or an operator device."""
        secret = self._secret(asker)
        return None if secret is None else _key(secret, b"headland fleet time")

    def tag(self, sender: int, address: int, ticks: int, words: Words) -> int | None:
        """The tag of a proof, `PROOF_TAG_BITS`; None if the sender's secret is not held here."""
        key = self.of(sender)
        if key is None:
            return None
        head = b"P" + bytes((sender, address, len(words))) + ticks.to_bytes(8, "little")
        content = head + b"".join(words)
        return int.from_bytes(_sum(key, content)[: PROOF_TAG_BITS // 8], "little")

    def time_tag(self, question: TimeQuestion, ticks: int) -> int | None:
        """The tag of a fleet time for one question, `WORD_BITS`; None if the secret is not held."""
        key = self.of_time(question.asker)
        if key is None:
            return None
        word = WORD_BITS // 8
        content = (
            b"T" + bytes((question.asker,)) + question.nonce.to_bytes(word, "little")
            + ticks.to_bytes(word, "little")
        )  # fmt: skip
        return int.from_bytes(_sum(key, content)[:word], "little")

    def backbone_tag(self, message: bytes) -> bytes:
        """The tag of one message between gateways, `BACKBONE_TAG` bytes."""
        secret = self.keys.master
        assert secret is not None, "a gateway with keys holds the fleet's secret"
        mac = _running(_key(secret, b"headland backbone")).copy()
        mac.update(message)
        return mac.finalize()[: self.BACKBONE_TAG]

    def number(self, purpose: bytes, lot: bytes, bits: int) -> int:
        """A number that nobody else can foresee, from a value that no two boots share."""
        secret = self.keys.master or self.keys.operator
        assert secret is not None
        drawn = _sum(_key(secret, b"headland number"), purpose + lot)
        return int.from_bytes(drawn[:8], "little") & (1 << bits) - 1


class FleetTime:
    """The fleet's time as one device knows it. With the same keys it never goes back."""

    def __init__(self, start: int, now_us: int) -> None:
        """`start`: used if no robot knows the time; from `FIRST`, and `START_BITS` more at most."""
        self._offset = start - now_us // TICK_US
        self.known = False
        self.refused = 0  # answers that no honest robot gives

    def begin(self, keys: "ProofKeys", now_us: int) -> None:
        """The fleet has these keys from now on: its time starts at what is drawn from them. A device
        that knew no time asks for it, because the others may have switched long before."""
        start = FIRST + keys.number(b"new keys", b"", START_BITS)
        self._offset = start - now_us // TICK_US

    def at(self, now_us: int) -> int:
        """The ticks at this time of our own clock."""
        return self._offset + now_us // TICK_US

    def possible(self, ticks: int) -> bool:
        """Whether an honest robot may tell this time to a device that knows what we know."""
        return FIRST <= ticks <= (JUMP_LAST if self.known else TOLD_LAST)

    def learn(self, ticks: int, now_us: int) -> bool:
        """Take over a proven time if it is later than ours, or if we know none; whether it moved by
        more than proofs may be early. An impossible one is counted, and changes nothing."""
        moved = ticks - self.at(now_us)
        if self.known and moved <= 0:
            return False
        jumps = not self.known or moved > AHEAD
        if jumps and not self.possible(ticks):
            self.refused += 1
            return False
        self._offset += moved
        self.known = True
        return jumps

    def begins_again(self, ticks: int, now_us: int) -> bool:
        """Whether the fleet was switched off and began another time; then used ticks are forgotten.

        Only for an answer to a question of just now, and for a device that tells no time."""
        if not self.known or ticks >= self.at(now_us) - BACK or not self.possible(ticks):
            return False
        self.known = False
        return True

    def nearest(self, moment: int, now_us: int) -> int:
        """The ticks nearest to now. `moment`: their low bits, as a proof carries them."""
        now, period = self.at(now_us), 1 << MOMENT_BITS
        ahead = (moment - now + period // 2) % period - period // 2
        return now + ahead


class ProofBatch:
    """The frames that a device has sent and not proven yet."""

    def __init__(self, sender: int, keys: ProofKeys, time: FleetTime) -> None:
        self.sender, self.keys, self.time = sender, keys, time
        self.due_at_us: int | None = None  # when the proof is due; None: nothing waits
        self.full = False
        self._words: dict[bytes, None] = {}
        self._last = 0  # ticks of our last proof

    def add(self, message: Any, due_at_us: int) -> None:
        """A frame was sent; its proof is due at this time at the latest."""
        self._words[word_of(message)] = None
        self.full = len(self._words) >= BATCH_MAX
        if self.due_at_us is None or due_at_us < self.due_at_us:
            self.due_at_us = due_at_us

    def clear(self) -> None:
        """The frames are not proven: our address has changed, or no time is known."""
        self._words.clear()
        self.due_at_us, self.full = None, False

    def rekey(self) -> None:
        """The fleet has other keys, and with them another time."""
        self.clear()
        self._last = 0

    def seal(self, address: int, now_us: int) -> Proof | None:
        """The proof of all frames so far, also of none; None while the fleet's time is unknown."""
        words = tuple(sorted(self._words))
        self.clear()
        if not self.time.known:
            return None
        ticks = self._last = max(self.time.at(now_us), self._last + 1)
        tag = self.keys.tag(self.sender, address, ticks, words)
        assert tag is not None, "a device holds its own secret"
        return Proof(self.sender, len(words), ticks & (1 << MOMENT_BITS) - 1, tag)


class Replay:
    """Which ticks of one sender were used: the newest, and a window below it."""

    __slots__ = ("newest", "used")

    def __init__(self) -> None:
        self.newest, self.used = -1, 0  # bit i of `used`: newest - i

    def fresh(self, ticks: int) -> bool:
        """Whether this tick was not used before and is in the window."""
        behind = self.newest - ticks
        return behind < 0 or (behind <= BACK and not self.used >> behind & 1)

    def use(self, ticks: int) -> None:
        """Mark a tick as used."""
        ahead = ticks - self.newest
        if ahead > 0:
            self.used = (self.used << ahead | 1) & (1 << BACK + 1) - 1 if ahead <= BACK else 1
            self.newest = ticks
        else:
            self.used |= 1 << -ahead


class HeldFrame(NamedTuple):
    """A frame that waits for its proof."""

    word: bytes
    message: Any
    at_us: int


class _Address:
    """What waits under one bus address."""

    __slots__ = ("frames", "proofs")

    def __init__(self) -> None:
        self.frames: dict[bytes, HeldFrame] = {}  # in order of arrival
        self.proofs: list[tuple[Proof, int]] = []


class Proven(NamedTuple):
    """A proof that was verified: its sender, and the messages that it covers, in their order."""

    sender: int
    messages: tuple[Any, ...]


class ProofChecker:
    """Holds the unproven frames of all addresses, and verifies proofs."""

    def __init__(self, keys: ProofKeys, time: FleetTime) -> None:
        self.keys, self.time = keys, time
        self.accepted = self.bad = self.stale = self.dropped = 0
        self._at: dict[int, _Address] = {}
        self._replay: dict[int, Replay] = {}

    def held(self, address: int) -> Sequence[Any]:
        """The messages of this address that wait."""
        at = self._at.get(address)
        return [] if at is None else [frame.message for frame in at.frames.values()]

    @property
    def holding(self) -> int:
        """Frames that wait, of all addresses."""
        return sum(len(at.frames) for at in self._at.values())

    def hold(self, address: int, message: Any, now_us: int) -> list[Proven]:
        """Keep a frame until its proof arrives; what a proof that waited for it now covers."""
        at = self._at.setdefault(address, _Address())
        self._expire(at, now_us)
        word = word_of(message)
        at.frames.pop(word, None)
        at.frames[word] = HeldFrame(word, message, now_us)
        if len(at.frames) > HELD_MAX:
            del at.frames[next(iter(at.frames))]
            self.dropped += 1
        proven = []
        for entry in list(at.proofs):
            found = self._match(address, at, entry[0], now_us)
            if found is not None:
                at.proofs.remove(entry)
                proven.append(found)
        return proven

    def verify(self, address: int, proof: Proof, now_us: int) -> Proven | None:
        """What a proof covers; None if it is not valid, or its frames have not arrived yet."""
        at = self._at.setdefault(address, _Address())
        self._expire(at, now_us)
        found = self._match(address, at, proof, now_us)
        if found is None:
            at.proofs.append((proof, now_us))
            if len(at.proofs) > WAITING_MAX:
                del at.proofs[0]
                self.bad += 1
        return found

    def forget(self, address: int) -> None:
        """Another device has the address: what waits is void."""
        at = self._at.pop(address, None)
        if at is not None:
            self.dropped += len(at.frames)

    def rekey(self, keys: Keys) -> None:
        """The fleet has other keys, and with them another time: what waits is void."""
        for address in list(self._at):
            self.forget(address)
        self._replay.clear()
        self.keys.rekey(keys)

    def _match(self, address: int, at: _Address, proof: Proof, now_us: int) -> Proven | None:
        if not self.time.known:
            return None
        ticks, now = self.time.nearest(proof.moment, now_us), self.time.at(now_us)
        replay = self._replay.get(proof.sender)
        if not now - BACK <= ticks <= now + AHEAD or (replay and not replay.fresh(ticks)):
            self.stale += 1
            return None
        for frames in _choices(at.frames, proof.covered):
            words = tuple(sorted(frame.word for frame in frames))
            if self.keys.tag(proof.sender, address, ticks, words) == proof.tag:
                break
        else:
            return None
        self._replay.setdefault(proof.sender, Replay()).use(ticks)
        self.time.learn(ticks, now_us)
        self.accepted += 1
        for frame in frames:
            del at.frames[frame.word]
        return Proven(proof.sender, tuple(frame.message for frame in frames))

    def _expire(self, at: _Address, now_us: int) -> None:
        frames = at.frames
        while frames:
            oldest = next(iter(frames.values()))
            if now_us - oldest.at_us <= HELD_FOR_US:
                break
            del frames[oldest.word]
            self.dropped += 1
        if at.proofs:
            kept = [entry for entry in at.proofs if now_us - entry[1] <= WAITS_FOR_US]
            self.bad += len(at.proofs) - len(kept)
            at.proofs = kept


def _choices(frames: dict[bytes, HeldFrame], count: int) -> Iterator[Sequence[HeldFrame]]:
    """Sets of so many held frames that a proof may cover, the likeliest first.

    Frames that somebody else sent under the address may be among those held, or frames of a batch
    that is spoilt."""
    held = list(frames.values())
    if len(held) < count:
        return
    yield held[len(held) - count :]
    if len(held) == count:
        return
    if count:
        yield held[:count]
    if len(held) <= count + 2:
        for tries, chosen in enumerate(combinations(held, count)):
            if tries >= TRIES_MAX - 2:
                return
            yield chosen


class TimeAnswers:
    """The answers to our own question for the fleet's time, and to those of others."""

    def __init__(self, keys: ProofKeys) -> None:
        self.keys = keys
        self._ticks: dict[int, int] = {}  # source -> the first half of its answer

    def halves(self, question: TimeQuestion, ticks: int) -> tuple[FleetTimeTold, FleetTimeTold]:
        """The two frames of an answer."""
        tag = self.keys.time_tag(question, ticks)
        assert tag is not None, "only a device with the secret answers"
        return FleetTimeTold(0, ticks), FleetTimeTold(1, tag)

    def hear(self, source: int, told: FleetTimeTold, question: TimeQuestion | None) -> int | None:
        """The ticks, if this is the second half of a valid answer to the question."""
        if told.part == 0:
            self._ticks[source] = told.value
            return None
        ticks = self._ticks.get(source)
        if ticks is None or question is None:
            return None
        return ticks if self.keys.time_tag(question, ticks) == told.value else None


class ToolProofs:
    """The proofs of an operator's device, which asks the robots for the fleet's time."""

    def __init__(self, keys: Keys, device: int, lot: bytes, badge: Badge | None = None) -> None:
        """`device`: under whose key it signs, from `OPERATOR_FIRST`. `lot`: different at each start.
        `badge`: of a restricted key."""
        self.device, self._lot, self._badge = device, lot, badge
        self._keys = ProofKeys(keys)
        self._time = FleetTime(0, 0)
        self._batch = ProofBatch(device, self._keys, self._time)
        self._answers = TimeAnswers(self._keys)
        self._question: TimeQuestion | None = None
        self._asked, self._asked_at_us = 0, -TOOL_TIME_US
        self._learned_at_us = -TOOL_TIME_US

    def renew(self, keys: Keys, badge: Badge | None) -> None:
        """The device has another secret or badge. Robots with new keys have another time."""
        self._keys.rekey(keys)
        self._badge = badge
        self._batch.rekey()
        self._time.known = False
        self._learned_at_us = -TOOL_TIME_US

    def hear(self, source: int, message: Any, now_us: int) -> None:
        """Take in a message of the bus: answers to our question matter."""
        if isinstance(message, FleetTimeTold):
            ticks = self._answers.hear(source, message, self._question)
            if ticks is not None:
                if now_us - self._asked_at_us <= S and self._time.begins_again(ticks, now_us):
                    self._batch.rekey()
                self._time.learn(ticks, now_us)
                if self._time.known:
                    self._learned_at_us = now_us

    def after(
        self, message: Any, address: int, now_us: int
    ) -> list[OperatorBadge | Proof | TimeQuestion]:
        """What follows a frame that was sent from this address: its proof, and a question for the time
        if ours is not known or old. Without a time there is no proof; the caller repeats its frame."""
        # Also the owner's, because somebody may have told another one in its name.
        badge = Badge(self.device) if self._badge is None else self._badge
        said: list[OperatorBadge | Proof | TimeQuestion] = [badge.told()]
        self._batch.add(message, now_us)
        proof = self._batch.seal(address, now_us)
        if proof is not None:
            said.append(proof)
        if now_us - self._learned_at_us >= TOOL_TIME_US:
            self._asked_at_us = now_us
            said.append(self._ask())
        return said

    def _ask(self) -> TimeQuestion:
        self._asked += 1
        lot = self._lot + self._asked.to_bytes(8, "little")
        self._question = TimeQuestion(self.device, self._keys.number(b"nonce", lot, WORD_BITS))
        return self._question
