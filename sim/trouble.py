"""Bad luck drawn from a seed: a scenario with faults of every kind, in two phases.

Until `Span.calm_s` anything may happen; then everything is mended (links, rates, crashed robots, a reset
and a start), and what comes after must be well within bounded time. The result is a scenario like any
other: it can be printed, edited, shrunk and run again.
"""

from collections.abc import Callable
from random import Random
from typing import NamedTuple

from sim import scenario as kinds
from sim.drill_setting import DrillSetting, drill
from sim.scenario import Fault, Scenario, load
from sim.setting import Setting


class Span(NamedTuple):
    """When what happens in a run, by its mission."""

    calm_s: float  # nothing new goes wrong after this
    limit_s: float  # the work must be finished by then
    first_s: float = 4.0  # nothing goes wrong before

    @property
    def reset_s(self) -> float:
        return self.calm_s + 4.0

    @property
    def again_s(self) -> float:
        """Twice: who was out of reach of the first reset is there for the second."""
        return self.calm_s + 12.0


SPANS = {
    "field": Span(40.0, 300.0),  # without trouble the yard takes 90 s
    "drill": Span(120.0, 600.0),  # and a drill 180 s
}

CLOSE_S = 3.0  # links stay bad for seconds: what happens so soon after, happens in the middle of it

Draw = Callable[[Random, int, float, float], list[Fault]]  # dice, robots, when, until when


def _cut(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
    slots = list(range(robots))
    rng.shuffle(slots)
    at = rng.randrange(1, robots)
    healed_s = min(at_s + rng.choice((0.2, 2.0, 10.0)), end_s)
    return [
        kinds.Partition(at_s=at_s, kind="partition", islands=[slots[:at], slots[at:]]),
        kinds.Heal(at_s=healed_s, kind="heal"),
    ]


def _one_way(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
    sender, receiver = rng.sample(range(robots), 2)
    return [kinds.OneWay(at_s=at_s, kind="one_way", sender=sender, receiver=receiver)]


def _crash(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
    robot, back_s = rng.randrange(robots), min(at_s + rng.uniform(0.05, 15.0), end_s)
    disk = rng.choice(("kept", "kept", "torn", "torn", "lost"))
    restart = {"at_s": back_s, "kind": "restart", "robot": robot, "disk": disk}
    return [
        kinds.Crash(at_s=at_s, kind="crash", robot=robot),
        kinds.Restart.model_validate(restart),
    ]


def _freeze(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
    for_s = rng.choice((0.05, 0.3, 1.0, 8.0))
    return [kinds.Freeze(at_s=at_s, kind="freeze", robot=rng.randrange(robots), for_s=for_s)]


def _rate(make: Callable[[float, float], Fault], most: float) -> Draw:
    def draw(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
        over_s = min(at_s + rng.uniform(1.0, 15.0), end_s)
        return [make(at_s, rng.choice((0.01, 0.1, most))), make(over_s, 0.0)]

    return draw


def _bus_off(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
    for_s, robot = rng.uniform(0.01, 4.0), rng.randrange(robots)
    return [kinds.BusOff(at_s=at_s, kind="bus_off", robot=robot, for_s=for_s)]


def _babble(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
    priority, for_s = rng.randrange(8), rng.uniform(0.1, 3.0)
    return [kinds.Babble(at_s=at_s, kind="babble", priority=priority, for_s=for_s)]


def _clone(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
    wins = rng.random() < 0.7
    return [kinds.Clone(at_s=at_s, kind="clone", robot=rng.randrange(robots), wins=wins)]


def _drift(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
    ppm = rng.choice((-500.0, 500.0, -5000.0, 5000.0))
    return [kinds.Drift(at_s=at_s, kind="drift", robot=rng.randrange(robots), ppm=ppm)]


def _jump(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
    robot, by_s = rng.randrange(robots), rng.choice((-1.0, -0.05, 0.05, 0.4, 5.0, 3600.0))
    return [kinds.ClockJump(at_s=at_s, kind="clock_jump", robot=robot, by_s=by_s)]


def _crash_working(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
    robot, for_s = rng.randrange(robots), rng.uniform(0.05, max(0.1, end_s - at_s - 10.0))
    disk = rng.choice(("kept", "torn", "lost"))
    table = {"at_s": at_s, "kind": "crash_working", "robot": robot, "for_s": for_s, "disk": disk}
    return [kinds.CrashWorking.model_validate(table)]


def _join(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
    return [kinds.Join(at_s=at_s, kind="join", robot=rng.randrange(robots))]


def _box(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
    x_m, y_m = rng.uniform(-YARD_M[0], YARD_M[0]), rng.uniform(-YARD_M[1], YARD_M[1])
    size_m, for_s = rng.uniform(0.4, 1.5), min(rng.uniform(1.0, 15.0), end_s - at_s)
    return [kinds.Box(at_s=at_s, kind="box", x_m=x_m, y_m=y_m, size_m=size_m, for_s=for_s)]


def _push(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
    dx_m, dy_m = rng.uniform(-4.0, 4.0), rng.uniform(-4.0, 4.0)
    robot = rng.randrange(robots)
    return [kinds.Pushed(at_s=at_s, kind="pushed", robot=robot, dx_m=dx_m, dy_m=dy_m)]


def _haste(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
    """A person resets or starts one machine, whatever still holds it: it must refuse."""
    table = {"at_s": at_s, "kind": "order", "robot": rng.randrange(robots)}
    order = rng.choice(("manual_reset", "manual_reset", "start"))
    return [kinds.Order.model_validate(table | {"order": order})]


def _press(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
    return [kinds.Estop(at_s=at_s, kind="estop", robot=rng.randrange(robots))]


def _release(rng: Random, robots: int, at_s: float, end_s: float) -> list[Fault]:
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
    "clock_jump": _jump,
    "crash_working": _crash_working,
    "join": _join,
    "box": _box,
    "pushed": _push,
    "estop": _press,
    "reset": _release,
    "haste": _haste,
}


YARD_M = 18.0, 12.0  # boxes fall within this of the middle
BODIES = ("box", "pushed")  # of no use where there is no world
LINKS = (kinds.Partition, kinds.Heal, kinds.OneWay, kinds.Loss, kinds.Omission, kinds.Errors,
         kinds.Duplicate, kinds.BusOff, kinds.Babble, kinds.Clone, kinds.Freeze, kinds.Drift,
         kinds.ClockJump)  # fmt: skip


def is_link_trouble(fault: Fault) -> bool:
    """After this nobody can say from outside who hears whom."""
    return isinstance(fault, LINKS)


class Profile(NamedTuple):
    """Which kinds, how often, in what fleet."""

    robots: tuple[int, int]
    faults: tuple[int, int]
    weights: dict[str, float]
    about: str
    mission: str = "field"
    together: float = 0.0  # chance that a fault comes within `CLOSE_S` of one that was drawn before


OFTEN = {"estop": 2.0, "crash": 2.0, "partition": 2.0, "join": 0.5}
EVERYTHING = dict.fromkeys(DRAWS, 1.0) | OFTEN
PROFILES = {
    "all": Profile((2, 5), (1, 10), EVERYTHING, "every kind of fault"),
    "bus": Profile(
        (2, 5), (2, 12),
        dict.fromkeys(("partition", "one_way", "loss", "omission", "duplicate", "errors", "bus_off",
                       "babble", "clone"), 1.0),
        "the wire alone",
    ),
    "crash": Profile((2, 4), (1, 8), {"crash": 2.0, "crash_working": 2.0, "freeze": 1.0,
                                      "drift": 0.5, "clock_jump": 0.5, "join": 0.5, "estop": 1.0},
                     "robots that die, freeze and come back, with and without their memory"),
    "stop": Profile((2, 5), (2, 8), {"estop": 4.0, "reset": 2.0, "haste": 2.0, "partition": 1.0,
                                     "crash": 1.0,
                                     "loss": 1.0, "freeze": 1.0, "babble": 0.5},
                    "presses and resets in the middle of trouble", together=0.5),
    "body": Profile((2, 4), (2, 8), {"box": 3.0, "pushed": 3.0, "crash_working": 1.0,
                                     "freeze": 1.0, "estop": 1.0},
                    "dropped boxes, pushed robots, dead ones in the way"),
    "protocol": Profile((2, 8), (3, 30), {k: w for k, w in EVERYTHING.items() if k not in BODIES},
                        "every kind of fault, without a world: more hours, longer runs", "drill"),
}  # fmt: skip


def draw(seed: int, profile: str = "all") -> Scenario:
    """The scenario of a seed; KeyError for a profile that does not exist."""
    kind, rng = PROFILES[profile], Random(f"{seed}/trouble/{profile}")
    robots, span = rng.randint(*kind.robots), SPANS[kind.mission]
    names = sorted(kind.weights)
    faults: list[Fault] = []
    for name in rng.choices(names, [kind.weights[n] for n in names], k=rng.randint(*kind.faults)):
        at_s = rng.uniform(span.first_s, span.calm_s - 0.5)
        if kind.together and faults and rng.random() < kind.together:
            at_s = min(rng.choice(faults).at_s + rng.uniform(0.0, CLOSE_S), span.calm_s - 0.5)
        at_s = round(at_s, 3)
        faults += DRAWS[name](rng, robots, at_s, span.calm_s)
    plain = drill(robots, seed) if kind.mission == "drill" else load("yard").changed(robots, seed)
    return with_faults(plain, faults)


def span_of(scenario: Scenario) -> Span:
    return SPANS[scenario.mission]


def setting_of(scenario: Scenario) -> Setting:
    return DrillSetting(scenario) if scenario.mission == "drill" else Setting(scenario)


def with_faults(scenario: Scenario, faults: list[Fault]) -> Scenario:
    """A scenario with these faults, sorted, and the calm after them."""
    span = span_of(scenario)
    drawn = [f for f in sorted(faults, key=lambda f: f.at_s) if f.at_s <= span.calm_s]
    run = scenario.run.model_copy(update={"time_limit_s": span.limit_s})
    return scenario.model_copy(update={"fault": drawn + calm(span), "run": run})


def calm(span: Span) -> list[Fault]:
    at_s = span.calm_s + 0.5
    return [
        kinds.Heal(at_s=at_s, kind="heal"),
        kinds.Loss(at_s=at_s, kind="loss", rate=0.0),
        kinds.Omission(at_s=at_s, kind="omission", rate=0.0),
        kinds.Duplicate(at_s=at_s, kind="duplicate", rate=0.0),
        kinds.Errors(at_s=at_s, kind="errors", rate=0.0),
        kinds.Reset(at_s=span.reset_s, kind="reset"),
        kinds.Reset(at_s=span.again_s, kind="reset"),
    ]
