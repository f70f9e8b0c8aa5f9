"""How a fault of each kind is drawn, together with its related faults and its end.

A generator gets the random source, the fleet size, when the fault begins, and when it must be over.
"""

from collections.abc import Callable
from math import cos, pi, sin
from random import Random

from sim.fleet.forgers import REVOKED_AFTER
from sim.scenarios import scenario as kinds
from sim.scenarios.scenario import Fault

BABBLING = 0x4D  # lowest bits of an identifier: group 0, and a device's address
BOOTED_S = 3.0  # a robot that restarts has joined the fleet again
THEFT_S = 6.0  # at least, so that the revocation is over before the calm
NONSENSE_S = 5.0  # upper limit; the same time must be left before the end
YARD_M = 18.0, 12.0  # boxes appear within this distance of the middle
STALLS_S = 0.05, 0.4  # without computing time: a neighbour's work, a page that is read from disk
FAR = 10.0  # of the metres of `_jumped`
Draw = Callable[[Random, int, float, float], list[Fault]]  # random source, robots, start, end


def _cut(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    slots = list(range(robots))
    rng.shuffle(slots)
    at = rng.randrange(1, robots)
    healed_at_s = min(at_s + rng.choice((0.2, 2.0, 10.0)), end_at_s)
    return [
        kinds.Partition(at_s=at_s, kind="partition", islands=[slots[:at], slots[at:]]),
        kinds.Heal(at_s=healed_at_s, kind="heal"),
    ]


def _one_way(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    sender, receiver = rng.sample(range(robots), 2)
    return [kinds.OneWay(at_s=at_s, kind="one_way", sender=sender, receiver=receiver)]


def _crash(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    robot, back_at_s = rng.randrange(robots), min(at_s + rng.uniform(0.05, 15.0), end_at_s)
    disk = rng.choice(("kept", "kept", "torn", "torn", "lost", "rolled_back"))
    restart = {"at_s": back_at_s, "kind": "restart", "robot": robot, "disk": disk}
    return [
        kinds.Crash(at_s=at_s, kind="crash", robot=robot),
        kinds.Restart.model_validate(restart),
    ]


def _freeze(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    for_s = rng.choice((0.05, 0.3, 1.0, 8.0))
    return [kinds.Freeze(at_s=at_s, kind="freeze", robot=rng.randrange(robots), for_s=for_s)]


def _rate(make: Callable[[float, float], Fault], most: float) -> Draw:
    def draw(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
        over_at_s = min(at_s + rng.uniform(1.0, 15.0), end_at_s)
        return [make(at_s, rng.choice((0.01, 0.1, most))), make(over_at_s, 0.0)]

    return draw


def _bus_off(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    for_s, robot = rng.uniform(0.01, 4.0), rng.randrange(robots)
    return [kinds.BusOff(at_s=at_s, kind="bus_off", robot=robot, for_s=for_s)]


def _babble(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    """Of any priority, above and below a stop; longer than a policy waits before it continues."""
    priority, for_s = rng.randrange(8), rng.uniform(0.1, 8.0)
    identifier = rng.choice((None, priority << 26 | BABBLING, BABBLING, 0))
    return [
        kinds.Babble(
            at_s=at_s, kind="babble", priority=priority, identifier=identifier, for_s=for_s
        )
    ]


def _clone(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    wins = rng.random() < 0.7
    return [kinds.Clone(at_s=at_s, kind="clone", robot=rng.randrange(robots), wins=wins)]


def _drift(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    ppm = rng.choice((-500.0, 500.0, -5000.0, 5000.0))
    return [kinds.Drift(at_s=at_s, kind="drift", robot=rng.randrange(robots), ppm=ppm)]


def _jump(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    robot, by_s = rng.randrange(robots), rng.choice((-1.0, -0.05, 0.05, 0.4, 5.0, 3600.0))
    return [kinds.ClockJump(at_s=at_s, kind="clock_jump", robot=robot, by_s=by_s)]


def _crash_working(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    robot, for_s = rng.randrange(robots), rng.uniform(0.05, max(0.1, end_at_s - at_s - 10.0))
    disk = rng.choice(("kept", "torn", "lost", "rolled_back"))
    table = {"at_s": at_s, "kind": "crash_working", "robot": robot, "for_s": for_s, "disk": disk}
    return [kinds.CrashWorking.model_validate(table)]


def _join(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    return [kinds.Join(at_s=at_s, kind="join", robot=rng.randrange(robots))]


def _box(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    x_m, y_m = rng.uniform(-YARD_M[0], YARD_M[0]), rng.uniform(-YARD_M[1], YARD_M[1])
    size_m, for_s = rng.uniform(0.4, 1.5), min(rng.uniform(1.0, 15.0), end_at_s - at_s)
    return [kinds.Box(at_s=at_s, kind="box", x_m=x_m, y_m=y_m, size_m=size_m, for_s=for_s)]


def _route(rng: Random) -> list[tuple[float, float]]:
    """From one end of the yard to the other, with up to three bends; back and forth half the time."""
    width_m, height_m = YARD_M
    way = [(rng.uniform(-width_m, width_m), rng.uniform(-height_m, height_m)) for _ in range(4)]
    way = way[: rng.randrange(2, 5)]
    return way + way[-2::-1] if rng.random() < 0.5 else way


def _person(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    table = {"at_s": at_s, "kind": "person", "route": _route(rng)}
    return [kinds.Person.model_validate(table | {"speed_m_s": rng.uniform(0.5, 2.0)})]


def _vehicle(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    table = {"at_s": at_s, "kind": "vehicle", "route": _route(rng)}
    return [kinds.PassingVehicle.model_validate(table | {"speed_m_s": rng.uniform(1.0, 5.0)})]


def _push(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    dx_m, dy_m = rng.uniform(-4.0, 4.0), rng.uniform(-4.0, 4.0)
    robot = rng.randrange(robots)
    return [kinds.Pushed(at_s=at_s, kind="pushed", robot=robot, dx_m=dx_m, dy_m=dy_m)]


def _haste(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    """A person resets or starts one machine although something still holds it: it must refuse."""
    table = {"at_s": at_s, "kind": "order", "robot": rng.randrange(robots)}
    order = rng.choice(("manual_reset", "manual_reset", "start"))
    return [kinds.Order.model_validate(table | {"order": order})]


def _blind(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    for_s = min(rng.choice((0.05, 0.3, 2.0, 8.0)), end_at_s - at_s)
    return [kinds.Blind(at_s=at_s, kind="blind", robot=rng.randrange(robots), for_s=for_s)]


def _frozen(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    for_s = min(rng.choice((0.1, 0.5, 3.0, 8.0)), end_at_s - at_s)
    return [kinds.Frozen(at_s=at_s, kind="frozen", robot=rng.randrange(robots), for_s=for_s)]


def _hung_fixes(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    for_s, every_s = min(rng.choice((0.5, 3.0, 8.0)), end_at_s - at_s), rng.choice((0.1, 0.2))
    robot, share = rng.randrange(robots), rng.choice((0.3, 1.0))
    fault = {"at_s": at_s, "kind": "hung_fixes", "robot": robot, "for_s": for_s}
    return [kinds.HungFixes.model_validate(fault | {"every_s": every_s, "share": share})]


def _jumped(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    """Further than wheels can drive in a control period, or turned by more than they can turn."""
    angle_rad, far_m = rng.uniform(0.0, 2 * pi), rng.choice((1.0, 3.0, 10.0, 100.0))
    turn_rad = rng.choice((0.0, 0.0, pi, -1.5))
    robot, for_s = rng.randrange(robots), min(rng.choice((0.3, 2.0, 8.0)), end_at_s - at_s)
    fault = {"at_s": at_s, "kind": "jumped", "robot": robot, "for_s": for_s, "turn_rad": turn_rad}
    where = {"dx_m": far_m * cos(angle_rad), "dy_m": far_m * sin(angle_rad)}
    return [kinds.Jumped.model_validate(fault | where)]


def _drifting(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    angle_rad, speed_m_s = rng.uniform(0.0, 2 * pi), rng.choice((0.05, 0.3, 1.0))
    robot, for_s = rng.randrange(robots), min(rng.choice((1.0, 4.0, 10.0)), end_at_s - at_s)
    fault = {"at_s": at_s, "kind": "drifting", "robot": robot, "for_s": for_s}
    drift = {"vx_m_s": speed_m_s * cos(angle_rad), "vy_m_s": speed_m_s * sin(angle_rad)}
    return [kinds.Drifting.model_validate(fault | drift)]


def _deaf_wheels(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    robot, for_s = rng.randrange(robots), min(rng.choice((0.1, 1.0, 5.0)), end_at_s - at_s)
    return [kinds.DeafWheels(at_s=at_s, kind="deaf_wheels", robot=robot, for_s=for_s)]


def _slipping(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    slip, robot = rng.choice((0.05, 0.1, 0.3)), rng.randrange(robots)
    for_s = min(rng.uniform(1.0, 15.0), end_at_s - at_s)
    return [kinds.Slipping(at_s=at_s, kind="slipping", robot=robot, slip=slip, for_s=for_s)]


def _stuck_implement(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    robot, for_s = rng.randrange(robots), min(rng.choice((0.5, 3.0, 15.0, 30.0)), end_at_s - at_s)
    return [kinds.StuckImplement(at_s=at_s, kind="stuck_implement", robot=robot, for_s=for_s)]


def _late(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    """Later than the age limit of a position; smaller delays affect only the accuracy."""
    by_s, for_s = rng.choice((0.15, 0.5, 2.0)), min(rng.uniform(0.5, 8.0), end_at_s - at_s)
    robot = rng.randrange(robots)
    return [kinds.Late(at_s=at_s, kind="late", robot=robot, by_s=by_s, for_s=for_s)]


def _no_rays(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    robot, for_s = rng.randrange(robots), min(rng.choice((0.05, 0.3, 2.0, 8.0)), end_at_s - at_s)
    return [kinds.NoRays(at_s=at_s, kind="no_rays", robot=robot, for_s=for_s)]


def _stuck_rays(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    robot, for_s = rng.randrange(robots), min(rng.choice((0.3, 2.0, 8.0)), end_at_s - at_s)
    return [kinds.StuckRays(at_s=at_s, kind="stuck_rays", robot=robot, for_s=for_s)]


def _noisy_rays(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    robot, for_s = rng.randrange(robots), min(rng.uniform(1.0, 10.0), end_at_s - at_s)
    spread_m, missing = rng.choice((0.01, 0.05, 0.2)), rng.choice((0.0, 0.05, 0.3))
    return [kinds.NoisyRays(at_s=at_s, kind="noisy_rays", robot=robot, spread_m=spread_m,
                            missing=missing, for_s=for_s)]  # fmt: skip


def _disk_full(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    robot, for_s = rng.randrange(robots), min(rng.uniform(0.5, 8.0), end_at_s - at_s)
    return [kinds.DiskFull(at_s=at_s, kind="disk_full", robot=robot, for_s=for_s)]


def _press(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    return [kinds.Estop(at_s=at_s, kind="estop", robot=rng.randrange(robots))]


def _buttons(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    for_s = rng.uniform(0.5, 5.0)
    # The buttons send "permit" for a while before and after.
    at_s = max(0.0, min(at_s, end_at_s - for_s - 6.5))
    lost, unheard, count = rng.randrange(2), rng.random() < 0.3, rng.randint(2, 4)
    return [kinds.Buttons(at_s=round(at_s, 3), kind="buttons", buttons=count, for_s=for_s,
                          lost=lost, unheard=unheard)]  # fmt: skip


def _used_stop(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    every_s, names = rng.choice((0.005, 0.005, 0.1, 1.0)), rng.randint(1, 8)
    for_s = rng.uniform(0.05, 1.0) + rng.choice((0.0, 2.5 * every_s))
    at_s = max(0.0, min(at_s, end_at_s - for_s - 1.0))
    return [kinds.UsedStop(at_s=round(at_s, 3), kind="used_stop", names=names, for_s=for_s,
                           every_s=every_s)]  # fmt: skip


def _foreign(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    claims, for_s = rng.random() < 0.7, min(rng.uniform(0.5, 10.0), end_at_s - at_s)
    return [kinds.Foreign(at_s=at_s, kind="foreign", claims=claims, for_s=for_s)]


def _twin(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    robot, same = rng.randrange(robots), rng.random() < 0.4
    for_s = min(rng.choice((0.3, 2.0, 8.0)), end_at_s - at_s)
    return [kinds.Twin(at_s=at_s, kind="twin", robot=robot, same_address=same, for_s=for_s)]


def _nonsense(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    """A robot that has lost every address tries again after 5 s, the second time after 10 s."""
    at_s = round(max(0.0, min(at_s, end_at_s - NONSENSE_S)), 3)
    table = {"at_s": at_s, "kind": "nonsense", "robot": rng.randrange(robots)}
    table |= {"what": rng.choice(("field", "work", "claims")), "same_slot": rng.random() < 0.3}
    return [kinds.Nonsense.model_validate(table | {"for_s": rng.uniform(0.2, NONSENSE_S)})]


def _forger(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    """Without a key."""
    position = rng.choice(("outside", "replaying"))
    for_s, robot = min(rng.uniform(1.0, 20.0), end_at_s - at_s), rng.randrange(robots)
    table = {"at_s": at_s, "kind": "forger", "robot": robot, "for_s": for_s, "position": position}
    return [kinds.Forger.model_validate(table)]


def _thief(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    """With the keys of the last robot. Its owner revokes it in the middle; no frame may be lost then."""
    at_s = round(min(at_s, end_at_s - THEFT_S), 3)
    table = {"at_s": at_s, "kind": "forger", "robot": robots - 1, "position": "inside"}
    return [kinds.Forger.model_validate(table | {"for_s": rng.uniform(THEFT_S, end_at_s - at_s)})]


def before_revocation(rng: Random, theft: kinds.Forger, robots: int) -> list[Fault]:
    """Robots miss frames of a thief, so that they hear its lies from honest ones, and one restarts.

    All is over when the owner gives the others new keys."""
    revoked_at_s = theft.at_s + theft.for_s * REVOKED_AFTER
    rate = rng.choice((0.01, 0.02, 0.03))
    faults: list[Fault] = [
        kinds.Omission(at_s=round(theft.at_s + 0.5, 3), kind="omission", rate=rate),
        kinds.Omission(at_s=round(revoked_at_s - 1.0, 3), kind="omission", rate=0.0),
    ]
    honest = [slot for slot in range(robots) if slot != theft.robot]
    last_at_s = revoked_at_s - BOOTED_S  # it has joined when it gets the new keys
    if rng.random() < 0.7 and last_at_s > theft.at_s + 1.0:
        robot, back_at_s = rng.choice(honest), rng.uniform(theft.at_s + 1.0, last_at_s)
        off_at_s = max(theft.at_s, back_at_s - rng.uniform(0.3, 1.5))
        faults += [
            kinds.Crash(at_s=round(off_at_s, 3), kind="crash", robot=robot),
            kinds.Restart(at_s=round(back_at_s, 3), kind="restart", robot=robot),
        ]
    return faults


def _release(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    return [kinds.Reset(at_s=at_s, kind="reset")]


def _blackout(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    """All robots lose power within 0.3 s, so no running robot keeps the state of the fleet."""
    faults: list[Fault] = []
    for robot in range(robots):
        off_at_s = round(at_s + rng.uniform(0.0, 0.3), 3)
        back_at_s = min(at_s + rng.uniform(0.5, 8.0), end_at_s)
        table = {"at_s": back_at_s, "kind": "restart", "robot": robot}
        disk = rng.choice(("kept", "torn"))
        faults += [
            kinds.Crash(at_s=off_at_s, kind="crash", robot=robot),
            kinds.Restart.model_validate(table | {"disk": disk}),
        ]
    return faults


def _burst(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    """A contactor opens because a person presses: each receiver misses copies of the stop.

    At most half of the copies are lost: 20 copies are sent in 100 ms, and at least one of them
    arrives for all but one in a million presses.
    """
    begin_at_s, over_at_s = (
        at_s - rng.uniform(0.0, 0.1),
        min(at_s + rng.uniform(0.1, 0.5), end_at_s),
    )
    rate = rng.choice((0.2, 0.35, 0.5))
    return [
        kinds.Omission(at_s=round(begin_at_s, 3), kind="omission", rate=rate),
        kinds.Estop(at_s=at_s, kind="estop", robot=rng.randrange(robots)),
        kinds.Omission(at_s=over_at_s, kind="omission", rate=0.0),
    ]


def _split(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    """Two islands for long enough that both continue to work, if the policy allows it."""
    cut = _cut(rng, robots, at_s, end_at_s)[0]
    healed_at_s = min(at_s + rng.uniform(3.0, 25.0), end_at_s)
    return [cut, kinds.Heal(at_s=healed_at_s, kind="heal")]


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
    "person": _person,
    "vehicle": _vehicle,
    "blind": _blind,
    "frozen": _frozen,
    "hung_fixes": _hung_fixes,
    "jumped": _jumped,
    "drifting": _drifting,
    "deaf_wheels": _deaf_wheels,
    "slipping": _slipping,
    "late": _late,
    "no_rays": _no_rays,
    "stuck_rays": _stuck_rays,
    "noisy_rays": _noisy_rays,
    "stuck_implement": _stuck_implement,
    "disk_full": _disk_full,
    "estop": _press,
    "reset": _release,
    "haste": _haste,
    "buttons": _buttons,
    "used_stop": _used_stop,
    "foreign": _foreign,
    "twin": _twin,
    "nonsense": _nonsense,
    "forger": _forger,
    "thief": _thief,
}


def _stalled(rng: Random, robots: int, at_s: float, end_at_s: float) -> list[Fault]:
    """A lost place, and a process that gets no computing time as it begins or ends: other work of its
    computer. A jump is further than a body drives and brakes unseen, so that it can be told from that.
    """
    (fault,) = DRAWS[rng.choice(("blind", "frozen", "jumped", "late"))](rng, robots, at_s, end_at_s)
    assert isinstance(fault, kinds.Blind | kinds.Frozen | kinds.Jumped | kinds.Late)
    if isinstance(fault, kinds.Jumped):
        far = {"dx_m": FAR * fault.dx_m, "dy_m": FAR * fault.dy_m}
        fault = fault.model_copy(update=far)
    for_s, edge_at_s = rng.uniform(*STALLS_S), fault.at_s + rng.choice((0.0, fault.for_s))
    stall_at_s = round(max(edge_at_s - rng.uniform(0.0, for_s), 0.0), 3)
    return [
        fault,
        kinds.Freeze(at_s=stall_at_s, kind="freeze", robot=fault.robot, for_s=round(for_s, 3)),
    ]


CLUSTERS: dict[str, Draw] = {
    "blackout": _blackout,
    "burst": _burst,
    "split": _split,
    "stalled": _stalled,
}
