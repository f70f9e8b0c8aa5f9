"""Random fault scenarios, drawn from a seed: faults of every kind, in two phases.

Until `Span.calm_at_s` any fault may occur. Then everything is repaired (links, rates, crashed robots,
a reset and a start), and the fleet must recover within bounded time. The result is an ordinary
scenario: it can be printed, edited, shrunk and run again.
"""

from math import hypot
from random import Random
from typing import NamedTuple, TypeGuard

from agent.peer.place_jumps import POSITION_ACCURACY_M
from sim.chaos.fault_generators import CLUSTERS, DRAWS, before_revocation
from sim.fleet.fault_injector import PUSHED_M_S
from sim.scenarios import scenario as kinds
from sim.scenarios.drawn_field import drawn_boundary
from sim.scenarios.field_setup import is_met_within
from sim.scenarios.fleet_setup import DRAWN
from sim.scenarios.protocol_setup import drill
from sim.scenarios.scenario import DRAWN_FIELD, Fault, Scenario, is_drawn, load


class Span(NamedTuple):
    """The phases of a run, by its mission."""

    calm_at_s: float  # no new fault after this
    limit_at_s: float  # the work must be finished by then
    first_at_s: float = 4.0  # no fault before this

    @property
    def reset_at_s(self) -> float:
        """When the operator resets for the first time: the fleet needs some seconds of calm to see
        all its stops."""
        return self.calm_at_s + 4.0

    @property
    def start_at_s(self) -> float:
        """The time of a second reset, for robots that were out of reach of the first."""
        return self.calm_at_s + 12.0


SPANS = {
    "field": Span(40.0, 300.0),  # without faults it takes 110 s
    "drill": Span(120.0, 600.0),  # without faults it takes 180 s
    "sprint": Span(30.0, 240.0),  # without faults it takes 70 s
}

# Fields with acute and reflex corners, a neck and islands.
SHAPES = ("star", "comb", "letter_u", "neck", "islands")
SLOW = Span(40.0, 450.0)  # by tractors 160 s without faults, in one of these shapes up to 185 s

# Under the policy continue, others work on beside a silent robot. Cuts and deaths last until they have
# worked what is left beside it.
APART = Span(80.0, 350.0)
DRAWN_LIMIT_S = 900.0  # a drawn field may have three times the area of a yard, and narrow parts

CLOSE_S = 3.0  # links stay bad for seconds: a fault within this time falls into the trouble

# No effect without a world.
BODIES = (
    "box",
    "pushed",
    "blind",
    "frozen",
    "hung_fixes",
    "jumped",
    "drifting",
    "deaf_wheels",
    "slipping",
    "late",
    "no_rays",
    "stuck_rays",
    "noisy_rays",
    "stuck_implement",
)
RAYS = ("no_rays", "stuck_rays", "noisy_rays")
# Not drawn by the weights of most profiles, but for every run with bodies, by a random source of their
# own: the other faults of a seed stay what they were.
SENSES = ("jumped", "drifting", "deaf_wheels", "slipping", *RAYS, "stuck_implement")
SENSOR_FAULTS = ("blind", "frozen", "late", *SENSES)
SENSOR_FAULTS_MAX = 3  # of a run
ATTACKS = ("forger", "thief")
TRAFFIC = ("person", "vehicle")
LINKS = (kinds.Partition, kinds.Heal, kinds.OneWay, kinds.Loss, kinds.Omission, kinds.Errors,
         kinds.Duplicate, kinds.BusOff, kinds.Babble, kinds.Clone, kinds.Freeze, kinds.Drift,
         kinds.ClockJump, kinds.Foreign, kinds.Twin, kinds.Nonsense, kinds.Forger)  # fmt: skip


def is_link_trouble(fault: Fault) -> bool:
    """Whether, after this fault, it is unknown from outside which robots receive each other."""
    return isinstance(fault, LINKS)


class Profile(NamedTuple):
    """Which fault kinds, how often, in which fleet."""

    robots: tuple[int, int]
    faults: tuple[int, int]
    weights: dict[str, float]
    about: str
    mission: str = "field"
    together: float = 0.0  # chance that a fault comes within `CLOSE_S` of an earlier drawn one
    silence: str = "stop"  # the silence policy
    keyed: bool = False  # the fleet has keys
    scenarios: tuple[str, ...] = ("yard",)  # of a field: one of these is drawn; they ship
    drives: tuple[str, ...] = ("mecanum",)  # one of them is drawn for the bodies of a field


OFTEN = {"estop": 2.0, "crash": 2.0, "partition": 2.0, "join": 0.5}
EVERYTHING = (
    dict.fromkeys(
        (each for each in DRAWS if each not in (*SENSES, *ATTACKS, *TRAFFIC, "hung_fixes")), 1.0
    )
    | OFTEN
)
PROFILES = {
    "all": Profile((2, 5), (1, 10), EVERYTHING, "every kind of fault"),
    "bus": Profile(
        (2, 5), (2, 12),
        dict.fromkeys(("partition", "one_way", "loss", "omission", "duplicate", "errors", "bus_off",
                       "babble", "clone"), 1.0),
        "the wire",
    ),
    "crash": Profile((2, 4), (1, 8), {"crash": 2.0, "crash_working": 2.0, "freeze": 1.0,
                                      "drift": 0.5, "clock_jump": 0.5, "join": 0.5, "estop": 1.0,
                                      "blind": 0.5, "frozen": 0.5, "late": 0.5, "disk_full": 1.0},
                     "robots that die, freeze and come back, with and without their memory"),
    "stop": Profile((2, 5), (2, 8), {"estop": 4.0, "reset": 2.0, "haste": 2.0, "partition": 1.0,
                                     "crash": 1.0,
                                     "loss": 1.0, "freeze": 1.0, "babble": 1.0,
                                     "blind": 0.5, "frozen": 0.5, "late": 0.5},
                    "presses and resets in the middle of trouble", together=0.5),
    "body": Profile((2, 4), (2, 8), {"box": 3.0, "pushed": 3.0, "crash_working": 1.0,
                                     "freeze": 1.0, "estop": 1.0, "blind": 1.5, "frozen": 1.5,
                                     "late": 1.0},
                    "dropped boxes, pushed robots, lost senses, dead robots in the way"),
    # A robot that restarts while its place is wrong cannot know it: no crashes.
    "senses": Profile((2, 4), (2, 8), {"blind": 2.0, "frozen": 2.0, "jumped": 4.0, "late": 2.0,
                                       "drifting": 2.0, "slipping": 2.0,
                                       "estop": 0.5, "loss": 0.5, "freeze": 0.5},
                      "receivers that fall silent, hang, jump, drift and are late; wheels that slip"),
    "fixes": Profile((2, 4), (1, 6), {"hung_fixes": 4.0, "blind": 0.5, "frozen": 0.5, "jumped": 0.5,
                                      "slipping": 0.5, "estop": 0.5, "freeze": 0.5},
                     "receivers that hang, beside wheels that are counted"),
    # As above, no crashes.
    "stalls": Profile((2, 4), (2, 8), {"stalled": 6.0, "jumped": 1.0, "freeze": 1.0, "estop": 0.5,
                                       "loss": 0.5},
                      "places that are lost and back while the robot's process gets no computing time"),
    # A robot with a stuck scan does not see what comes into its way: no boxes and no people. One that
    # restarts without a scan has no range sensors, and says so: no crashes.
    "rays": Profile((2, 4), (2, 8), {"no_rays": 3.0, "stuck_rays": 3.0, "noisy_rays": 3.0,
                                     "estop": 0.5, "loss": 0.5, "freeze": 0.5, "blind": 0.5},
                    "range sensors that fall silent, hang and are noisy"),
    # A robot that restarts while its implement is stuck senses it: crashes are drawn.
    "implement": Profile((2, 4), (2, 8), {"stuck_implement": 5.0, "crash_working": 1.0, "estop": 1.0,
                                          "reset": 0.5, "loss": 0.5, "freeze": 1.0, "blind": 0.5},
                         "implements that do not rise, stops, lost senses, dead robots"),
    "corners": Profile((2, 4), (1, 6), {"pushed": 3.0, "box": 1.0, "crash_working": 1.0, "freeze": 1.0,
                                        "estop": 1.0, "blind": 0.5, "loss": 0.5},
                       "a field with acute corners: pushes, boxes, dead robots, presses",
                       scenarios=("wedge",)),
    "shapes": Profile((2, 4), (1, 8), {"pushed": 2.0, "box": 1.0, "crash_working": 1.0, "crash": 0.5,
                                       "freeze": 1.0, "estop": 1.0, "reset": 0.5, "blind": 0.5,
                                       "frozen": 0.5, "loss": 0.5, "partition": 0.5, "join": 0.5},
                      "fields of odd shapes: pushes, boxes, dead robots, presses, lost links and senses",
                      scenarios=SHAPES),
    "steered": Profile((2, 4), (1, 8), {"pushed": 2.0, "box": 1.0, "crash_working": 1.0, "crash": 0.5,
                                        "freeze": 1.0, "estop": 1.0, "reset": 0.5, "blind": 0.5,
                                        "frozen": 0.5, "loss": 0.5, "partition": 0.5, "person": 0.5,
                                        "vehicle": 0.5},
                       "bodies that steer: pushes, boxes, dead robots, presses, people",
                       drives=("ackermann", "differential")),
    "apart": Profile((2, 4), (1, 6), {"partition": 3.0, "crash": 2.0, "crash_working": 2.0,
                                      "bus_off": 1.0, "freeze": 1.0, "one_way": 0.5, "join": 0.5,
                                      "estop": 0.5, "reset": 0.5, "loss": 0.5, "blind": 0.5},
                     "fields under the policy continue: cuts and deaths beside which others work on",
                     silence="continue"),
    "protocol": Profile((2, 8), (3, 30), {k: w for k, w in EVERYTHING.items() if k not in BODIES},
                        "every kind of fault, without a world: more hours, longer runs", "drill"),
    "press": Profile((2, 4), (2, 8), {"burst": 4.0, "estop": 2.0, "reset": 4.0, "haste": 2.0,
                                      "crash": 1.0, "blackout": 1.0, "freeze": 1.0,
                                      "partition": 0.5, "babble": 0.5},
                     "short drills: presses in noise, resets, the power of all failing",
                     "sprint", together=0.5),
    "devices": Profile((2, 4), (2, 6), {"buttons": 4.0, "used_stop": 4.0, "estop": 2.0, "reset": 3.0,
                                        "crash": 0.5, "join": 0.5},
                       "short drills: devices of other makers stop the fleet, and panels with used names",
                       "sprint"),
    "strangers": Profile((2, 5), (2, 6), {"foreign": 3.0, "twin": 3.0, "nonsense": 4.0, "estop": 2.0,
                                          "reset": 2.0, "crash": 0.5, "join": 0.5},
                         "short drills: other makers, second machines of one slot, and nonsense",
                         "sprint"),
    "claims": Profile((2, 5), (1, 6), {"crash": 2.0, "crash_working": 1.0, "join": 1.0,
                                       "freeze": 1.0, "errors": 1.0, "duplicate": 1.0,
                                       "bus_off": 1.0, "babble": 0.5, "blackout": 0.5,
                                       "clone": 1.0, "disk_full": 0.5,
                                       "estop": 1.0, "reset": 1.0},
                      "short drills: all want the same section, and some die or come late",
                      "sprint"),
    "split": Profile((2, 5), (1, 6), {"split": 4.0, "one_way": 1.0, "crash": 2.0, "join": 1.0,
                                      "loss": 1.0, "omission": 1.0, "freeze": 1.0, "bus_off": 1.0,
                                      "estop": 0.5, "reset": 0.5, "babble": 1.0},
                     "short drills under the policy continue: both sides work on", "sprint",
                     silence="continue"),
    "flood": Profile((2, 5), (3, 8), {"babble": 4.0, "estop": 3.0, "reset": 1.0, "crash": 0.5,
                                      "join": 0.5, "freeze": 0.5, "bus_off": 0.5},
                     "short drills under the policy continue: presses, and devices that outrank them",
                     "sprint", together=0.5, silence="continue"),
    "traffic": Profile((2, 4), (2, 6), {"person": 3.0, "vehicle": 2.0, "box": 0.5, "estop": 1.0,
                                        "reset": 0.5, "crash_working": 0.5, "loss": 0.5},
                       "people and vehicles that cross the field and make way, presses, dead robots"),
    "forged": Profile((2, 5), (2, 8), {"forger": 5.0, "estop": 2.0, "reset": 2.0, "crash": 1.0,
                                       "join": 0.5, "freeze": 0.5, "partition": 0.5, "loss": 0.5},
                      "drills of fleets with keys: attackers without a key, presses, resets, crashes",
                      "drill", keyed=True),
    "forged_field": Profile((2, 4), (2, 6), {"forger": 5.0, "estop": 2.0, "reset": 1.0, "crash": 1.0,
                                             "crash_working": 0.5, "box": 0.5},
                            "fields of fleets with keys: attackers without a key, presses, crashes",
                            keyed=True),
    "stolen": Profile((3, 5), (1, 6), {"thief": 3.0, "estop": 1.0, "reset": 1.0},
                      "drills of fleets with keys: a thief with a robot's keys, until its revocation",
                      "drill", keyed=True),
}  # fmt: skip


# Added to the name of any profile: the same faults in a fleet with keys, and an attacker without one.
FORGER = "+forger"
# Added to the name of a profile of fields: the same faults on a field that the seed draws.
DRAWN_SHAPE = "+drawn"
FORGERS_MAX = 2  # of a run


def is_profile(name: str) -> bool:
    """Whether `draw` knows this profile: one of `PROFILES`, or with `DRAWN_SHAPE`, `FORGER` or both."""
    name = name.removesuffix(FORGER)
    plain = name.removesuffix(DRAWN_SHAPE)
    return plain in PROFILES and (plain == name or PROFILES[plain].mission == "field")


def draw(seed: int, profile: str = "all") -> Scenario:
    """The scenario of a seed; KeyError for what is no profile."""
    if not is_profile(profile):
        raise KeyError(profile)
    attacked, profile = profile.endswith(FORGER), profile.removesuffix(FORGER)
    on_drawn, profile = profile.endswith(DRAWN_SHAPE), profile.removesuffix(DRAWN_SHAPE)
    kind, rng = PROFILES[profile], Random(f"{seed}/trouble/{profile}")
    robots, span = rng.randint(*kind.robots), SPANS[kind.mission]
    if kind.mission == "field" and kind.silence == "continue":
        span = APART
    names = sorted(kind.weights)
    faults: list[Fault] = []
    for name in rng.choices(names, [kind.weights[n] for n in names], k=rng.randint(*kind.faults)):
        at_s = rng.uniform(span.first_at_s, span.calm_at_s - 0.5)
        if kind.together and faults and rng.random() < kind.together:
            at_s = min(rng.choice(faults).at_s + rng.uniform(0.0, CLOSE_S), span.calm_at_s - 0.5)
        at_s = round(at_s, 3)
        faults += (DRAWS | CLUSTERS)[name](rng, robots, at_s, span.calm_at_s)
    if kind.mission == "field":
        faults += sensor_faults(seed, profile, robots, span, faults)
    thefts = [f for f in faults if isinstance(f, kinds.Forger) and f.position == "inside"]
    if thefts:
        # A robot is stolen once: later ones do nothing, and no frame is lost at the revocation.
        first = min(thefts, key=lambda theft: theft.at_s)
        faults += before_revocation(Random(f"{seed}/theft/{profile}"), first, robots)
    if attacked:
        faults += forgers(seed, profile, robots, span)
    keys = DRAWN if kind.keyed or attacked else None
    if kind.mission == "field":
        name = Random(f"{seed}/field/{profile}").choice(kind.scenarios)
        field = load(name).changed(robots, seed)
        drive = Random(f"{seed}/drive/{profile}").choice(kind.drives)
        policy = {"silence": kind.silence}
        fleet = field.fleet.model_copy(update={"keys": keys, "drive": drive, **policy})
        field = field.model_copy(update={"fleet": fleet})
        if on_drawn:
            field = _on_drawn_field(field, seed)
            bounds = drawn_boundary(field.field.file).polygon.bounds
            faults = [fault for fault in faults if is_met_within(fault, bounds)]
        return with_faults(field, faults)
    return with_faults(drill(robots, seed, kind.mission, kind.silence, keys), faults)


def _on_drawn_field(scenario: Scenario, seed: int) -> Scenario:
    """The same bodies and implements on the field of this seed."""
    file = f"{DRAWN_FIELD}{seed}"
    field = scenario.field.model_copy(update={"file": file})
    return scenario.model_copy(update={"name": file, "field": field})


def forgers(seed: int, profile: str, robots: int, span: Span) -> list[Fault]:
    """Attackers without a key for the run of a seed, by a random source of their own."""
    rng, found = Random(f"{seed}/forger/{profile}"), list[Fault]()
    for _ in range(rng.randint(1, FORGERS_MAX)):
        at_s = round(rng.uniform(span.first_at_s, span.calm_at_s - 0.5), 3)
        found += DRAWS["forger"](rng, robots, at_s, span.calm_at_s)
    return found


def sensor_faults(
    seed: int, profile: str, robots: int, span: Span, others: list[Fault]
) -> list[Fault]:
    """Some faults of senses, wheels or implements for the run of a seed with these other faults.

    One whose effect no robot could notice, or go round, is left out.
    """
    rng, found = Random(f"{seed}/senses/{profile}"), list[Fault]()
    for name in rng.choices(SENSOR_FAULTS, k=rng.randint(1, SENSOR_FAULTS_MAX)):
        at_s = round(rng.uniform(span.first_at_s, span.calm_at_s - 0.5), 3)
        drawn = DRAWS[name](rng, robots, at_s, span.calm_at_s)
        found += [fault for fault in drawn if not is_beyond_notice(fault, others)]
    return found


def is_beyond_notice(fault: Fault, others: list[Fault]) -> bool:
    """Whether nothing on a robot shows this fault of its senses, because of what else happens.

    A robot that starts while its place is wrong cannot know it. One that starts without a scan has no
    range sensors, and says so. One with a stuck scan does not see what comes into its way.
    """
    match fault:
        case kinds.Jumped(robot=robot) | kinds.NoRays(robot=robot):
            ends_at_s = fault.at_s + fault.for_s
            return any(
                getattr(each, "robot", None) == robot and begun_at_s < ends_at_s
                for each in others
                if (begun_at_s := _starts_from(each)) is not None
            )
        case kinds.StuckRays():
            return any(isinstance(each, MOVERS) for each in others)
    return False


MOVERS = (kinds.Box, kinds.Person, kinds.PassingVehicle, kinds.Pushed)


def _starts_from(fault: Fault) -> float | None:
    """From when on a robot may start because of this fault; none: it does not."""
    match fault:
        case kinds.Restart() | kinds.CrashWorking() | kinds.Join():
            return fault.at_s
        case kinds.DiskFull():  # one whose memory has failed is started again when there is room
            return fault.at_s + fault.for_s
    return None


def span_of(scenario: Scenario) -> Span:
    """When calm begins and the run ends, by the mission of the scenario, its field and its bodies."""
    if is_drawn(scenario.field.file):
        return _span_of_file(scenario)._replace(limit_at_s=DRAWN_LIMIT_S)
    return _span_of_file(scenario)


def _span_of_file(scenario: Scenario) -> Span:
    if scenario.mission == "field" and scenario.fleet.silence == "continue":
        return APART
    is_slow = scenario.fleet.drive != "mecanum" or scenario.name in SHAPES
    return SLOW if scenario.mission == "field" and is_slow else SPANS[scenario.mission]


def with_faults(scenario: Scenario, faults: list[Fault]) -> Scenario:
    """The scenario with these faults, sorted, and the repairs after them."""
    span = span_of(scenario)
    drawn = [f for f in sorted(faults, key=lambda f: f.at_s) if f.at_s <= span.calm_at_s]
    run = scenario.run.model_copy(update={"time_limit_s": span.limit_at_s})
    return scenario.model_copy(
        update={"fault": drawn + calm(span) + vouch(drawn, span), "run": run}
    )


def calm(span: Span) -> list[Fault]:
    """The end of all trouble: links and rates are repaired, and an operator resets twice."""
    at_s = span.calm_at_s + 0.5
    return [
        kinds.Heal(at_s=at_s, kind="heal"),
        kinds.Loss(at_s=at_s, kind="loss", rate=0.0),
        kinds.Omission(at_s=at_s, kind="omission", rate=0.0),
        kinds.Duplicate(at_s=at_s, kind="duplicate", rate=0.0),
        kinds.Errors(at_s=at_s, kind="errors", rate=0.0),
        kinds.Reset(at_s=span.reset_at_s, kind="reset"),
        kinds.Reset(at_s=span.start_at_s, kind="reset"),
    ]


# After one of these a robot may receive nothing while its clock goes back.
LONELY = (kinds.Partition, kinds.OneWay, kinds.BusOff, kinds.Crash, kinds.CrashWorking)
# After one of these a robot that was up boots with what it remembers.
ENDED = (kinds.Crash, kinds.CrashWorking, kinds.Restart, kinds.DiskFull)
# The place is not believed meanwhile.
SENSELESS = (kinds.Blind, kinds.Frozen, kinds.HungFixes, kinds.Late, kinds.Freeze, kinds.Drifting)
UNSEEING = (kinds.Blind, kinds.Frozen, kinds.HungFixes, kinds.Late, kinds.Freeze, kinds.ClockJump,
            kinds.Jumped)  # fmt: skip
UNSEEN_M = 10.0  # no body drives and brakes that far
BRAKING_S = 2.0  # from full speed
VOUCHED_S = 3.0  # after the fleet's start


def _unseen(jump: kinds.Jumped, drawn: list[Fault]) -> bool:
    """Whether this jump is no further than a body drives and brakes, and begins or ends while its robot
    senses nothing, or a place that is wrong, or shortly after."""
    if hypot(jump.dx_m, jump.dy_m) >= UNSEEN_M:
        return False
    return any(
        each.at_s <= at_s <= each.at_s + getattr(each, "for_s", 0.0) + BRAKING_S
        for each in drawn
        if isinstance(each, UNSEEING) or _hides_jumps(each)
        if each.robot == jump.robot and each is not jump
        for at_s in (jump.at_s, jump.at_s + jump.for_s)
    )


def _hides_jumps(fault: Fault) -> TypeGuard[kinds.Drifting]:
    """Whether a place drifts so far that its robot compares no such place with the one before."""
    if not isinstance(fault, kinds.Drifting):
        return False
    return hypot(fault.vx_m_s, fault.vy_m_s) * fault.for_s > POSITION_ACCURACY_M


def _believed(jump: kinds.Jumped, drawn: list[Fault]) -> bool:
    """Whether a person starts the robot meanwhile, and says so that the wrong place is right."""
    return any(
        jump.at_s <= each.at_s <= jump.at_s + jump.for_s
        for each in drawn
        if isinstance(each, kinds.Order) and each.order == "start" and each.robot == jump.robot
    )


def _unfelt(push: kinds.Pushed, drawn: list[Fault]) -> bool:
    """Whether the clock of the robot goes back while a person pushes it: it does nothing until its clock
    shows again what it had shown."""
    ends_at_s = push.at_s + hypot(push.dx_m, push.dy_m) / PUSHED_M_S
    return any(
        each.at_s <= ends_at_s and push.at_s <= each.at_s - each.by_s
        for each in drawn
        if isinstance(each, kinds.ClockJump) and each.by_s < 0.0 and each.robot == push.robot
    )


def vouch(drawn: list[Fault], span: Span) -> list[Fault]:
    """The starts that a person gives after looking at robots which cannot go on by themselves.

    A robot needs one if its place jumped, or came back, while it sensed nothing, or if it believed
    the jump. It cannot distinguish such a jump along its way from its own braking. So what it notices
    as a jump is the return to the true place, or it does not notice the return. The same holds for a
    push while it senses nothing accurate or does nothing because its clock went back, for wheels that
    did not answer, and for fixes that hung. A robot notices by the times of frames that its clock went
    back; one that receives no frames seems to jump. A robot that is switched off while its place is
    wrong does not know afterwards by how much. All other robots go on by themselves.
    """
    blind = {each.robot for each in drawn if isinstance(each, SENSELESS)}
    jumps = [each for each in drawn if isinstance(each, kinds.Jumped)]
    robots = {each.robot for each in jumps if _unseen(each, drawn) or _believed(each, drawn)}
    robots |= {each.robot for each in drawn if isinstance(each, kinds.DeafWheels | kinds.HungFixes)}
    pushes = [each for each in drawn if isinstance(each, kinds.Pushed)]
    robots |= {each.robot for each in pushes if each.robot in blind or _unfelt(each, drawn)}
    if any(isinstance(each, LONELY) for each in drawn):
        robots |= {f.robot for f in drawn if isinstance(f, kinds.ClockJump) and f.by_s < 0.0}
    ended = [each for each in drawn if isinstance(each, ENDED)]
    if ended:
        known = {getattr(each, "robot", None) for each in ended}
        moved = {e.robot for e in drawn if isinstance(e, (*SENSELESS, kinds.Jumped, kinds.Pushed))}
        robots |= moved if None in known else moved & known
    at_s = span.start_at_s + VOUCHED_S
    return [
        kinds.Order(at_s=at_s, kind="order", robot=slot, order="start") for slot in sorted(robots)
    ]
