"""Anti-entropy under any order of writes, cuts, heals and losses: equal in the end (L1)."""

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, rule

from sim.rigs.sync_rig import SyncFleet

S = 1_000_000
SIZE = 4
QUIET_US = 40 * S  # a question that was lost is asked again after 38 s at the latest
members = st.integers(0, SIZE - 1)


class Fleet(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.fleet = SyncFleet(SIZE, 1)

    @rule(who=members, section=st.integers(0, 30), unit=st.none() | st.integers(0, 200))
    def write(self, who: int, section: int, unit: int | None) -> None:
        self.fleet.write(who, section, unit)

    @rule(side=st.sets(members, min_size=1, max_size=SIZE - 1))
    def cut(self, side: set[int]) -> None:
        self.fleet.cut(side, set(range(SIZE)) - side)

    @rule()
    def heal(self) -> None:
        self.fleet.heal()

    @rule(rate=st.sampled_from((0.0, 0.05, 0.3)))
    def lose(self, rate: float) -> None:
        self.fleet.wire.faults.omission = rate

    @rule(for_ms=st.sampled_from((1, 30, 400, 2500)))
    def wait(self, for_ms: int) -> None:
        self.fleet.run(for_ms * 1_000)

    def teardown(self) -> None:
        """In the quiet, everybody ends with the same bytes, and stays so."""
        self.fleet.wire.faults.omission = 0.0
        self.fleet.heal()
        assert self.fleet.run(QUIET_US, until_equal=True)
        self.fleet.run(2 * S)
        assert len(self.fleet.states) == 1
        assert not any(member.sync.synchronizing for member in self.fleet.members.values())


TestFleet = Fleet.TestCase
TestFleet.settings = settings(max_examples=25, stateful_step_count=25, deadline=None)
