"""Plain language and the inspector, measured: phrases, misspellings, times, one-line errors, why."""

import tomllib
from pathlib import Path
from random import Random
from string import ascii_lowercase
from typing import Any, NamedTuple

from tools.language.fleet_now import FleetNow, RobotNow, SectionNow
from tools.language.places import Places
from tools.language.question import Question
from tools.language.reading import read
from tools.language.weighing import Verdict, weigh

FILE = Path(__file__).with_suffix(".toml")
ALONE = "nothing to compare with"


class Case(NamedTuple):
    """One phrase of the file."""

    say: str
    intents: list[dict[str, Any]] | None
    gives: list[str] | None
    asks: str | None


class Phrases(NamedTuple):
    known: list[Case]
    unseen: list[Case]
    fleet: FleetNow
    places: Places


def phrases() -> Phrases:
    document = tomllib.loads(FILE.read_text(encoding="utf-8"))
    fleet = FleetNow(
        {robot["slot"]: RobotNow(**robot) for robot in document["robot"]},
        {3: SectionNow("STARTED", 2), 7: SectionNow("STARTED", 1)},
    )
    known, unseen = (
        [Case(c["say"], c.get("intents"), c.get("gives"), c.get("asks")) for c in document[kind]]
        for kind in ("phrase", "unseen")
    )
    return Phrases(known, unseen, fleet, Places(document["places"], document["sections"]))


def given(verdict: Verdict) -> list[str]:
    """What would be done, as the file writes it."""
    told = [_order(o.slot, o.what, o.place) for o in verdict.orders]
    told += [f"queued {goal.name}" for goal in verdict.waiting]
    told += ["stop all"] * verdict.stop_all + ["emergency stop"] * verdict.emergency_stop
    told += ["clear queue"] * verdict.clear_queue + ["first asks"] * len(verdict.first_ask)
    return told + [f"answers {query.ask}" for query in verdict.queries]


def _order(slot: int, what: str, place: tuple[float, float] | None) -> str:
    return f"{slot} {what}" + ("" if place is None else f" {place[0]:g},{place[1]:g}")


def understood(say: str, file: Phrases) -> list[str] | Question:
    """What a phrase would do in the fleet of the file."""
    reading = read(say, file.places)
    verdict = reading if isinstance(reading, Question) else weigh(reading, file.fleet, file.places)
    return verdict if isinstance(verdict, Question) else given(verdict)


def misspelt(say: str, rng: Random) -> str:
    """One letter of one word is another, missing, doubled, or has changed places; no digit is touched."""
    places = [at for at, letter in enumerate(say) if letter.isalpha()]
    at = rng.choice(places)
    match rng.randrange(4):
        case 0:
            return say[:at] + rng.choice(ascii_lowercase) + say[at + 1 :]
        case 1:
            return say[:at] + say[at + 1 :]
        case 2:
            return say[:at] + say[at] + say[at:]
        case _:
            return say[:at] + say[at + 1 : at + 2] + say[at] + say[at + 2 :]
