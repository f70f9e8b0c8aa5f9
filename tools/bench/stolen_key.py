"""A thief with a robot's keys, many times: what it can do before its robot is revoked, and after.

Each trial plays a fleet without a world, whose truth about work the world keeps. The thief speaks in the
name of its robot with valid proofs. It ends work that nobody did, also in the names of others and some
dozens of times a section. Meanwhile robots miss frames, so that they hear lies from honest ones, and one
restarts. Then the owner gives the others new keys.

Judged are the rules of chaos (among them: what is released, which robots latch, all work
done in truth), and the replicas of all others `GONE_S` after the owner's first frame: no fact of the
thief may be left.
"""

from collections.abc import Iterator
from functools import partial
from random import Random
from typing import NamedTuple

from agent.interface.config import S
from agent.interface.effects import Effect, Trace
from crdt import Phase
from sim.chaos.fault_generators import before_revocation
from sim.chaos.fault_profiles import with_faults
from sim.chaos.scenario_judge import ScenarioJudge
from sim.chaos.verdict import verdict_of
from sim.fleet.forgers import REVOKED_AFTER
from sim.scenarios.fleet_setup import DRAWN
from sim.scenarios.protocol_setup import drill
from sim.scenarios.scenario import Forger
from tools.bench.figure import Figure, percentile

TRIALS, QUICK_TRIALS = 1_000, 2
ROBOTS = (3, 4, 5)
THEFT_S, FOR_S = 6.0, 20.0  # in a sprint, which has 30 s of trouble
REVOKED_S = THEFT_S + FOR_S * REVOKED_AFTER
GONE_S = 5.0


class StolenKeyTrial(NamedTuple):
    """What came of one theft."""

    seed: int
    lies: int  # facts that robots believed before the revocation, and that are not true
    gone_after_s: float  # from the owner's first frame until the last robot took them out
    left: int  # facts of the thief in any replica, `GONE_S` after the owner's first frame
    broken: tuple[str, ...]  # rules


class _Theft:
    """One trial while it is played."""

    def __init__(self, seed: int) -> None:
        robots = ROBOTS[seed % len(ROBOTS)]
        self.seed, self.thief = seed, seed % robots
        fault = Forger(
            at_s=THEFT_S, kind="forger", position="inside", robot=self.thief, for_s=FOR_S
        )
        fleet = drill(robots, seed, "sprint", keys=DRAWN)
        trouble = [fault, *before_revocation(Random(f"{seed}/theft"), fault, robots)]
        self.judge = ScenarioJudge(with_faults(fleet, trouble), False)
        self.judge.on_effect = self._look
        self.void_at_us: dict[int, int] = {}
        self.lies: int | None = None
        self.left: int | None = None

    def run(self) -> StolenKeyTrial:
        self.judge.run()
        verdict = verdict_of(self.judge)
        revoked_at_us = round(REVOKED_S * S)
        last_at_us = max(self.void_at_us.values(), default=1 << 62)
        broken = tuple(f"{each.rule}: {each.what}" for each in verdict.broken)
        assert self.lies is not None and self.left is not None, "the run ended before the look"
        gone_after_s = (last_at_us - revoked_at_us) / S
        return StolenKeyTrial(self.seed, self.lies, gone_after_s, self.left, broken)

    def _look(self, slot: int, now_us: int, effect: Effect) -> None:
        if isinstance(effect, Trace) and effect.event == "VOID":
            self.void_at_us[slot] = now_us
        if self.lies is None and now_us >= round(REVOKED_S * S):
            self.lies = self._untrue()
        if self.left is None and now_us >= round((REVOKED_S + GONE_S) * S):
            self.left = self._untrue()

    def _untrue(self) -> int:
        """Facts in the replicas of the others that are not true."""
        world, found = self.judge.protocol_world, 0
        assert world is not None
        for robot in self.judge.cluster.running:
            if robot.slot == self.thief:
                continue
            peer = robot.peer
            for section, units in world.units.items():
                true = {unit for unit in range(units) if (section, unit) in world.worked}
                said = {unit for unit in range(units) if peer.progress.has(section, unit)}
                found += len(said - true)
                done = peer.allocation.phase_of(section) is Phase.DONE
                found += done and len(true) < units
                found += peer.allocation.owner_of(section) == self.thief
        return found


def trial(seed: int) -> StolenKeyTrial:
    """Play one theft."""
    return _Theft(seed).run()


def figures(quick: bool, seed: int = 1, trials: int | None = None) -> Iterator[Figure]:
    """What thefts did before and after the revocation."""
    count = trials or (QUICK_TRIALS if quick else TRIALS)
    played = [trial(seed + number) for number in range(count)]
    gone = [each.gone_after_s for each in played]
    left, broken = sum(t.left for t in played), [t for t in played if t.broken]
    say = partial("{} of robots with stolen keys, {} to {} robots, no world".format, count)
    scope = (
        f"{say(min(ROBOTS), max(ROBOTS))}; before: {sum(t.lies for t in played)} untrue facts about "
        f"work were believed, which the threat model admits"
    )
    yield Figure(
        f"stolen key: facts that are untrue {GONE_S:.0f} s after the revocation, {count} trials", left,
        "facts", "0", left == 0, "the truth of the world", scope,
    )  # fmt: skip
    yield Figure(
        "stolen key: from the owner's first frame until the last replica is clean, worst",
        round(max(gone), 2), "s", f"<= {GONE_S:.0f}", max(gone) <= GONE_S, "",
        f"median {percentile(gone, 0.5):.2f} s; {scope}",
    )  # fmt: skip
    why = "; ".join(f"seed {t.seed}: {t.broken[0]}" for t in broken[:3])
    yield Figure(
        f"stolen key: trials in which a rule was broken or work was lost, {count} trials",
        len(broken), "trials", "0", not broken, "the rules of chaos, docs/how/chaos.md",
        scope + (f"; {why}" if why else ""),
    )  # fmt: skip
