"""Many robots switched on together: the bus must come to rest by itself.

Found by the load bench: asking each unknown address by every robot, and voting at every change of
view, filled a bus of fifty robots for good.
"""

import pytest

from agent.safety.stop_cause import StopCause
from protocol.frames.fleet_frames import LeaderElectionVote, Member
from protocol.frames.messages import GROUP_OF
from protocol.frames.network_frames import AddressClaimed, Request
from sim.fleet.virtual_clock import elapse, run_virtual
from tools.bench.drill import ProtocolFleet

PGN_PF = {kind: GROUP_OF[kind].pgn >> 8 for kind in (Request, AddressClaimed)}


@pytest.mark.parametrize(("robots", "seed"), [(6, 1), (40, 2)])
def test_boot_is_a_few_frames_a_robot(robots: int, seed: int) -> None:
    async def main() -> tuple[bool, dict[int, int], set[object]]:
        fleet = ProtocolFleet(robots, seed)
        try:
            working = await fleet.until_working(20.0)
            await elapse(4.0)
            assert not any(s.peer.safety.holds(StopCause.UNHEARD) for s in fleet.runners)
            leaders: set[object] = {s.peer.named.votes.election.leader for s in fleet.runners}
            return working, dict(fleet.segment.wire.by_group), leaders
        finally:
            await fleet.close()

    working, by_group, leaders = run_virtual(main())
    assert working, f"seed {seed}"
    assert len(leaders) == 1 and None not in leaders

    def sent(pf: int) -> int:
        return sum(count for group, count in by_group.items() if group >> 8 == pf)

    assert sent(PGN_PF[Request]) <= robots, f"seed {seed}"
    assert sent(PGN_PF[AddressClaimed]) <= 4 * robots
    assert by_group.get(GROUP_OF[Member].pgn, 0) <= 4 * robots
    assert by_group.get(GROUP_OF[LeaderElectionVote].pgn, 0) <= 3 * robots
