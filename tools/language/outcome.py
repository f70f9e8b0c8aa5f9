"""What became of one phrase."""

from dataclasses import dataclass, field
from typing import Any

from tools.language.answer import Answer
from tools.language.authorize import AuthorizedOrder
from tools.language.intent import AnyIntent, plain
from tools.language.question import Question, QuestionReason

DONE, NOT_OBEYED, ASKED_BACK = 0, 1, 3
LATCHED = (
    "this was an emergency stop, which no words release: see that no person is in danger, then "
    "headland release"
)


@dataclass
class Outcome:
    """Intents, orders with what robots confirmed, answers, and what was asked back."""

    phrase: str
    intents: tuple[AnyIntent, ...] = ()
    question: Question | None = None
    # None: not obeyed.
    orders: list[tuple[AuthorizedOrder, str | None]] = field(default_factory=list)
    # Robots that confirmed a stop of all; None: none was asked for.
    stopped: list[int] | None = None
    not_stopped: list[int] = field(default_factory=list)
    latched: bool = (
        False  # that stop was an emergency stop, also where an ordinary one was asked for
    )
    held: list[int] | None = None  # robots that were held first, because the phrase may be an alarm
    queued: list[str] = field(default_factory=list)
    answers: list[Answer] = field(default_factory=list)
    told_by: str = "the bus"
    by_model: bool = False  # a language model turned the phrase into intents

    @property
    def code(self) -> int:
        """Exit code of `headland say`: done, not obeyed, or asked back."""
        if self.question is not None:
            return ASKED_BACK
        refused = any(word is None for _, word in self.orders)
        no_robot = self.stopped == []
        return NOT_OBEYED if refused or self.not_stopped or no_robot else DONE

    def to_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        asked = self.question
        return {
            "phrase": self.phrase, "intents": [plain(intent) for intent in self.intents],
            "by_model": self.by_model,
            "asked_back": None if asked is None else {
                "reason": asked.reason.value, "text": asked.text, "instead": list(asked.instead)
            },
            "orders": [
                {"robot": o.slot, "order": o.what, "place": o.place, "obeyed": word is not None,
                 "says": word} for o, word in self.orders
            ],
            "stopped": self.stopped, "held": self.held, "not_stopped": self.not_stopped,
            "emergency_stop": self.latched, "queued": self.queued,
            "answers": [answer.value for answer in self.answers], "told_by": self.told_by,
        }  # fmt: skip

    def lines(self) -> list[str]:
        """Sentences for a person, one a line: stops first, then orders, waiting goals and answers."""
        lines = [_order_line(order, word) for order, word in self.orders]
        lines += self._stopped_lines()
        lines += [f"queued until a robot is idle: {name}" for name in self.queued]
        if self.question is not None:
            kind = self.question.reason
            plain_text = kind is QuestionReason.NOT_UNDERSTOOD
            asked = str(self.question) if plain_text else f"{kind}: {self.question}"
            return [*lines, *self._held_lines(), asked]
        source = f"{self.told_by}: " if self.told_by != "the bus" and self.answers else ""
        return lines + [source + answer.text for answer in self.answers] or ["done"]

    def _stopped_lines(self) -> list[str]:
        """Also where something else in the phrase was asked back."""
        if self.stopped is None:
            return []
        latched = [LATCHED] if self.latched and self.stopped else []
        stopped = f"stopped: {', '.join(map(str, self.stopped)) or 'no robot is heard'}"
        return [stopped, *latched, *self._not_stopped_lines()]

    def _held_lines(self) -> list[str]:
        if self.held is None:
            return []
        who = ", ".join(map(str, self.held)) or "no robot is heard"
        text = f"this may be an alarm; held: {who}. What is meant? (say: stop all; or: start all)"
        return [text, *self._not_stopped_lines()]

    def _not_stopped_lines(self) -> list[str]:
        if not self.not_stopped:
            return []
        slots = ", ".join(map(str, self.not_stopped))
        return [f"NOT STOPPED: {slots}: use the switch on the machine"]


def _order_line(order: AuthorizedOrder, word: str | None) -> str:
    where = "" if order.place is None else f" {order.place[0]:g}, {order.place[1]:g}"
    if word is None:
        return f"robot {order.slot}: DOES NOT OBEY {order.what}{where}"
    return f"robot {order.slot}: {order.what}{where}; it says: {word}"
