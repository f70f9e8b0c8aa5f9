"""Three robots at work on the virtual clock, for the story of a test: it gets all that they do."""

from collections.abc import Awaitable, Callable

from agent.interface.effects import Effect
from sim.fleet.simulated_disk import Disk, LogJournal
from sim.fleet.simulated_fleet import Cluster
from sim.fleet.virtual_clock import elapse, run_virtual
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import Scenario

Done = tuple[int, Effect]  # a robot's slot, and what it did
Story = Callable[[Cluster, list[Done]], Awaitable[None]]
JOINED_S = 5.0  # they work by then


def at_work(scenario: Scenario, story: Story, disks: bool = False) -> None:
    """`disks`: with journals on disks that can lose power, else in memory."""
    seen: list[Done] = []

    async def main() -> None:
        setting = FieldSetup(scenario)
        cluster = Cluster(
            setting, f"at work {id(story)}", lambda slot, _, effect: seen.append((slot, effect))
        )
        if disks:
            for slot in range(scenario.fleet.robots):
                cluster.journals[slot] = LogJournal(Disk())
        cluster.boot_all()
        try:
            await elapse(JOINED_S)
            await story(cluster, seen)
            assert not cluster.stops.violations
        finally:
            await cluster.close()

    run_virtual(main())
