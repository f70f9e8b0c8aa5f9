"""Learns the fleet's time, which proofs are checked against, and tells it to robots that ask.

A robot asks with a nonce when it has joined. If nobody answers, no robot of the fleet is on the bus,
and it starts the time itself; lower slots do so earlier, and the others learn it from them. Robots
whose times differ, after both halves of a cut bus were switched on apart, cannot verify each other:
they ask, and all take the greater time.

Robots answer one after the other, and those that receive a valid answer keep silent.
"""

from collections.abc import Mapping
from heapq import nsmallest
from typing import Any, Final

from agent.interface.config import MS, PEERS_MAX, S
from agent.interface.effects import Send, Trace
from agent.interface.instants import FOREVER_US
from agent.peer import notices
from agent.peer.part import (
    NOTHING,
    Handler,
    Header,
    Listener,
    Outputs,
    Part,
    StepContext,
)
from protocol.frame_proofs import BACK, FleetTime, ProofKeys, TimeAnswers
from protocol.frames.trust_frames import TAG, WORD_BITS, FleetTimeTold, TimeQuestion

ASK_AGAIN_US: Final = 150 * MS  # or so long for each robot of the fleet, if that is more:
ASK_SHARE_US: Final = 5 * MS  # 200 questions a second of a fleet that is switched on
# Nobody answered: ask a last time, then start the time. Between two slots is time for that.
ALONE_US: Final = 600 * MS
LAST_WAIT_US: Final = 25 * MS
# Robots that are switched on together join within 153 ms of each other (ISO 11783-5) and ask again
# after 150 ms. So the first slot starts the time, and all others learn it. The last of a large fleet
# wait not much longer than the twelfth.
ALONE_STEP_US: Final = 200 * MS
ALONE_STEPS: Final = 12
LATE_STEP_US: Final = 30 * MS
assert ALONE_STEP_US > LATE_STEP_US > LAST_WAIT_US
NONCE_LIFE_US: Final = 1 * S
DOUBT_US: Final = 500 * MS  # between questions because of a doubt; doubles
DOUBLINGS_MAX: Final = 5  # up to 16 s, so that forged proofs cost next to nothing
ANSWER_US, ANSWER_STEP_US = 2 * MS, 5 * MS  # two frames, and one that blocks them
ANSWER_SPACING_US: Final = 8 * MS  # the largest fleet learns the time in a second
assert ANSWER_US + PEERS_MAX * ANSWER_STEP_US < ALONE_US, "the last slot answers in time"
ANSWERERS: Final = 6  # members that answer, the lowest slots first
QUESTIONS_MAX: Final = (
    128  # that wait: one of each robot and tool, as when a whole fleet is switched on
)
# Questions that one answer is compared with, which costs a tag each. The lowest slots are answered first.
COMPARED_MAX: Final = 8
COMPARED_FOR_US: Final = 1 * S
# Answers compared with questions of others in that time. Robots that answer in turn give half as many.
COMPARED_ANSWERS_MAX: Final = 2 * (COMPARED_FOR_US // ANSWER_SPACING_US)


class FleetClock(Part):
    """The part that asks for the fleet's time, and answers. Without keys it does nothing."""

    def __init__(
        self, slot: int, keys: ProofKeys | None, time: FleetTime, lot: bytes, members: int
    ) -> None:
        self.ask_again_for_us = max(ASK_AGAIN_US, members * ASK_SHARE_US)
        self.slot, self.keys, self.time, self.lot = slot, keys, time, lot
        self.answers = None if keys is None else TimeAnswers(keys)
        self.asks_at_us = self.alone_at_us = FOREVER_US
        self._question: TimeQuestion | None = None
        self._asked = 0
        self._asked_at_us = self._answered_at_us = -NONCE_LIFE_US
        self._doubts = 0
        self._turn_for_us = ANSWER_US  # we leave the answer to lower slots for so long
        self._last = False  # our last question before we start the time is asked
        self._pending: dict[TimeQuestion, int] = {}  # question of another device -> when we answer
        self._compared, self._compared_from_at_us = 0, -COMPARED_FOR_US

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {TimeQuestion: self._hear_question, FleetTimeTold: self._hear_time}

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {
            notices.AddressGained: self._joined,
            notices.KeysChanged: self._keys_changed,
            notices.TimeDoubted: self._doubted,
        }

    @property
    def due_at_us(self) -> int:
        due_at_us = min(self.asks_at_us, self.alone_at_us)
        if not self._pending:
            return due_at_us
        answer_at_us = max(min(self._pending.values()), self._answered_at_us + ANSWER_SPACING_US)
        return min(due_at_us, answer_at_us)

    def on_timer(self, ctx: StepContext) -> Outputs:
        now_us = ctx.now_us
        if self.keys is None or now_us < self.due_at_us:
            return NOTHING
        outputs: list[Any] = []
        if now_us >= self.alone_at_us:
            if self._last:
                self.asks_at_us = self.alone_at_us = FOREVER_US
                self.time.known = True
                outputs.append(notices.FleetTimeKnown())
            else:
                self._last, self.asks_at_us = True, now_us
                self.alone_at_us = now_us + LAST_WAIT_US
        if now_us >= self.asks_at_us:
            self.asks_at_us = FOREVER_US if self.time.known else now_us + self.ask_again_for_us
            if ctx.joined:
                outputs.append(Send(self._ask(now_us)))
        if self._pending and now_us - self._answered_at_us >= ANSWER_SPACING_US:
            outputs += self._answer(ctx)
        return outputs

    def _answer(self, ctx: StepContext) -> Outputs:
        """Answer one question that is due: the lowest slot first, which would start a time first."""
        now_us = ctx.now_us
        if not ctx.joined:  # a question that stays due would keep the robot's computer busy
            self._pending.clear()
        for old in [q for q, at_us in self._pending.items() if now_us - at_us > NONCE_LIFE_US]:
            del self._pending[old]
        due = [question for question, at_us in self._pending.items() if now_us >= at_us]
        if not due:
            return NOTHING
        question = min(due)
        del self._pending[question]
        assert self.answers is not None
        self._answered_at_us = now_us
        halves = self.answers.halves(question, self.time.at(now_us))
        return [Send(half) for half in halves]

    def _comparable(self, m: FleetTimeTold, now_us: int) -> list[TimeQuestion]:
        """The questions of others that an answer is compared with: few, and none for a flood of answers.

        What is not compared costs one answer more on the bus, and no robot its time."""
        if m.part != TAG or not self._pending:
            return []
        if now_us - self._compared_from_at_us >= COMPARED_FOR_US:
            self._compared, self._compared_from_at_us = 0, now_us
        if self._compared >= COMPARED_ANSWERS_MAX:
            return []
        self._compared += 1
        return nsmallest(COMPARED_MAX, self._pending)

    def _ask(self, now_us: int) -> TimeQuestion:
        assert self.keys is not None
        self._asked, self._asked_at_us = self._asked + 1, now_us
        nonce = self.keys.number(b"nonce" + self._asked.to_bytes(8, "little"), self.lot, WORD_BITS)
        self._question = TimeQuestion(self.slot, nonce)
        return self._question

    def _joined(self, ctx: StepContext, notice: notices.AddressGained) -> Outputs:
        if self.keys is not None and not self.time.known:
            self.asks_at_us = ctx.now_us
            self._last = False
            self.alone_at_us = ctx.now_us + alone_for_us(self.slot)
        return NOTHING

    def _keys_changed(self, ctx: StepContext, notice: notices.KeysChanged) -> Outputs:
        """A robot that has switched before us knows a later time. We ask as soon as we hear of it."""
        self._doubts = 0
        return NOTHING

    def _doubted(self, ctx: StepContext, notice: notices.TimeDoubted) -> Outputs:
        """A proof could not be verified: its sender may know a later time than we do."""
        if not self.time.known or self.asks_at_us != FOREVER_US:
            return NOTHING
        pause_for_us = DOUBT_US << min(self._doubts, DOUBLINGS_MAX)
        if ctx.now_us - self._asked_at_us >= pause_for_us:
            self._doubts += 1
            self.asks_at_us = ctx.now_us
        return NOTHING

    def _hear_question(self, ctx: StepContext, header: Header, m: TimeQuestion) -> Outputs:
        keys = self.keys
        if keys is None or not self.time.known or keys.of_time(m.asker) is None:
            return NOTHING
        if not ctx.joined:
            return NOTHING
        rank = sum(slot < self.slot for slot in ctx.live)
        if rank >= ANSWERERS:
            return NOTHING
        self._turn_for_us = ANSWER_US + (rank or self.slot) * ANSWER_STEP_US
        for older in [q for q in self._pending if q.asker == m.asker and q != m]:
            del self._pending[older]  # it takes only an answer to its newest question
        self._pending[m] = ctx.now_us + self._turn_for_us
        if len(self._pending) > QUESTIONS_MAX:
            del self._pending[next(iter(self._pending))]
        return NOTHING

    def _hear_time(self, ctx: StepContext, header: Header, m: FleetTimeTold) -> Outputs:
        if self.answers is None:
            return NOTHING
        now_us = ctx.now_us
        if m.part == TAG:  # one answer at a time on the bus: all others wait their turn again
            turn_at_us = now_us + self._turn_for_us
            self._pending = {q: max(at_us, turn_at_us) for q, at_us in self._pending.items()}
        for question in self._comparable(m, now_us):  # another robot has answered as we would
            ticks = self.answers.hear(header.source, m, question)
            if ticks is None or not self.time.possible(ticks):
                continue
            if ticks >= self.time.at(now_us) - BACK:
                del self._pending[question]
        mine = self._question if now_us - self._asked_at_us <= NONCE_LIFE_US else None
        ticks = self.answers.hear(header.source, m, mine)
        if ticks is None:
            return NOTHING
        refused = self.time.refused
        learned = self.time.learn(ticks, now_us)
        if self.time.refused > refused:
            who = f"address {header.source}"
            return [Trace("trust", "", "REFUSED", who, "a fleet time that no robot has")]
        self.asks_at_us = self.alone_at_us = (
            FOREVER_US  # the question stays: a later time may follow
        )
        if not learned:
            return NOTHING
        self._doubts = 0
        return [notices.FleetTimeKnown()]


def alone_for_us(slot: int) -> int:
    """How long a robot that has joined waits for the fleet's time before it starts it."""
    steps = min(slot, ALONE_STEPS)
    return ALONE_US + steps * ALONE_STEP_US + (slot - steps) * LATE_STEP_US
