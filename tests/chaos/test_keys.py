"""A fleet with keys at work: it is stopped and released as one without, and by nobody else."""

from pathlib import Path
from typing import Any

import pytest

from agent.interface.config import MS
from agent.interface.effects import Send
from agent.interface.lifecycle import State
from agent.runtime.files.key_file import fresh, write
from agent.safety import stop_controller
from protocol.authentication import Signed
from protocol.frames.fleet_frames import Pose
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import (
    Command,
    EmergencyReset,
    EmergencyStop,
    Freshness,
    OperatorCommand,
)  # fmt: skip
from sim.chaos.fault_profiles import with_faults
from sim.chaos.verdict import Verdict, judge
from sim.fleet.simulated_fleet import OPERATOR, Cluster
from sim.fleet.virtual_clock import elapse
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.fleet_setup import DRAWN
from sim.scenarios.protocol_setup import drill
from sim.scenarios.scenario import Crash, Estop, Reset, Restart, UsedStop, load
from tests.chaos.at_work import Done, Story, at_work
from tests.chaos.broad import broad


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249)
    return tmp_path / "fleet.json"


def play(keys: Path, story: Story) -> None:
    at_work(load("small").changed(3, 5, keys), story)


def states(cluster: Cluster) -> set[State]:
    return {robot.peer.state for robot in cluster.running}


def press(cluster: Cluster, slot: int) -> None:
    cluster.press(slot)


@pytest.mark.slow
def test_a_scenario_with_keys_is_stopped_reset_and_finished(keys: Path) -> None:
    faults = [Estop(at_s=30.0, kind="estop", robot=2), Reset(at_s=45.0, kind="reset")]
    scenario = broad().changed(None, None, keys).model_copy(update={"fault": faults})
    outcome = FieldRun(FieldSetup(scenario)).run()
    assert outcome.success and outcome.authenticated, outcome
    assert outcome.frames["Challenge"] >= 3 and outcome.frames["Freshness"] >= 3


@pytest.mark.slow
def test_a_robot_that_was_away_for_many_stops_follows_again(keys: Path) -> None:
    faults = [
        Crash(at_s=10.0, kind="crash", robot=1),
        *(Estop(at_s=12.0 + 4 * n, kind="estop", robot=0) for n in range(3)),
        Restart(at_s=26.0, kind="restart", robot=1),
        Reset(at_s=30.0, kind="reset"),
        Estop(at_s=40.0, kind="estop", robot=0),
        Reset(at_s=45.0, kind="reset"),
    ]
    scenario = broad().changed(None, None, keys).model_copy(update={"fault": faults})
    outcome = FieldRun(FieldSetup(scenario)).run()
    assert outcome.finished and outcome.replicas_equal and outcome.contacts == 0, outcome


def test_frames_without_a_tag_brake_for_a_moment_and_release_nothing(keys: Path) -> None:
    async def story(cluster: Cluster, seen: list[Done]) -> None:
        cluster.inject(EmergencyStop(OPERATOR, 1, 1, 1))
        await elapse(0.1)
        assert not any(r.peer.safety.may_move for r in cluster.running)
        await elapse(2.0)
        assert all(r.peer.safety.may_move for r in cluster.running) and State.WORKING in states(
            cluster
        )
        press(cluster, 1)
        await elapse(0.2)
        assert states(cluster) == {State.EMERGENCY_STOP}
        (dot,) = cluster.robots[0].peer.safety.stops.active
        for _ in range(20):
            cluster.inject(EmergencyReset(*dot, OPERATOR))
            cluster.inject(OperatorCommand(Command.MANUAL_RESET, 255, OPERATOR))
            await elapse(0.1)
        assert states(cluster) == {State.EMERGENCY_STOP}
        assert all(r.peer.safety.authority.refused >= 20 for r in cluster.running)

    play(keys, story)


def test_what_an_operator_said_once_releases_nothing_later(keys: Path) -> None:
    async def story(cluster: Cluster, seen: list[Done]) -> None:
        heard: list[Any] = []
        order = cluster.order

        def overheard(message: Signed) -> None:
            order(message)
            heard.append(message)

        for _ in range(2):
            press(cluster, 2)
            await elapse(0.2)
            assert states(cluster) == {State.EMERGENCY_STOP}
            if not heard:
                for _ in range(5):
                    for dot in cluster.robots[0].peer.safety.stops.active:
                        overheard(EmergencyReset(*dot, OPERATOR))
                    await elapse(0.1)
                overheard(OperatorCommand(Command.MANUAL_RESET, 255, OPERATOR))
                await elapse(1.0)
                overheard(OperatorCommand(Command.START, 255, OPERATOR))
                await elapse(1.0)
                assert State.EMERGENCY_STOP not in states(cluster)
        for message in heard:
            cluster.inject(message)
            await elapse(0.05)
        assert states(cluster) == {State.EMERGENCY_STOP}

    play(keys, story)


def test_t14_a_robot_that_lost_its_address_stops_the_others(keys: Path) -> None:
    """All addresses are claimed with a better NAME, and somebody imitates the beats of the robot."""

    async def story(cluster: Cluster, seen: list[Done]) -> None:
        address = cluster.robots[1].peer.address
        others = {cluster.robots[slot].peer.address for slot in (0, 2)}
        assert address is not None
        member = cluster.robots[1].peer.joining.announcement
        for taken in [a for a in range(131, 236) if a not in others] + [address]:
            cluster.inject(AddressClaimed(0), taken)
        for beat in range(20):
            if beat % 5 == 0:
                cluster.inject(member, address)
            cluster.inject(Pose(0.0, 0.0, 0.0, 0.0, State.WORKING, False, 0), address)
            await elapse(0.05)
        assert cluster.robots[1].peer.address is None
        press(cluster, 1)
        for _ in range(4):
            cluster.inject(Pose(0.0, 0.0, 0.0, 0.0, State.WORKING, False, 0), address)
            await elapse(0.05)
        assert all(robot.peer.safety.stops.latched for robot in cluster.running)

    play(keys, story)


def test_proofs_nobody_asked_for_are_refused(keys: Path) -> None:
    async def story(cluster: Cluster, seen: list[Done]) -> None:
        for n in range(20):
            cluster.inject(Freshness(OPERATOR, n, n))
        await elapse(0.5)
        rings = [r.peer.safety.authority.keyring for r in cluster.running]
        assert not any(ring._proven_at_us for ring in rings if ring is not None)
        assert not any(isinstance(e, Send) and isinstance(e.message, Freshness) for _, e in seen)

    play(keys, story)


def panel_without_a_key(seed: int, every_s: float) -> Verdict:
    """A panel of a fleet without keys is pressed in a fleet with keys, after its names were cleared."""
    fault = UsedStop(at_s=7.0 + seed / 7, kind="used_stop", names=4, for_s=4.0, every_s=every_s)
    return judge(with_faults(drill(4, seed, "sprint", keys=DRAWN), [fault]))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("every_s", [0.005, 1.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_panel_without_a_key_holds_a_fleet_with_keys_while_it_sends(
    seed: int, every_s: float
) -> None:
    assert not panel_without_a_key(seed, every_s).broken, f"panel_without_a_key({seed}, {every_s})"


def test_the_judge_finds_a_robot_that_does_not_stand_until_the_next_unsigned_stop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stop_controller, "UNAUTHENTICATED_HOLD_US", 500 * MS)
    found = panel_without_a_key(1, 1.0).broken
    assert "S1" in {each.rule for each in found}
