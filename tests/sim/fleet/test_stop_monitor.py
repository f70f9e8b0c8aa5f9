"""The watch over stops sees who moves after one, and knows when a person has let it go."""

from collections.abc import Awaitable, Callable

import pytest

from agent.interface.config import MS, STOP_SPACING_US, S
from agent.interface.effects import Drive
from protocol.frames.safety_frames import Command, EmergencyReset, OperatorCommand
from sim.fleet.fault_injector import FaultPlan
from sim.fleet.simulated_fleet import OPERATOR, Cluster
from sim.fleet.stop_monitor import StopMonitor
from sim.fleet.virtual_clock import elapse, run_virtual
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import Pushed, load
from sim.world.protocol_world import ProtocolWorld

Story = Callable[[Cluster], Awaitable[None]]


def play(story: Story) -> Cluster:
    async def main() -> Cluster:
        cluster = Cluster(FieldSetup(load("small").changed(3, 1)), f"watch {id(story)}")
        cluster.boot_all()
        try:
            await elapse(10.0)
            await story(cluster)
            cluster.world.advance(cluster.robots[0].runner.now_us())
            return cluster
        finally:
            await cluster.close()

    return run_virtual(main())


def order(cluster: Cluster, command: Command) -> None:
    cluster.order(OperatorCommand(command, 255, OPERATOR))


async def misdrive(cluster: Cluster, slot: int) -> None:
    """A motor controller that drives by itself, also between two commands of the robot to stand."""
    for _ in range(3):
        cluster.world.body(slot).drive(Drive(1.0, 0.0), cluster.robots[slot].runner.now_us())
        await elapse(0.013)


async def release(cluster: Cluster) -> None:
    for dot in sorted(cluster.robots[0].peer.safety.stops.active):
        cluster.order(EmergencyReset(*dot, OPERATOR))
    await elapse(0.2)
    order(cluster, Command.MANUAL_RESET)
    await elapse(1.0)


def test_a_fleet_that_obeys_is_without_blame_and_free_after_the_start() -> None:
    async def story(cluster: Cluster) -> None:
        cluster.press(1)
        await elapse(3.0)
        await release(cluster)
        order(cluster, Command.START)
        await elapse(3.0)
        assert any(cluster.world.body(slot).speed_m_s > 0.5 for slot in range(3))

    assert play(story).stops.violations == []


def test_a_robot_that_drives_on_is_seen() -> None:
    async def story(cluster: Cluster) -> None:
        cluster.press(1)
        await elapse(1.0)
        await misdrive(cluster, 2)

    found = play(story).stops.violations
    assert found and {violation.slots for violation in found} == {(2,)}


def test_a_start_before_the_reset_frees_nobody() -> None:
    async def story(cluster: Cluster) -> None:
        cluster.press(1)
        await elapse(1.0)
        order(cluster, Command.START)
        order(cluster, Command.MANUAL_RESET)
        order(cluster, Command.START)
        await elapse(1.0)
        await release(cluster)
        await misdrive(cluster, 0)

    assert {v.slots for v in play(story).stops.violations} == {(0,)}, "reset is not start"


def test_who_cannot_hear_is_not_expected_to_obey_where_silence_stops_nobody_for_long() -> None:
    async def story(cluster: Cluster) -> None:
        cluster.partition([{0, 1}, {2}])
        await elapse(5.0)
        cluster.press(1)
        await elapse(3.0)
        assert cluster.world.body(2).speed_m_s > 0.5

    assert play(story).stops.violations == []


@pytest.mark.parametrize("drives", [False, True])
def test_a_robot_that_is_pushed_by_hand_still_has_to_obey(drives: bool) -> None:
    """A push freed it from every stop, so it was not seen when it drove off afterwards."""

    async def story(cluster: Cluster) -> None:
        cluster.press(1)
        await elapse(2.0)
        push = Pushed(at_s=12.0, kind="pushed", robot=2, dx_m=0.3, dy_m=0.0)
        cluster.scenario = cluster.scenario.model_copy(update={"fault": [push]})
        await FaultPlan(cluster).run()
        await elapse(1.0)
        if drives:
            await misdrive(cluster, 2)

    found = {violation.slots for violation in play(story).stops.violations}
    assert found == ({(2,)} if drives else set())


@pytest.mark.parametrize("forgetful", [(), (0,), (0, 1)])
def test_a_stop_that_nobody_remembers_needs_no_clearing(forgetful: tuple[int, ...]) -> None:
    """Found by `headland chaos`, profile protocol, seed 30179: S1 was asked for a stop of which no
    memory was left, so that no operator could be shown what to clear."""
    parade = ProtocolWorld(2, 2)
    watch = StopMonitor(parade, 2)
    watch.pressed(0, (0, 1))
    for slot in forgetful:
        watch.forgets(slot)
    for command in (Command.MANUAL_RESET, Command.START):
        watch.ordered(OperatorCommand(command, 255, OPERATOR))
    parade.moved(1, 10 * S)
    assert bool(watch.violations) is (len(forgetful) < 2)


@pytest.mark.parametrize("memory", ["lost", "boots", "kept"])
def test_who_has_not_heard_a_stop_is_held_by_a_silence_alone(memory: str) -> None:
    """Found by `headland chaos`, profile protocol, seeds 100335 (the pressed robot lost its memory),
    52125 (a robot that had not heard it was switched on again): S1 asked for what nobody could know."""
    parade = ProtocolWorld(2, 2)
    watch = StopMonitor(parade, 2)
    watch.pressed(0, (0, 1), unheard=(1,))
    if memory == "lost":
        watch.forgets(0)
    elif memory == "boots":
        watch.boots(1)
    parade.moved(1, 10 * S)
    assert bool(watch.violations) is (memory == "kept")
    parade.moved(0, 10 * S)
    assert watch.violations[-1].slots == (0,)


@pytest.mark.parametrize("imitated", [(), (0,), (1,)])
def test_a_robot_whose_beats_are_imitated_is_silent_when_its_proofs_end(
    imitated: tuple[int, ...],
) -> None:
    """Found by `headland chaos`, profile protocol+forger, seed 13510373: the others did not hear the
    pressed robot, and an attacker beat in its name."""
    parade = ProtocolWorld(3, 2)
    watch = StopMonitor(parade, 3)
    watch.imitated(imitated, 1 * S)
    watch.pressed(0, (0, 1, 2), unheard=(2,), by=0)
    parade.moved(2, 1 * S)
    assert bool(watch.violations) is (imitated != (0,))
    parade.moved(2, 2 * S)
    assert watch.violations[-1].slots == (2,)
    parade.moved(1, 2 * S)
    assert watch.violations[-1].slots == (1,)


@pytest.mark.parametrize("since_us", [1 * S, 2 * S])
def test_a_stop_that_was_hardly_said_is_known_to_who_was_pressed_alone(since_us: int) -> None:
    """Thought of behind `headland chaos`, profile protocol, seed 1801786: the power of who was pressed
    goes in the same moment, and its memory is lost."""
    parade = ProtocolWorld(2, 2)
    watch = StopMonitor(parade, 2)
    watch.pressed(2 * S, (0, 1), by=0)
    watch.sent(0, 2 * S)
    watch.interrupted(since_us)
    watch.forgets(0)
    parade.moved(1, 10 * S)
    assert bool(watch.violations) is (since_us == 2 * S)


@pytest.mark.parametrize("sender", [None, 0, 1])
def test_a_stop_that_waits_for_a_full_bus_binds_no_robot_that_restarts(sender: int | None) -> None:
    """Found by `headland chaos`, profile press, seed 930019: the pressed robot loses its power before
    its stop frame has won an arbitration, and the other robot restarts."""
    parade = ProtocolWorld(2, 2)
    watch = StopMonitor(parade, 2)
    watch.pressed(2 * S, (0, 1), by=0)
    watch.sent(0, 1 * S)  # a stop frame of an earlier press
    if sender is not None:
        watch.sent(sender, 3 * S)
    assert watch.waits is (sender != 0)
    watch.interrupted(5 * S)
    watch.boots(1)
    parade.moved(1, 10 * S)
    assert bool(watch.violations) is (sender == 0)


@pytest.mark.parametrize("silence_stops", [False, True])
@pytest.mark.parametrize("sent", [False, True])
@pytest.mark.parametrize("how", ["dies", "is cut off"])
def test_a_stop_that_is_lost_with_its_robot_binds_only_by_its_silence(
    silence_stops: bool, sent: bool, how: str
) -> None:
    """Found by `headland chaos`, profile flood, seeds 940321 and 950225: pressed in a flood that
    outranks stops, and without power or bus before it ended; the policy was `continue`."""
    parade = ProtocolWorld(2, 2)
    watch = StopMonitor(parade, 2, silence_stops=silence_stops)
    watch.pressed(2 * S, (0, 1), by=0)
    if sent:
        watch.sent(0, 3 * S)
    if how == "dies":
        watch.dies(0)
    else:
        watch.interrupted(5 * S)
    parade.moved(1, 10 * S)
    assert bool(watch.violations) is (sent or silence_stops)


@pytest.mark.parametrize("since_us", [1 * S, 2 * S + 1])
def test_what_a_hung_process_has_not_read_its_next_life_does_not_know(since_us: int) -> None:
    """Found by `headland chaos`, profile protocol, seed 1700617: the stop came while the process hung,
    and its power went before it ran on."""
    parade = ProtocolWorld(2, 2)
    watch = StopMonitor(parade, 2)
    watch.pressed(2 * S, (0, 1))
    watch.dies_hung(1, since_us)
    watch.boots(1)
    parade.moved(1, 10 * S)
    assert bool(watch.violations) is (since_us > 2 * S)


@pytest.mark.parametrize("said", [False, True])
def test_a_stop_that_is_cleared_before_it_could_be_said_holds_who_was_pressed_alone(
    said: bool,
) -> None:
    """Found by `headland chaos`, profile protocol, seed 2612345: pressed while it claimed its address,
    and cleared 77 ms later."""
    parade, mute = ProtocolWorld(2, 2), {0}
    watch = StopMonitor(parade, 2, mute=lambda: mute)
    watch.pressed(0, (0, 1), by=0)
    if said:
        mute.clear()
    watch.ordered(EmergencyReset(0, 1, 1, OPERATOR))
    parade.moved(1, 10 * S)
    assert bool(watch.violations) is said
    parade.moved(0, 10 * S)
    assert watch.violations[-1].slots == (0,)


@pytest.mark.parametrize("up", [{0, 1}, {1}])
def test_a_stop_that_only_a_dead_machine_remembers_is_shown_to_nobody(up: set[int]) -> None:
    """Found by `headland chaos`, profile protocol, seed 602173: S1 asked for the clearing of a stop that
    was on the disk of a machine without power."""
    parade = ProtocolWorld(2, 2)
    watch = StopMonitor(parade, 2, lambda: up)
    watch.pressed(0, (0, 1))
    watch.forgets(1)
    for command in (Command.MANUAL_RESET, Command.START):
        watch.ordered(OperatorCommand(command, 1, OPERATOR))
    parade.moved(1, 10 * S)
    assert bool(watch.violations) is (0 in up)


@pytest.mark.parametrize(("dies_ms", "until_ms", "broken"), [
    (None, 420, True), (310, 410, False), (310, 411, True), (330, 421, True), (10, 321, True),
])  # fmt: skip
def test_what_a_dead_robot_said_last_expires_in_its_actuator(
    dies_ms: int | None, until_ms: int, broken: bool
) -> None:
    """Found by `headland chaos`, profile crash, seeds 6022 and 6172: one that died just before it would
    have noticed a silence drove for a tenth of a second more."""
    checker = ProtocolWorld(1, 1).checker()
    checker.press(0, 320 * MS, [0])
    if dies_ms is not None:
        checker.lapses(0, dies_ms * MS)
    checker.moved(0, until_ms * MS)
    assert bool(checker.violations) is broken


def test_a_second_press_that_sends_no_frame_of_its_own_is_not_waited_for() -> None:
    """Found by `headland chaos`, profile press, seed 1300035: operators waited for the frame of a
    press 62 ms after the first one, which a robot takes for the same press, and reset no robot."""
    watch = StopMonitor(ProtocolWorld(2, 2), 2)
    watch.pressed(0, (0, 1), by=1)
    watch.pressed(30 * MS, (0, 1), by=1)
    assert watch.unsent == {1}
    watch.sent(1, 40 * MS)
    watch.pressed(62 * MS, (0, 1), by=1)
    assert not watch.waits
    watch.pressed(STOP_SPACING_US, (0, 1), by=1)
    assert watch.unsent == {1}


def test_s1_a_reset_of_one_robots_stop_leaves_that_of_another_in_force() -> None:
    """It was taken for one of every stop, so a robot that drove on after it was not seen."""

    async def story(cluster: Cluster) -> None:
        cluster.press(1)
        cluster.press(2)
        await elapse(1.0)
        active = cluster.robots[0].peer.safety.stops.active
        assert {dot.slot for dot in active} == {1, 2}
        for dot in active:
            if dot.slot == 1:
                cluster.order(EmergencyReset(*dot, OPERATOR))
        await elapse(0.2)
        order(cluster, Command.MANUAL_RESET)
        await elapse(1.0)
        order(cluster, Command.START)
        await elapse(1.0)
        await misdrive(cluster, 0)

    found = play(story).stops.violations
    assert found and {violation.slots for violation in found} == {(0,)}
