"""From a phrase to intents, or to a question. Uses the language and place names, not the fleet."""

import re
from collections import Counter
from collections.abc import Collection
from difflib import get_close_matches

from pydantic import ValidationError

from tools.language.alarm import letters_apart
from tools.language.grammar import NotANumber, UnknownPlace, Unnamed, Unreadable, derivations
from tools.language.intent import INTENTS_MAX, AnyIntent, Control, Goal
from tools.language.places import Places
from tools.language.question import Question, QuestionReason
from tools.language.vocabulary import (
    DOUBTFUL,
    KNOWN_WORDS,
    NEGATIONS,
    NUMBERS,
    SEQUENCES,
    UNSAFE,
    tokens_of,
    words_of,
)

PHRASE_MAX = 400  # characters; no order needs more
TOKENS_MAX = 40
LIKE = 0.7  # likeness of a word that was probably meant
SHORT = 5  # letters; a longer word may have two of them wrong
# Groups in which "over" runs over nobody.
HARMLESS = ("over to", "take over", "over there", "over here")
STOP_NOW = "stop all"
EXAMPLES = ("send the nearest robot to 12, -4", "where is robot 2", "robot 2 go home")


def read(text: str, places: Places) -> tuple[AnyIntent, ...] | Question:
    """The one meaning of a phrase; whatever has none, or two, is a question."""
    if len(text) > PHRASE_MAX:
        return Question(
            QuestionReason.NOT_UNDERSTOOD, f"more than {PHRASE_MAX} characters: say less at once"
        )
    words = words_of(text)
    tokens = tokens_of(words, places.groups)
    if not tokens:
        return Question(QuestionReason.NOT_UNDERSTOOD, "nothing was said", EXAMPLES)
    if len(tokens) > TOKENS_MAX:
        return Question(QuestionReason.NOT_UNDERSTOOD, "that is too much at once: say one order")
    try:
        meanings = derivations(tokens)
    except UnknownPlace as problem:
        return _unread(words, places) or _no_place(str(problem), places)
    except Unreadable:
        return _unread(words, places) or _not_understood(words, places)
    except Unnamed:
        return Question(QuestionReason.AMBIGUOUS, "which robot?", ("status of robot 2", "status"))
    except NotANumber as problem:
        return Question(
            QuestionReason.UNKNOWN_ROBOT,
            f"{problem}: robots and sections have whole numbers from 0",
        )
    except ValidationError as problem:
        return _out_of_range(problem)
    if len(meanings) > 1:
        return Question(
            QuestionReason.AMBIGUOUS, "that can be read in two ways: say it in shorter orders"
        )
    return together(meanings[0])


def together(intents: tuple[AnyIntent, ...]) -> tuple[AnyIntent, ...] | Question:
    """Orders of one phrase must not contradict each other, nor depend on their order."""
    if len(intents) > INTENTS_MAX:
        return Question(QuestionReason.NOT_UNDERSTOOD, f"more than {INTENTS_MAX} orders at once")
    told: Counter[object] = Counter()
    for intent in intents:
        if isinstance(intent, Goal):
            told[intent.robot] += 1
        elif isinstance(intent, Control):
            told.update([intent.robots] if isinstance(intent.robots, str) else set(intent.robots))
    unclear = {"all", "unnamed", "several"} & set(told)
    if (unclear and sum(told.values()) > 1) or any(
        n > 1 and who != "nearest" for who, n in told.items()
    ):
        return Question(
            QuestionReason.AMBIGUOUS, "two orders for one robot in one phrase: which of them?",
            (STOP_NOW, "one order at a time"),
        )  # fmt: skip
    return intents


def _out_of_range(problem: ValidationError) -> Question:
    error = problem.errors()[0]
    reason = (
        QuestionReason.UNKNOWN_PLACE
        if error["loc"][-1] in ("x_m", "y_m")
        else QuestionReason.UNKNOWN_ROBOT
    )
    return Question(reason, f"{error['input']}: {error['msg'][0].lower()}{error['msg'][1:]}")


def _no_place(name: str, places: Places) -> Question:
    like = places.like(name)
    known = ", ".join(places.named[:8]) or "none are named; say metres east, north"
    text = f"no place {name!r}" + (f"; did you mean {', '.join(like)}?" if like else f": {known}")
    return Question(QuestionReason.UNKNOWN_PLACE, text)


def _unread(words: list[str], places: Places) -> Question | None:
    """A phrase that could be dangerous to half understand gets the reason by which it is refused."""
    said = set(_doubtful_words(words)) - {w for group in places.groups for w in group}
    stops = said & {"stop", "halt", "freeze", "brake"}
    if found := said & NEGATIONS:
        return Question(
            QuestionReason.AMBIGUOUS,
            f"{_first(found, words)!r}: say what shall be done, not what shall not",
            (STOP_NOW,) if stops else (),
        )  # fmt: skip
    if found := said & DOUBTFUL.keys():
        word = _first(found, words)
        return Question(QuestionReason.AMBIGUOUS, f"{word!r} can mean two things", DOUBTFUL[word])
    if found := said & UNSAFE:
        instead = (
            ("headland release, with the operator's key",) if "reset" in found else (STOP_NOW,)
        )
        return Question(
            QuestionReason.UNSAFE,
            f"{_first(found, words)!r}: nothing that weakens safety is obeyed",
            instead,
        )
    if found := said & SEQUENCES:
        return Question(
            QuestionReason.AMBIGUOUS, f"{_first(found, words)!r}: no conditions, choices or sequences; "
            "say one thing, and the next when it is done", (STOP_NOW,) if stops else (),
        )  # fmt: skip
    return None


def _not_understood(words: list[str], places: Places) -> Question:
    """What was probably meant is offered, never done."""
    known = [*KNOWN_WORDS, *{w for group in places.groups for w in group}]
    if set(words) & {"stop", "halt", "freeze", "brake"}:
        return Question(QuestionReason.NOT_UNDERSTOOD, "not understood", (STOP_NOW, "stop robot 2"))
    meant = [_meant(word, known) for word in words]
    offered = " ".join(meant)
    instead = (offered,) if meant != words and _readable(offered, places) else EXAMPLES
    return Question(QuestionReason.NOT_UNDERSTOOD, "not understood", instead)


def _meant(word: str, known: Collection[str]) -> str:
    """The word of the language of which this is a misspelling, or the word itself.

    "remove" is not "move" misspelt, nor "broken" "brake": the first letter is seldom wrong.
    """
    if word in known or word in NUMBERS or not word.isalpha() or re.fullmatch(r"r\d+", word):
        return word
    wrong_max = 1 if len(word) <= SHORT else 2
    like = get_close_matches(word, known, n=5, cutoff=LIKE)
    return next((k for k in like if k[0] == word[0] and letters_apart(word, k) <= wrong_max), word)


def _readable(offered: str, places: Places) -> bool:
    """Whether the offer is a phrase of the language, so that a person may say it."""
    try:
        return bool(derivations(tokens_of(words_of(offered), places.groups)))
    except (UnknownPlace, Unreadable, Unnamed, NotANumber, ValidationError):
        return False


def _doubtful_words(words: list[str]) -> list[str]:
    """Without those that say nothing doubtful in the group in which they stand: "over to"."""
    text = f" {' '.join(words)} "
    for group in HARMLESS:
        text = text.replace(f" {group} ", " ")
    return text.split()


def _first(found: set[str], words: list[str]) -> str:
    return next(word for word in words if word in found)
