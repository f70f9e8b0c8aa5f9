"""ORCA: CPU time of what a robot runs, and of its kernels against RVO2 through pyrvo, to the same bits.

What every robot calls each control period is `HolonomicMotion.drive`; the fleet step and
`among_known` are kernels that no robot calls by themselves.

Circle: the example of the RVO2 library, 250 agents that change sides. Where pyrvo is not installed
only our own times are measured.
"""

import importlib
from collections.abc import Iterator
from importlib.metadata import version
from math import cos, pi, sin
from statistics import median
from time import process_time
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from agent.avoidance.orca import OrcaSolver
from agent.interface.config import CONTROL_PERIOD_US, NEIGHBOURS_MAX
from agent.interface.geometry import Point
from agent.interface.lifecycle import State
from agent.interface.mission import MotionRequest
from agent.interface.observation import Neighbour, Observation
from agent.motion.holonomic_motion import HolonomicMotion
from protocol.frames.fleet_frames import Pose
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.bench.figure import Figure
from tools.bench.kernels import agent_table as column
from tools.bench.kernels.orca_fleet import OrcaFleet

SEED = 20
AGENTS, CIRCLE_M = 250, 200.0
RANGE_M, HORIZON_S, RADIUS_M, SPEED_M_S, DT_S = 15.0, 10.0, 1.5, 2.0, 0.25  # of that example
BLOCK = 50  # steps, A B A B
# Blocks in a batch and calls in a block, for one robot; the quietest batch counts.
BATCH, CALLS = (9, 500)
REFERENCE_US = 14.2  # pyrvo's simulator of eleven, on the machine that the target is for
PEERS = 100
DRIVES = 100  # calls of one batch, of a robot
NUMBA = f"numba {numba.__version__}"


def pyrvo() -> Any:
    """The module, or None where it is not installed."""
    try:
        return importlib.import_module("pyrvo")
    except ImportError:
        return None


def figures(quick: bool) -> Iterator[Figure]:
    """What a whole robot takes, and kernels against pyrvo if that is installed."""
    rvo = pyrvo()
    yield from whole_robot(10 if quick else 40)
    yield from circle(rvo, 400 if quick else 1000)
    yield from one_robot(rvo, 6 if quick else 20)


def on_circle() -> NDArray[np.float32]:
    """Agents at equal distances on a circle, (agents, columns of `orca_kernel`), without a velocity
    that they want."""
    agents = np.zeros((AGENTS, column.AGENT_COLUMNS), dtype=np.float32)
    for k in range(AGENTS):
        angle = 2 * pi * k / AGENTS
        agents[k, column.X], agents[k, column.Y] = CIRCLE_M * cos(angle), CIRCLE_M * sin(angle)
    agents[:, column.RADIUS], agents[:, column.SPEED_MAX] = RADIUS_M, SPEED_M_S
    agents[:, column.RANGE], agents[:, column.NEIGHBOURS] = RANGE_M, NEIGHBOURS_MAX
    agents[:, column.HORIZON] = agents[:, column.WALL_HORIZON] = HORIZON_S
    return agents


def simulator(rvo: Any, dt_s: float, range_m: float, radius_m: float, speed_m_s: float,
              horizon_s: float, places: list[Point]) -> Any:  # fmt: skip
    """A pyrvo simulator with agents at these places, metres."""
    made = rvo.RVOSimulator()
    made.set_time_step(dt_s)
    made.set_agent_defaults(range_m, NEIGHBOURS_MAX, horizon_s, horizon_s, radius_m, speed_m_s)
    for place in places:
        made.add_agent(place)
    return made


def wish(agents: NDArray[np.float32], goals: NDArray[np.float32]) -> list[Point]:
    """Straight to the goals (n, 2): the velocities, m/s, are written into `agents` (n, columns),
    and returned for pyrvo."""
    to_goal = goals - agents[:, : column.Y + 1]
    far = np.maximum(np.hypot(to_goal[:, 0], to_goal[:, 1]), np.float32(1.0))
    agents[:, column.WANT_X : column.WANT_Y + 1] = to_goal / far[:, np.newaxis]
    return [(x, y) for x, y in agents[:, column.WANT_X : column.WANT_Y + 1].tolist()]


def unlike(agents: NDArray[np.float32], theirs: Any) -> int:
    """How many rows of `agents` (n, columns) are not, to the last bit, where and as fast as those
    of pyrvo."""
    rows = [(theirs.get_agent_position(k), theirs.get_agent_velocity(k)) for k in range(AGENTS)]
    state = np.array([(p.x, p.y, v.x, v.y) for p, v in rows], dtype=np.float32)
    ours = agents[:, [column.X, column.Y, column.VX, column.VY]]
    return int((ours.view(np.uint32) != state.view(np.uint32)).any(axis=1).sum())


def circle(rvo: Any, steps: int) -> Iterator[Figure]:
    """CPU time of all agents crossing a circle, against pyrvo if `rvo` is not None, and whether all
    bits are equal."""
    OrcaFleet(on_circle(), DT_S).step()  # compiles
    agents = on_circle()
    goals = -agents[:, : column.Y + 1].copy()
    fleet = OrcaFleet(agents, DT_S)
    places = [(x, y) for x, y in agents[:, : column.Y + 1].tolist()]
    peer = rvo and simulator(rvo, DT_S, RANGE_M, RADIUS_M, SPEED_M_S, HORIZON_S, places)
    ours_s = theirs_s = 0.0
    different = 0
    for _ in range(steps // BLOCK):  # a block of ours, then the same of theirs
        block: list[tuple[list[Point], NDArray[np.float32]]] = []
        for _ in range(BLOCK):
            wanted = wish(agents, goals)
            start = process_time()
            fleet.step()
            ours_s += process_time() - start
            block.append((wanted, agents.copy()))
        for wanted, after in block if rvo else ():
            for k, velocity in enumerate(wanted):
                peer.set_agent_pref_velocity(k, velocity)
            start = process_time()
            peer.do_step()
            theirs_s += process_time() - start
            different += unlike(after, peer)
    scope = f"circle of {AGENTS}, {steps} steps, neither side sets wishes inside the measurement"
    yield Figure("kernel: ORCA fleet step, absolute", ours_s / steps / AGENTS * 1e9, "ns/agent", "", None,
                 NUMBA, scope)  # fmt: skip
    if not rvo:
        return
    against = f"pyrvo {version('pyrvo')} do_step; {NUMBA}"
    ratio = ours_s / theirs_s
    yield Figure(
        "kernel: ORCA fleet step", ratio, "ratio", "<= 0.30", ratio <= 0.30, against, scope
    )
    yield Figure("kernel: ORCA states with other bits than pyrvo's", different, "", "= 0", different == 0,
                 against, f"places and velocities of {steps * AGENTS} agent steps, float32")  # fmt: skip


def whole_robot(batches: int) -> Iterator[Figure]:
    """The avoidance of a control period as `agent/peer/peer.py` asks for it, on the fences of a
    real field."""
    setting = FieldSetup(load("oxted"))
    motion = setting.parts(0).motion
    assert isinstance(motion, HolonomicMotion)
    rng = np.random.default_rng(SEED)
    x_m, y_m = setting.starts[0]
    here = Observation(x_m, y_m, 0.0, 1.0, 0.2)
    working = int(State.WORKING)
    neighbours = {
        slot: Neighbour(Pose(x_m + dx, y_m + dy, 0.2 * dx, 1.5, working, False, 0), 0)
        for slot, (dx, dy) in enumerate(rng.uniform(-15.0, 15.0, (PEERS, 2)).tolist(), start=1)
    }
    wish, now_us = MotionRequest(1.5, 0.3), 0
    found: list[float] = []
    for _ in range(batches + 1):  # the first one compiles
        start = process_time()
        for _ in range(DRIVES):
            now_us += 1_000
            motion.drive(here, wish, neighbours, now_us)
        found.append((process_time() - start) / DRIVES)
        now_us = 0
    cost_us = median(found[1:]) * 1e6
    share = cost_us / CONTROL_PERIOD_US
    scope = (
        f"Motion.drive on oxted, {PEERS} peers heard within 15 m, median of {batches} x {DRIVES}"
    )
    yield Figure("what a robot runs: avoidance of one control period", cost_us, "us", "", None,
                 NUMBA, scope)  # fmt: skip
    yield Figure("what a robot runs, of its control period", share, "ratio", "<= 0.02",
                 share <= 0.02, NUMBA, scope)  # fmt: skip


def one_robot(rvo: Any, batches: int) -> Iterator[Figure]:
    """What a robot does every control period, with a hundred peers known and ten that matter."""
    rng = np.random.default_rng(SEED)
    at = rng.uniform(-15.0, 15.0, (PEERS, 2))
    at = at[np.argsort(np.hypot(at[:, 0], at[:, 1]))]
    moving = rng.uniform(-1.0, 1.0, (PEERS, 2))
    robot = OrcaSolver(0.5, 1.5, 1.0, 4.0, 0.05, np.zeros((0, 4)))
    for slot, ((x, y), (vx, vy)) in enumerate(zip(at.tolist(), moving.tolist(), strict=True)):
        robot.know(slot, x, y, vx, vy, 0.5, 0.5, 0.0)
    here, own, wanted = (0.0, 0.0), (0.6, 0.1), (1.0, 0.2)
    near = [(x, y) for x, y in at[:NEIGHBOURS_MAX].tolist()]
    fast = [(vx, vy) for vx, vy in moving[:NEIGHBOURS_MAX].tolist()]
    peer = rvo and simulator(rvo, 0.05, 5.0, 0.5, 1.5, 4.0, [here, *near])

    def theirs() -> object:
        for k, (place, velocity) in enumerate(zip(near, fast, strict=True)):
            peer.set_agent_position(k + 1, place)
            peer.set_agent_velocity(k + 1, velocity)
        peer.set_agent_position(0, here)
        peer.set_agent_velocity(0, own)
        peer.set_agent_pref_velocity(0, wanted)
        peer.do_step()
        velocity = peer.get_agent_velocity(0)
        return velocity.x, velocity.y

    robot.among_known(here, own, wanted, 0.0)
    found: list[tuple[float, float]] = []  # of each batch: median seconds of ours, and of theirs
    for _ in range(batches):
        ours_s, theirs_s = [], []
        for _ in range(BATCH):  # A B A B
            start = process_time()
            for _ in range(CALLS):
                robot.among_known(here, own, wanted, 0.0)
            ours_s.append((process_time() - start) / CALLS)
            start = process_time()
            for _ in range(CALLS // 10 if rvo else 0):
                theirs()
            theirs_s.append((process_time() - start) / (CALLS // 10))
        found.append((median(ours_s), median(theirs_s)))
    cost_us, theirs_us = (min(costs) * 1e6 for costs in zip(*found, strict=True))
    scope = f"{PEERS} peers known, the nearest {NEIGHBOURS_MAX} within 5 m count; all of the Python"
    beside = (
        f"; pyrvo took {theirs_us:.1f} us, {REFERENCE_US} on the reference machine" if rvo else ""
    )
    yield Figure("kernel: one robot's ORCA, absolute", cost_us, "us", "<= 1.5", cost_us <= 1.5,
                 NUMBA, scope + beside)  # fmt: skip
    if rvo:
        ratio = median(ours / theirs for ours, theirs in found)
        against = (
            f"pyrvo {version('pyrvo')}, a simulator of the {NEIGHBOURS_MAX} nearest and itself"
        )
        yield Figure("kernel: one robot's ORCA", ratio, "ratio", "<= 0.10", ratio <= 0.10,
                     f"{against}; {NUMBA}", f"{scope}; set states, step, read")  # fmt: skip
