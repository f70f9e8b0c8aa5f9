"""What proofs cost a fleet with keys: share of the bus, and CPU time of one robot.

The bus load is that of whole peers at work on the simulated wire, at worst-case stuffing, with keys and
without, after all have joined. The CPU time is that of one robot that holds and verifies the frames
which the largest fleet sends, without the cache of tags that serves simulations.
"""

import argparse
import time
from collections.abc import Iterator
from random import Random
from typing import NamedTuple

from agent.interface.config import BEATS, CONTROL_PERIOD_US, PEERS_MAX, S
from protocol import frame_proofs
from protocol.authentication import KEY_SIZE, Keys
from protocol.frame_proofs import FleetTime, ProofBatch, ProofChecker, ProofKeys
from protocol.frames.fleet_frames import Heartbeat
from protocol.frames.work_frames import WorkProgress
from sim.chaos.effect_observer import EffectObserver
from sim.fleet.event_loop import EventLoop
from sim.fleet.scheduler import Script
from sim.fleet.simulated_fleet import Cluster
from sim.scenarios.fleet_setup import DRAWN
from sim.scenarios.protocol_setup import ProtocolSetup, drill
from tools.bench.figure import Figure
from tools.bench.fresh_process import in_fresh_process

# Robots -> points of bus load that proofs may add, and the load in all, in percent.
TARGETS = {20: (4.0, 38.0), 50: (5.0, 45.0), 108: (6.0, 50.0)}
JOINED_S, WORKS_S, QUICK_S = 12.0, 40.0, 6.0
CPU_SHARE = 0.05  # of a control period
ROUNDS = 2_000


class ProofLoad(NamedTuple):
    """Share of the bus of one fleet at work, 0 to 1, and its frames a second."""

    share: float
    frames: float
    proofs: float


def bus_load(robots: int, seed: int, keyed: bool, seconds: float) -> ProofLoad:
    """Whole peers on the simulated wire; the time in which they join is left out."""
    loop = EventLoop()
    setting = ProtocolSetup(drill(robots, seed, keys=DRAWN if keyed else None))
    witness = EffectObserver(robots)
    cluster = Cluster(setting, f"proofs {robots}/{seed}/{keyed}", witness, loop)
    setting.parade.checker()
    wire = cluster.segment.wire
    begun: list[tuple[int, int]] = []

    def main() -> "Script[None]":
        cluster.boot_all()
        yield round(JOINED_S * S)
        begun.append((wire.worst_for_us, wire.frames))
        yield round((JOINED_S + seconds) * S)

    loop.run(main())
    (worst_us, frames), proofs = begun[0], _proofs(cluster)
    share = (wire.worst_for_us - worst_us) / (seconds * S)
    rate = (wire.frames - frames) / seconds
    cluster.end()
    return ProofLoad(share, rate, proofs / (JOINED_S + seconds))


def _proofs(cluster: Cluster) -> int:
    """Proofs that one robot has accepted, scaled to all senders."""
    checker = next(iter(cluster.robots.values())).peer.proven.checker
    robots = len(cluster.robots)
    return 0 if checker is None else round(checker.accepted * robots / max(robots - 1, 1))


def proof_s(rounds: int = ROUNDS) -> float:
    """Seconds of CPU for one proof with two frames: they are held, and it is verified."""
    rng = Random("proof cost")
    keys = ProofKeys(Keys(rng.randbytes(KEY_SIZE), rng.randbytes(KEY_SIZE)))
    time_of_all = FleetTime(1 << 40, 0)
    time_of_all.known = True
    batch = ProofBatch(1, keys, time_of_all)
    checker, sent = ProofChecker(keys, time_of_all), []
    for number in range(rounds):
        now_us = number * 20_000
        pair = (
            Heartbeat(number % 250, 3, False, False, True, False, 1.0, number, number),
            WorkProgress(number % 99, 0, number),
        )
        for message in pair:
            batch.add(message, now_us)
        sent.append((now_us, pair, batch.seal(129, now_us)))
    frame_proofs._sum.cache_clear()  # what a robot has not computed yet
    begun_s = time.process_time()
    for now_us, messages, proof in sent:
        for message in messages:
            checker.hold(129, message, now_us)
        assert proof is not None and checker.verify(129, proof, now_us) is not None
    return (time.process_time() - begun_s) / rounds


def _robots_proof_s(rounds: int) -> float:
    """The same in a fresh process without a compiled core, as robots run."""
    return float(in_fresh_process(__spec__.name, "--rounds", f"{rounds}", interpreted=True))


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Bus load with and without proofs, and the CPU of a robot in the largest fleet."""
    seconds = QUICK_S if quick else WORKS_S
    for robots, (points, whole) in TARGETS.items():
        if quick and robots > 50:
            continue
        plain = bus_load(robots, seed, False, seconds)
        keyed = bus_load(robots, seed, True, seconds)
        added, share = 100 * (keyed.share - plain.share), 100 * keyed.share
        scope = (
            f"whole peers at work on the simulated wire for {seconds:.0f} s, worst-case stuffing: "
            f"{100 * plain.share:.1f} % and {plain.frames:.0f} frames a second without keys, "
            f"{share:.1f} % and {keyed.frames:.0f} with; {keyed.proofs:.0f} proofs a second"
        )
        yield Figure(
            f"bus load of proofs, {robots} robots", round(added, 2), "points", f"<= {points:.0f}",
            added <= points, "the same fleet without keys", scope,
        )  # fmt: skip
        yield Figure(
            f"bus load in all with keys, {robots} robots", round(share, 1), "%",
            f"<= {whole:.0f}", share <= whole, "", scope,
        )  # fmt: skip
    each_s = _robots_proof_s(200 if quick else ROUNDS)
    rate = 1.5 * PEERS_MAX * S / BEATS[-1].heartbeat_period_us  # with those after claims
    share = each_s * rate
    yield Figure(
        f"CPU of a robot for proofs, {PEERS_MAX} robots", round(100 * share, 2),
        "% of a control period", f"<= {100 * CPU_SHARE:.0f}", share <= CPU_SHARE, "",
        f"{1e6 * each_s:.0f} us for a proof and its two frames, {rate:.0f} proofs a second, "
        f"control period {CONTROL_PERIOD_US // 1000} ms, one core, no compiled core",
    )  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    print(proof_s(parser.parse_args().rounds))
