"""Rounds of agreement: how robots that block each other agree on a joint plan.

A robot that makes no progress calls a round by announcing the next number. Every robot that receives
it stops. Each step of the round has a message, which a robot repeats until the round is over:

    PLACE  the sender's position and goal. Only a robot itself sends its place, so all robots that
           have received every place know the same, regardless of lost frames.
    BODY   a node that is blocked by something that is not a member of the fleet.
    PLAN   the digest of the joint plan that the sender computed from the above (`agent/mapf/lacam.py`)
           and from the positions of silent members (`agent/navigation/silent_robots.py`). No robot
           moves before all moving robots have the same digest.
    AT     the sender's progress on its route. A robot drives to a node when the robots before it
           there have gone on. The plan fixes the order; each robot drives at its own time.

A round is also the contract by which an idle or parked robot clears a way. The call is the request.
PLACE grants it, or refuses it with a reason; then its place is an obstacle for all. The plan brings
the robot back to where it stood. A round without progress for `PATIENCE_US` is void and is called
again without members that fell silent meanwhile, so no robot is parked for ever. A member that never
knew its place cannot tell it, so members without a place are waited for only `PLACELESS_US`.
"""

from collections.abc import Iterable, Mapping, Set
from enum import Enum
from math import hypot
from typing import NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from agent.interface.config import MS, S
from agent.interface.geometry import Point
from agent.mapf.agreement_phase import CALM_US, AgreementPhase, after, ahead
from agent.mapf.lacam import JointPlan, Precedence, planned, search
from agent.mapf.lattice import FINE, Lattice, components
from agent.mapf.linear_assignment import assigned
from protocol.frames.agreement_frames import AgreementKind, AgreementMessage, AgreementReply
from protocol.state_machine import StateMachine, matrix

STANDS_M_S = 0.06  # slower than this is standing: what POSE can tell apart from nothing
PATIENCE_US = 10 * S  # longer than a sync (2 s) or a protective stop that ends (2 s) and the way on
PLACELESS_US = 2 * S  # for a member that knew its place before: 20 words, 30 % of them lost
HURRY_US = 100 * MS  # a word that others wait for is repeated this often,
# A step on the route: four words, so that 1 % miss all of them where 30 % are lost.
HURRIED_US = 350 * MS
KEPT_M = 0.15  # kept between bodies by avoidance; a node nearer to a body cannot be reached
SEEN_MAX = 6  # nodes that one robot may name: what a box and a body cover
SEATS = 3  # pitches round a place in which a node is looked for
AFAR = 1 << 24  # cost of a node that is none of ours; more than all squares of a map


class JointPlanEvent(Enum):
    """What moves a round of agreement from one phase to the next."""

    BEGUN = "a round with a later number was called, by us or by another robot"
    GATHERED = "the place of every expected robot is known"
    AGREED = "every robot that is to move has the same plan"
    ARRIVED = "every robot has reached the end of its route"
    WITHDRAWN = "we do not receive a robot that others receive, so we cannot agree with all"


FREE, GATHER, AGREE, GO = AgreementPhase
stay = None

# fmt: off
JOINT_PLAN_TABLE = matrix(
    JointPlanEvent,
    # phase   BEGUN   GATHERED  AGREED  ARRIVED  WITHDRAWN
    (FREE,    GATHER, stay,     stay,   stay,    stay),
    (GATHER,  stay,   AGREE,    stay,   stay,    stay),
    (AGREE,   GATHER, stay,     GO,     stay,    FREE),
    (GO,      GATHER, stay,     stay,   FREE,    stay),
)
# fmt: on


class Participant(NamedTuple):
    """What one robot sent about itself in this round."""

    node: int
    goal: int
    answer: AgreementReply
    detail: int


class JointPlanAgreement:
    """One robot's part in all rounds: received messages and the time go in, messages come out."""

    def __init__(self, slot: int, lattice: Lattice, radius_m: float) -> None:
        self.slot, self.lattice, self.radius_m = slot, lattice, radius_m
        self.round = 0
        self.machine = StateMachine("joint plan", JOINT_PLAN_TABLE, FREE)
        self.plan: JointPlan | None = None
        self.order: tuple[int, ...] = ()  # slots of the plan's robots
        self.called = 0  # rounds that we called
        self.rounds = 0  # rounds that we took part in
        self.unsolved = 0  # rounds without a plan, because no robot could be brought to its goal
        self._places: dict[int, Participant] = {}
        self._things: set[int] = set()  # nodes blocked by something that is not a member
        self._seen: list[int] = []  # blocked nodes that we have sent
        self._used: object = None  # bodies and blocked nodes that the plan avoids
        self._digests: dict[int, int] = {}
        self._reached: dict[int, int] = {}  # index of the node reached; -1: not on the route yet
        self._phase_at_us = 0  # of this phase, or of our own last progress in it
        self._progress_at_us = 0  # of anybody's
        self._said_at_us: dict[AgreementKind, int] = {}

    # ---------------------------------------------------------------- facts in

    def call(self, now_us: int) -> None:
        """Call a new round because we make no progress."""
        self.called += 1
        self._begin(after(self.round), now_us)

    def on_message(self, slot: int, m: AgreementMessage, now_us: int) -> None:
        """Handle an agreement message of another robot; one of a round that is over is ignored."""
        later = ahead(m.round, self.round, fresh=self.rounds == 0)
        if later is None:
            return  # a round that is over
        if later:
            self._begin(m.round, now_us)
        if m.say == AgreementKind.PLACE:
            if m.first < len(self.lattice) and m.second < len(self.lattice):
                place = Participant(m.first, m.second, AgreementReply(m.answer), m.detail)
                self._places.setdefault(slot, place)
        elif m.say == AgreementKind.BODY:
            if m.first < len(self.lattice):
                self._things.add(m.first)
        elif m.say == AgreementKind.PLAN:
            self._digests[slot] = m.first | m.second << 16
        elif m.first - 1 > self._reached.get(slot, -1):
            self._reached[slot] = m.first - 1
            self._progress_at_us = now_us

    def _begin(self, number: int, now_us: int) -> None:
        self.round, self.plan = number, None
        self.rounds += 1
        self._fire(JointPlanEvent.BEGUN, now_us)
        self._places.clear()
        self._things.clear()
        self._seen, self._used = [], None
        self._digests.clear()
        self._reached.clear()
        self._said_at_us.clear()
        self._progress_at_us = now_us

    def _fire(self, event: JointPlanEvent, now_us: int) -> None:
        self.machine.fire(event)
        self._phase_at_us = now_us

    # ---------------------------------------------------------------- what is to be done

    @property
    def phase(self) -> AgreementPhase:
        """How far the round is, or FREE if there is none."""
        return self.machine.state

    @property
    def bound(self) -> bool:
        """Whether a round controls us: we stand still or drive our route."""
        return self.phase is not FREE and not self._arrived

    @property
    def waiting(self) -> bool:
        """Whether all robots must agree before any robot moves."""
        return self.phase in (GATHER, AGREE)

    @property
    def route(self) -> tuple[int, ...]:
        """Our nodes, while there is a plan."""
        assert self.plan is not None
        return self.plan.routes[self.order.index(self.slot)]

    @property
    def index(self) -> int:
        """The node of our route that we have reached; -1: not yet the first."""
        return self._reached.get(self.slot, -1)

    @property
    def permitted(self) -> int:
        """The node of our route that we may drive to. First every robot drives onto its own node."""
        assert self.plan is not None
        reached = [self._reached.get(slot, -1) for slot in self.order]
        if min(reached) < 0:
            return 0
        return self.plan.permitted(self.order.index(self.slot), reached)

    def reach(self, index: int, now_us: int) -> None:
        """We are at that node of our route now."""
        if index > self.index:
            self._reached[self.slot] = index
            self._phase_at_us = now_us
            self._said_at_us.pop(AgreementKind.AT, None)

    @property
    def _arrived(self) -> bool:
        return self.plan is not None and self.index >= len(self.route) - 1

    @property
    def _over(self) -> bool:
        assert self.plan is not None
        return all(
            self._reached.get(slot, -1) >= len(route) - 1
            for slot, route in zip(self.order, self.plan.routes, strict=True)
        )

    def on_tick(
        self,
        at: Point,
        speed_m_s: float,
        goal: Point | None,
        answer: AgreementReply,
        peers: Iterable[int],
        dead: Mapping[int, Point],
        things: Iterable[Point],
        now_us: int,
        placeless: Set[int] = frozenset(),
    ) -> None:
        """One control period. `peers`: the expected participants; `dead`: bodies that do not take part;
        `things`: what else we see standing; `placeless`: peers that do not know their place."""
        if self.phase is GATHER:
            if self.slot not in self._places and speed_m_s < STANDS_M_S:
                self._take_place(at, goal, answer, things)
            expected = {self.slot, *peers}
            if now_us - self._phase_at_us > PLACELESS_US:
                expected -= placeless
            if self._places.keys() >= expected:
                self._fire(JointPlanEvent.GATHERED, now_us)
        if self.phase is AGREE:
            self._compute(dead)
            if self._plans_agree:
                self._fire(JointPlanEvent.AGREED, now_us)
        if self.phase is GO and self._over:
            self._fire(JointPlanEvent.ARRIVED, now_us)
        wait_for_us = PATIENCE_US if self.phase is GO else PATIENCE_US // 2
        if self.bound and now_us - max(self._phase_at_us, self._progress_at_us) > wait_for_us:
            if self.phase is AGREE and self._deaf:  # the others have done what they did
                self._fire(JointPlanEvent.WITHDRAWN, now_us)
            else:
                self.call(now_us)

    def _take_place(
        self, at: Point, goal: Point | None, answer: AgreementReply, things: Iterable[Point]
    ) -> None:
        """Our own place in this round; it is sent until the round is over and never changes."""
        node, detail = self.lattice.encode(at)
        wants = node if goal is None or answer else self.lattice.nearest(goal)
        self._places[self.slot] = Participant(node, wants, answer, detail)
        self._see(things)

    @property
    def _plans_agree(self) -> bool:
        """Whether every robot that is to move has sent the digest of our plan."""
        own = self._digests[self.slot]
        movers = [s for s in self.order if self._places[s].answer is AgreementReply.GRANT]
        return all(self._digests.get(slot) == own for slot in movers)

    @property
    def _deaf(self) -> bool:
        place = self._places.get(self.slot)
        return place is not None and place.answer is AgreementReply.DEAF

    def outgoing(self, now_us: int) -> list[AgreementMessage]:
        """What is due with this beat."""
        words: list[AgreementMessage] = []
        place = self._places.get(self.slot)
        if place is not None and self._due(AgreementKind.PLACE, self.phase is GATHER, now_us):
            words.append(
                AgreementMessage(
                    self.round,
                    AgreementKind.PLACE,
                    place.answer,
                    place.node,
                    place.goal,
                    place.detail,
                )
            )
        if self._seen and self._due(AgreementKind.BODY, self.phase is not GO, now_us):
            words += [
                AgreementMessage(self.round, AgreementKind.BODY, 0, node, 0, 0)
                for node in self._seen
            ]
        digest = self._digests.get(self.slot)
        if digest is not None and self._due(AgreementKind.PLAN, self.phase is AGREE, now_us):
            words.append(
                AgreementMessage(
                    self.round, AgreementKind.PLAN, 0, digest & 0xFFFF, digest >> 16, 0
                )
            )
        hurried = self.phase is GO and now_us - self._phase_at_us < HURRIED_US
        if self.index >= 0 and self._due(AgreementKind.AT, hurried, now_us):
            words.append(AgreementMessage(self.round, AgreementKind.AT, 0, self.index + 1, 0, 0))
        return words

    def _due(self, say: AgreementKind, hurried: bool, now_us: int) -> bool:
        last_at_us = self._said_at_us.get(say)
        if last_at_us is not None and now_us - last_at_us < (HURRY_US if hurried else CALM_US):
            return False
        self._said_at_us[say] = now_us
        return True

    # ---------------------------------------------------------------- the plan

    def _see(self, things: Iterable[Point]) -> None:
        """Nodes that cannot be driven to for what we see; the nearest of a crowd."""
        own, standing = self._places[self.slot].node, list(things)
        reach_m = hypot(self.radius_m, self.lattice.pitch_m / 2)  # also from the middle of an edge
        nodes = {int(n) for thing in standing for n in self.lattice.within(thing, reach_m)} - {own}
        beside_m = self.radius_m + KEPT_M
        nodes |= {own for thing in standing if self.lattice.distance_m(own, thing) < beside_m}
        gap = self.lattice.points - self.lattice.points[own]
        near = sorted(nodes, key=lambda n: (float((gap[n] ** 2).sum()), n))
        self._seen = near[:SEEN_MAX]
        self._things.update(self._seen)

    def _compute(self, dead: Mapping[int, Point]) -> None:
        """The joint plan of all robots that have sent their place.

        It is a pure function of the received messages and is recomputed when more obstacles are
        received, so all robots end with the same plan."""
        bodies_used = {s: at for s, at in dead.items() if s not in self._places}
        used = bodies_used, frozenset(self._things)
        if used == self._used:
            return
        self._used = used
        self._reached.clear()
        self._said_at_us.pop(AgreementKind.PLAN, None)
        order = self.order = tuple(sorted(self._places))
        places = [self._places[slot] for slot in order]
        body_m = 2 * self.radius_m + KEPT_M
        bodies = [
            self.lattice.decode(p.node, p.detail)
            for p in places
            if p.answer is not AgreementReply.GRANT
        ]
        bodies += bodies_used.values()
        blocked = {int(n) for body in bodies for n in self.lattice.within(body, body_m)}
        blocked |= self._things
        movers = [k for k, p in enumerate(places) if p.answer is AgreementReply.GRANT]
        routes: list[tuple[int, ...]] = [(p.node,) for p in places]
        turns: list[tuple[Precedence | None, ...]] = [(None,) for _ in places]
        self.plan = JointPlan(tuple(routes), tuple(turns))
        found = plan_of(
            self.lattice, tuple(places[k] for k in movers), tuple(sorted(blocked)), self.round
        )
        if found is None:
            self.unsolved += 1
        else:
            for k, route, turn in zip(movers, found.routes, found.turns, strict=True):
                routes[k] = route
                turns[k] = tuple(t and t._replace(robot=movers[t.robot]) for t in turn)
            self.plan = JointPlan(tuple(routes), tuple(turns))
        for k, p in enumerate(places):
            if p.answer is not AgreementReply.GRANT or found is None:  # it stays where it is
                self._reached[order[k]] = len(routes[k]) - 1
        self._digests[self.slot] = crc32(repr((order, self.plan)).encode())


_KEPT: dict[object, tuple[Lattice, JointPlan | None]] = {}  # a lattice kept keeps its id


def plan_of(
    lattice: Lattice, places: tuple[Participant, ...], blocked: tuple[int, ...], salt: int
) -> JointPlan | None:
    """The joint plan of these robots among these blocked nodes; None if there is none.

    `salt` varies how ties are broken. The last plan is kept, because robots that share a process
    compute the same one after the other.
    """
    key = (id(lattice), places, blocked, salt)
    if key not in _KEPT:
        _KEPT.clear()
        _KEPT[key] = lattice, _plan_of(lattice, places, blocked, salt)
    return _KEPT[key][1]


def _plan_of(
    lattice: Lattice, places: tuple[Participant, ...], blocked: tuple[int, ...], salt: int
) -> JointPlan | None:
    if not places:
        return JointPlan((), ())
    near = lattice.near.copy()
    if blocked:
        near[np.isin(near, blocked)] = -1
        near[list(blocked)] = -1
    starts = seats(
        lattice, [lattice.decode(p.node, p.detail) for p in places], [1] * len(places), blocked
    )
    if starts is None:
        return None
    wishes = [
        lattice.decode(p.node, p.detail) if p.goal == p.node else lattice.point(p.goal)
        for p in places
    ]
    # A robot with a goal elsewhere gets its own node before a robot that only stands there.
    weights = [1 if p.goal == p.node else 4 for p in places]
    component = components(near)
    goals = seats(lattice, wishes, weights, blocked)
    if goals is None:
        apart = [
            k for k, s in enumerate(starts)
            if not (component[_beside(lattice, wishes[k])] == component[s]).any()
        ]  # fmt: skip
    else:
        apart = [k for k, s in enumerate(starts) if component[goals[k]] != component[s]]
        for k in apart:
            goals[k] = starts[k]
    if goals is None or len(set(goals)) < len(goals):
        for k in apart:  # one that cannot come to its goal makes room for one that can
            wishes[k], weights[k] = lattice.decode(places[k].node, places[k].detail), 1
        within = component[None, :] == component[starts][:, None]
        goals = seats(lattice, wishes, weights, blocked, within)
        if goals is None:
            return None
    groups: dict[int, list[int]] = {}  # of robots that something keeps apart
    for k, s in enumerate(starts):
        groups.setdefault(int(component[s]), []).append(k)
    plans = [
        (group, _plan_of_group(near, starts, goals, places, group, salt))
        for group in groups.values()
    ]
    if all(plan is None for _, plan in plans):
        return None
    routes: list[tuple[int, ...]] = [(s,) for s in starts]  # those without a plan stay
    turns: list[tuple[Precedence | None, ...]] = [(None,) for _ in starts]
    for group, plan in plans:
        if plan is None:
            continue
        for k, route, turn in zip(group, plan.routes, plan.turns, strict=True):
            routes[k] = route
            turns[k] = tuple(t and t._replace(robot=group[t.robot]) for t in turn)
    return JointPlan(tuple(routes), tuple(turns))


def _plan_of_group(
    near: NDArray[np.int32],
    all_starts: list[int],
    all_goals: list[int],
    places: tuple[Participant, ...],
    group: list[int],
    salt: int,
) -> JointPlan | None:
    """The joint plan of some of the robots, `group`; None if there is none."""
    starts, goals = [all_starts[k] for k in group], [all_goals[k] for k in group]
    found = planned(near, starts, goals, salt)
    # In a ring nobody can be overtaken and come back behind. Robots without a goal then end elsewhere.
    wanted = [
        i for i, k in enumerate(group) if places[k].goal != places[k].node and goals[i] != starts[i]
    ]
    if found is None and wanted and len(wanted) < len(group):
        steps = search(near, starts, goals, [0.0] * len(group), salt, wanted=wanted)
        found = None if steps is None else planned(near, starts, steps[-1].tolist(), salt)
    return found


def seats(
    lattice: Lattice,
    at: list[Point],
    weights: list[int],
    blocked: Iterable[int],
    within: NDArray[np.bool_] | None = None,
) -> list[int] | None:
    """A separate node for each place, with the least total distance; None: too few nodes.

    `at` are places in metres (x, y); `weights` count for distances from them. Squared distances are
    used, which keeps the order of robots in a row. All are whole numbers, so that no two machines
    round differently. `within`: (places, nodes of the lattice), False where a place gets no node.
    """
    near = [_beside(lattice, point) for point in at]
    taken = np.zeros(len(lattice), dtype=np.bool_)
    taken[list(blocked)] = True
    nodes = np.unique(np.concatenate(near))
    nodes = nodes[~taken[nodes]]
    if len(nodes) < len(at):
        return None
    part_m = lattice.pitch_m / FINE
    cost = np.full((len(at), len(nodes)), AFAR, dtype=np.int64)
    for row, (point, own, weight) in enumerate(zip(at, near, weights, strict=True)):
        gaps = np.rint((lattice.points[nodes] - np.asarray(point)) / part_m).astype(np.int64)
        squares = (gaps * gaps).sum(axis=1)
        mine = np.isin(nodes, own)
        if within is not None:
            mine &= within[row, nodes]
        cost[row, mine] = weight * squares[mine]
    columns = assigned(cost)
    if (cost[np.arange(len(at)), columns] >= AFAR).any():
        return None
    return [int(nodes[c]) for c in columns]


def _beside(lattice: Lattice, at: Point) -> NDArray[np.intp]:
    """The nodes near a place that have a way to the nearest one."""
    near = lattice.within(at, SEATS * lattice.pitch_m)
    if not len(near):
        return near
    home = lattice.component[near[np.argmin(_squares(lattice, near, at))]]
    return near[lattice.component[near] == home]


def _squares(lattice: Lattice, nodes: NDArray[np.intp], at: Point) -> NDArray[np.float64]:
    gaps = lattice.points[nodes] - np.asarray(at)
    squares: NDArray[np.float64] = (gaps * gaps).sum(axis=1)
    return squares
