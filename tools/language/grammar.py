"""The grammar over the tokens of the vocabulary, and the intents that a parse means.

Every derivation is kept: a phrase that can be read in two ways is asked back. Needs lark, of the extra
`operator`.
"""

import re
from collections.abc import Sequence
from functools import cache
from typing import Any, cast

from lark import Lark, Transformer, Tree, UnexpectedInput
from lark.exceptions import VisitError
from lark.visitors import CollapseAmbiguities

from agent.interface.config import PEERS_MAX
from tools.language.intent import Action, AnyIntent, At, Backlog, Beside, Control, Goal, Query
from tools.language.vocabulary import WORDS, Token

GRAMMAR = """
start: command (_AND command)*
?command: goal | control | query | backlog

goal: _MOVE mover _TO target
    | mover _comma (_MOVE | _GO) _TO target
    | _TELL mover _TO? (_MOVE | _GO) _TO target
    | _GOAL _OF? mover _TO target
    | mover _TO target
    | (_MOVE | _GO | _RETURN) _TO target -> goal_of_nobody
    | _GOAL _TO target -> goal_of_nobody

?mover: slot | near | others
near: _NEAREST _IDLE? _ROBOT? | _ANYONE
others: ALL -> everybody
    | (slots | range) -> several
    | _SEVERAL -> several
    | _THAT -> unnamed

slot: _ROBOT? NUM | _ROBOT? LABEL
slots: slot (_sep slot)+
range: slot _THROUGH slot
_sep: _COMMA | _COMMA? _AND
_comma: _COMMA?

?target: PLACE -> named
    | NUM _M? _COMMA? NUM _M? -> at
    | _X _EQUALS? NUM _M? _COMMA? _AND? _Y _EQUALS? NUM _M? -> at
    | _ROBOT NUM -> beside
    | _ROBOT? LABEL -> beside
    | section -> section_place
    | WORD+ -> unknown
section: SECTION | _SECTIONWORD NUM

?robots: slot -> one
    | slots
    | range
    | ALL -> everybody
    | _THAT -> unnamed
    | _SEVERAL -> unnamed

control: verb _comma robots?
    | robots _comma verb
    | _TELL robots _TO? verb
    | (_MOVE | _TELL | _RETURN) robots HOME -> send_home
verb: STOP+ | ESTOP+ | WAIT | CONTINUE | REPLAN | START
    | (_GO | _MOVE | _RETURN) HOME
    | _RETURN -> return_home

query: (_STATUS | _HOW) (_OF? robots)? _DOING? -> status
    | _WHAT robots _DOING -> status
    | robots _STATUS -> status
    | _WHERE robots -> position
    | _WHERE where -> position_of_place
    | _WHICH? _NEAREST _IDLE? _ROBOT? _TO target -> nearest_to
    | _WHICH _STOPPED -> stopped
    | _WHICH _IDLE -> idle
    | (_WHICH | _WHY robots | _WHY) _HAS? section -> owner
    | _QUEUE -> queue
    | _IS robots _WELL? -> status
    | _WHAT? _BATTERY (_OF? robots)? -> battery
    | robots _BATTERY -> battery
    | _PROGRESS -> progress
    | _FINISHED -> finished
    | _HOWFAR robots _FROM target -> distance
    | _PLACES -> places
?where: PLACE -> named
    | WORD+ -> unknown
    | section -> section_place

backlog: _CLEAR _QUEUE
"""
VERBS = {
    "STOP": "stop", "ESTOP": "emergency_stop", "WAIT": "wait", "CONTINUE": "continue",
    "REPLAN": "replan", "START": "start", "HOME": "go_home",
}  # fmt: skip
SINGLE = ("NUM", "LABEL", "SECTION", "PLACE", "WORD", "COMMA", "EQUALS")
END = "\n"  # of a token, as Lark's lexer sees it: "KIND:value\n"


class Unreadable(Exception):
    """No derivation: not a phrase of the language."""


class UnknownPlace(Exception):
    """The words that should name a place, and do not."""


class Unnamed(Exception):
    """A question about a robot that the phrase does not name."""


class NotANumber(Exception):
    """A robot or section by a number that none can have."""


@cache
def _parser() -> Lark:
    silent = set(re.findall(r"\b_[A-Z]+\b", GRAMMAR))  # tokens that the tree does not keep
    names = [f"_{kind}" if f"_{kind}" in silent else kind for kind in (*WORDS, *SINGLE)]
    terminals = [f"{name}: /{name.lstrip('_')}:[^\\n]*\\n/" for name in names]
    return Lark(
        GRAMMAR + "\n".join(terminals), parser="earley", lexer="basic", ambiguity="explicit",
        maybe_placeholders=False,
    )  # fmt: skip


def derivations(tokens: Sequence[Token]) -> list[tuple[AnyIntent, ...]]:
    """Each different meaning once. Raises Unreadable, UnknownPlace, NotANumber, ValidationError."""
    try:
        forest = _parser().parse("".join(f"{t.kind}:{t.value}{END}" for t in tokens))
    except UnexpectedInput:
        raise Unreadable from None
    trees: list[Tree[Any]] = CollapseAmbiguities().transform(forest)
    meanings: list[tuple[AnyIntent, ...]] = []
    for tree in trees:
        try:
            meaning = _Meaning().transform(tree)
        except VisitError as problem:
            raise problem.orig_exc from None
        if meaning not in meanings:
            meanings.append(meaning)
    return meanings


def _value(token: Any) -> str:
    return str(token).split(":", 1)[1].rstrip(END)


def _whole(token: Any) -> int:
    text = _value(token)
    if not text.isdigit():
        raise NotANumber(text)
    return int(text)


class _Meaning(Transformer[Any, Any]):
    """From the leaves up; each method is named by its rule."""

    def start(self, parts: list[Any]) -> tuple[AnyIntent, ...]:
        return tuple(parts)

    # ---------------------------------------------------------------- robots

    def slot(self, parts: list[Any]) -> int:
        return _whole(parts[0])

    def one(self, parts: list[Any]) -> tuple[int, ...]:
        return (parts[0],)

    def slots(self, parts: list[Any]) -> tuple[int, ...]:
        return tuple(dict.fromkeys(parts))  # "robot 1 and robot 1" is one order

    def range(self, parts: list[Any]) -> tuple[int, ...]:
        first, last = parts
        if not first < last < PEERS_MAX:
            raise NotANumber(f"{first} through {last}")
        return tuple(range(first, last + 1))

    def everybody(self, parts: list[Any]) -> str:
        return "all"

    def several(self, parts: list[Any]) -> str:
        return "several"

    def unnamed(self, parts: list[Any]) -> str:
        return "unnamed"

    def near(self, parts: list[Any]) -> str:
        return "nearest"

    # ---------------------------------------------------------------- where

    def named(self, parts: list[Any]) -> str:
        return _value(parts[0])

    def at(self, parts: list[Any]) -> At:
        return At(x_m=float(_value(parts[0])), y_m=float(_value(parts[1])))

    def beside(self, parts: list[Any]) -> Beside:
        return Beside(robot=_whole(parts[0]))

    def section(self, parts: list[Any]) -> int:
        return _whole(parts[0])

    def section_place(self, parts: list[Any]) -> str:
        return f"S{parts[0]}"

    def unknown(self, parts: list[Any]) -> None:
        raise UnknownPlace(" ".join(map(_value, parts)))

    # ---------------------------------------------------------------- what

    def goal(self, parts: list[Any]) -> Goal:
        return Goal(robot=parts[0], place=parts[1])

    def goal_of_nobody(self, parts: list[Any]) -> Goal:
        return Goal(robot="unnamed", place=parts[0])

    def verb(self, parts: list[Any]) -> str:
        return "!" + VERBS[str(parts[0]).split(":", 1)[0]]

    def return_home(self, parts: list[Any]) -> str:
        return "!go_home"

    def control(self, parts: list[Any]) -> Control:
        verb = next(p for p in parts if isinstance(p, str) and p.startswith("!"))[1:]
        whom = [p for p in parts if p != "!" + verb]
        # A stop that names no robot stops all robots. Only this is not asked back.
        stop = verb in ("stop", "emergency_stop")
        robots: Any = whom[0] if whom else "all" if stop else "unnamed"
        return Control(action=cast(Action, verb), robots=robots)

    def send_home(self, parts: list[Any]) -> Control:
        return Control(action="go_home", robots=parts[0])

    def status(self, parts: list[Any]) -> Query:
        return Query(ask="status", robots=_asked(parts))

    def position(self, parts: list[Any]) -> Query:
        return Query(ask="position", robots=_asked(parts))

    def position_of_place(self, parts: list[Any]) -> Query:
        return Query(ask="position", place=parts[0])

    def nearest_to(self, parts: list[Any]) -> Query:
        return Query(ask="nearest", place=parts[0])

    def stopped(self, parts: list[Any]) -> Query:
        return Query(ask="stopped")

    def idle(self, parts: list[Any]) -> Query:
        return Query(ask="idle")

    def owner(self, parts: list[Any]) -> Query:
        return Query(ask="section", section=parts[-1])

    def battery(self, parts: list[Any]) -> Query:
        return Query(ask="battery", robots=_asked(parts))

    def progress(self, parts: list[Any]) -> Query:
        return Query(ask="progress")

    def finished(self, parts: list[Any]) -> Query:
        return Query(ask="finished")

    def distance(self, parts: list[Any]) -> Query:
        return Query(ask="distance", robots=_asked(parts), place=parts[1])

    def queue(self, parts: list[Any]) -> Query:
        return Query(ask="queue")

    def places(self, parts: list[Any]) -> Query:
        return Query(ask="places")

    def backlog(self, parts: list[Any]) -> Backlog:
        return Backlog(action="clear")


def _asked(parts: list[Any]) -> Any:
    if parts and parts[0] == "unnamed":
        raise Unnamed
    return parts[0] if parts else "all"
