"""Bad luck drawn from a seed: a scenario with faults of every kind, in two phases.

Until `CALM_S` anything may happen; then everything is mended (links, rates, crashed robots, a reset
and a start), and what comes after must be well within bounded time. The result is a scenario like any
other: it can be printed, edited, shrunk and run again.
"""

from collections.abc import Callable
from random import Random
from typing import NamedTuple

from sim import scenario as kinds
from sim.scenario import Fault, Scenario, load

FIRST_S, CALM_S = 4.0, 40.0
RESET_S, AGAIN_S = 44.0, 52.0  # twice: who was out of reach of the first is there for the second
LIMIT_S = 300.0  # the field must be finished by then; without trouble it takes 90 s

Draw = Callable[[Random, int, float], list[Fault]]


def _cut(rng: Random, robots: int, at_s: float) -> list[Fault]:
    slots = list(range(robots))
    rng.shuffle(slots)
    at = rng.randrange(1, robots)
    healed_s = min(at_s + rng.choice((0.2, 2.0, 10.0)), CALM_S)
    return [
        kinds.Partition(at_s=at_s, kind="partition", islands=[slots[:at], slots[at:]]),
        kinds.Heal(at_s=healed_s, kind="heal"),
    ]


def _one_way(rng: Random, robots: int, at_s: float) -> list[Fault]:
    sender, receiver = rng.sample(range(robots), 2)
    return [kinds.OneWay(at_s=at_s, kind="one_way", sender=sender, receiver=receiver)]


def _crash(rng: Random, robots: int, at_s: float) -> list[Fault]:
    robot, back_s = rng.randrange(robots), min(at_s + rng.uniform(0.05, 15.0), CALM_S)
    disk = rng.choice(("kept", "kept", "torn", "torn", "lost"))
    restart = {"at_s": back_s, "kind": "restart", "robot": robot, "disk": disk}
    return [
        kinds.Crash(at_s=at_s, kind="crash", robot=robot),
        kinds.Restart.model_validate(restart),
    ]


def _freeze(rng: Random, robots: int, at_s: float) -> list[Fault]:
    for_s = rng.choice((0.05, 0.3, 1.0, 8.0))
    return [kinds.Freeze(at_s=at_s, kind="freeze", robot=rng.randrange(robots), for_s=for_s)]


def _rate(make: Callable[[float, float], Fault], most: float) -> Draw:
    def draw(rng: Random, robots: int, at_s: float) -> list[Fault]:
        over_s = min(at_s + rng.uniform(1.0, 15.0), CALM_S)
        return [make(at_s, rng.choice((0.01, 0.1, most))), make(over_s, 0.0)]

    return draw


def _bus_off(rng: Random, robots: int, at_s: float) -> list[Fault]:
    for_s, robot = rng.uniform(0.01, 4.0), rng.randrange(robots)
    return [kinds.BusOff(at_s=at_s, kind="bus_off", robot=robot, for_s=for_s)]


def _babble(rng: Random, robots: int, at_s: float) -> list[Fault]:
    priority, for_s = rng.randrange(8), rng.uniform(0.1, 3.0)
    return [kinds.Babble(at_s=at_s, kind="babble", priority=priority, for_s=for_s)]


def _clone(rng: Random, robots: int, at_s: float) -> list[Fault]:
    wins = rng.random() < 0.7
    return [kinds.Clone(at_s=at_s, kind="clone", robot=rng.randrange(robots), wins=wins)]


def _drift(rng: Random, robots: int, at_s: float) -> list[Fault]:
    ppm = rng.choice((-500.0, 500.0, -5000.0, 5000.0))
    return [kinds.Drift(at_s=at_s, kind="drift", robot=rng.randrange(robots), ppm=ppm)]


def _press(rng: Random, robots: int, at_s: float) -> list[Fault]:
    return [kinds.Estop(at_s=at_s, kind="estop", robot=rng.randrange(robots))]


def _release(rng: Random, robots: int, at_s: float) -> list[Fault]:
    return [kinds.Reset(at_s=at_s, kind="reset")]


DRAWS: dict[str, Draw] = {
    "partition": _cut,
    "one_way": _one_way,
    "crash": _crash,
    "freeze": _freeze,
    "loss": _rate(lambda at_s, rate: kinds.Loss(at_s=at_s, kind="loss", rate=rate), 0.4),
    "omission": _rate(
        lambda at_s, rate: kinds.Omission(at_s=at_s, kind="omission", rate=rate), 0.3
    ),
    "duplicate": _rate(
        lambda at_s, rate: kinds.Duplicate(at_s=at_s, kind="duplicate", rate=rate), 0.3
    ),
    "errors": _rate(lambda at_s, rate: kinds.Errors(at_s=at_s, kind="errors", rate=rate), 0.3),
    "bus_off": _bus_off,
    "babble": _babble,
    "clone": _clone,
    "drift": _drift,
    "estop": _press,
    "reset": _release,
}


class Profile(NamedTuple):
    """Which kinds, how often, in what fleet."""

    robots: tuple[int, int]
    faults: tuple[int, int]
    weights: dict[str, float]
    about: str


EVERYTHING = dict.fromkeys(DRAWS, 1.0) | {"estop": 2.0, "crash": 2.0, "partition": 2.0}
PROFILES = {
    "all": Profile((2, 5), (1, 10), EVERYTHING, "every kind of fault"),
    "bus": Profile(
        (2, 5), (2, 12),
        dict.fromkeys(("partition", "one_way", "loss", "omission", "duplicate", "errors", "bus_off",
                       "babble", "clone"), 1.0),
        "the wire alone",
    ),
    "crash": Profile((2, 4), (1, 8), {"crash": 3.0, "freeze": 1.0, "drift": 1.0, "estop": 1.0},
                     "robots that die, freeze and come back, with and without their memory"),
    "stop": Profile((2, 5), (2, 8), {"estop": 4.0, "reset": 2.0, "partition": 1.0, "crash": 1.0,
                                     "loss": 1.0, "freeze": 1.0, "babble": 0.5},
                    "presses and resets in the middle of trouble"),
}  # fmt: skip


def draw(seed: int, profile: str = "all") -> Scenario:
    """The scenario of a seed; KeyError for a profile that does not exist."""
    kind, rng = PROFILES[profile], Random(f"{seed}/trouble/{profile}")
    robots = rng.randint(*kind.robots)
    names = sorted(kind.weights)
    faults: list[Fault] = []
    for name in rng.choices(names, [kind.weights[n] for n in names], k=rng.randint(*kind.faults)):
        faults += DRAWS[name](rng, robots, round(rng.uniform(FIRST_S, CALM_S - 0.5), 3))
    return with_faults(load("yard").changed(robots, seed), faults)


def with_faults(scenario: Scenario, faults: list[Fault]) -> Scenario:
    """A scenario with these faults, sorted, and the calm after them."""
    drawn = [f for f in sorted(faults, key=lambda f: f.at_s) if f.at_s <= CALM_S]
    run = scenario.run.model_copy(update={"time_limit_s": LIMIT_S})
    return scenario.model_copy(update={"fault": drawn + calm(), "run": run})


def calm() -> list[Fault]:
    at_s = CALM_S + 0.5
    return [
        kinds.Heal(at_s=at_s, kind="heal"),
        kinds.Loss(at_s=at_s, kind="loss", rate=0.0),
        kinds.Omission(at_s=at_s, kind="omission", rate=0.0),
        kinds.Duplicate(at_s=at_s, kind="duplicate", rate=0.0),
        kinds.Errors(at_s=at_s, kind="errors", rate=0.0),
        kinds.Reset(at_s=RESET_S, kind="reset"),
        kinds.Reset(at_s=AGAIN_S, kind="reset"),
    ]
