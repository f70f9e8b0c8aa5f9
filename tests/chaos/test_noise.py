"""A device that talks nonsense beside a working fleet: counted, bounded, and nothing is lost."""

import asyncio
from random import Random

import pytest

from protocol.frames.frame import Frame
from sim.can.simulated_bus import FieldBus
from sim.fleet.simulated_fleet import Cluster
from sim.fleet.virtual_clock import elapse, run_virtual
from sim.scenarios.field_setup import FieldSetup
from tests.chaos.broad import broad

SPOKEN = [  # parameter groups that peers listen to; a stop or an operator's hold would rightly
# hold a fleet without keys
    0xFF01, 0xFF04, 0xFF08, 0xFF0C, 0xFF0D, 0xFF0E, 0xFF10, 0xFF11, 0xFF12, 0xFF13,
    0xEE00, 0xEA00, 0xE800, 0xEC00, 0xEB00,
]  # fmt: skip
NOISE_S = 60.0  # twelve thousand such frames; what is still to do is done without


def nonsense(rng: Random) -> Frame:
    """Any identifier and bytes; half of the frames are of groups that are listened to."""
    data = rng.randbytes(rng.randrange(9))
    if rng.random() < 0.5:
        group = rng.choice(SPOKEN)
        if group < 0xF000:
            group |= rng.randrange(256)
        source = rng.choice((7, 200, 240, 254))  # nobody's; taking a member's is another test
        return Frame(rng.randrange(3, 8) << 26 | group << 8 | source, rng.randbytes(8))
    identifier = rng.randrange(1 << 29)
    return Frame(identifier | 1 << 28, data)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_fleet_works_beside_a_device_that_talks_nonsense(seed: int) -> None:
    setting, rng = FieldSetup(broad().changed(None, seed)), Random(seed)

    async def main() -> Cluster:
        cluster = Cluster(setting, f"noise {seed}")
        cluster.boot_all()
        noise = FieldBus(cluster.channel)
        loop = asyncio.get_running_loop()
        while loop.time() < 400 and not cluster.finished:
            for _ in range(20 if loop.time() < NOISE_S else 0):
                noise.submit(nonsense(rng))
            await elapse(0.1)
            cluster.check()
        for robot in cluster.running:
            assert sum(robot.peer.senders.malformed.values()) > 1000
            assert len(robot.peer.senders.malformed) <= 3, "reasons are few"
            assert robot.peer.membership.standing.keys() == {0, 1, 2} - {robot.slot}
        assert cluster.finished and cluster.replicas_equal, f"seed {seed}"
        noise.shutdown()
        await cluster.close()
        return cluster

    cluster = run_virtual(main())
    assert not cluster.world.contacts
