"""`headland release` against fleets that hold many stops, and while somebody forges stops."""

import asyncio
import json
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

import pytest

from agent.interface.lifecycle import State
from agent.peer.inputs import Press
from agent.runtime.files.key_file import OPERATOR, fresh, read, write
from agent.safety.stop_cause import StopCause
from crdt.stops import RemoteStopDot, RemoteStopSet, StopDot, StopSet, held_digest
from protocol.authentication import Keyring
from protocol.frames.fleet_frames import Heartbeat, Pose
from protocol.frames.safety_frames import EmergencyStop, Reason, StopsHeld
from protocol.links.bus import CanBus
from sim.can.simulated_bus import FieldBus
from sim.fleet.simulated_fleet import Cluster
from sim.fleet.virtual_clock import elapse
from sim.scenarios.scenario import load
from tests.chaos.at_work import Done, at_work
from tools.livemap.stop_panel import Panel
from tools.operate import reset
from tools.operate.operator_device import Operator
from tools.operate.reset import LISTEN_S, release
from tools.operate.shown_stops import ShownStops

PANEL = 141
RELEASE_S = 5.0


def operator_on(cluster: Cluster, keyring: Keyring | None = None) -> Operator:
    bus = CanBus(FieldBus(cluster.channel))
    operator = Operator(bus, keyring)
    loop = asyncio.get_running_loop()
    bus.subscribe(lambda frame: operator.hear(loop.time(), frame))
    return operator


@pytest.mark.parametrize("count", [20, 2_000])
def test_t9_one_reset_releases_a_fleet_that_holds_many_stops(count: int) -> None:
    async def story(cluster: Cluster, seen: list[Done]) -> None:
        for k in range(count):
            cluster.inject(EmergencyStop(PANEL + (k >> 8), 1, k & 0xFF, 0), 38)
            await elapse(0.001)
        await elapse(1.0)
        assert all(len(r.peer.safety.stops.active) >= 20 for r in cluster.running)
        operator, loop = operator_on(cluster), asyncio.get_running_loop()
        begun_s = loop.time()
        await operator.listen(LISTEN_S, stops=True)
        assert await release(operator, True, RELEASE_S) == []
        assert loop.time() - begun_s < 3.0
        assert not any(r.peer.safety.latched for r in cluster.running)

    at_work(load("small").changed(3, 5), story)


def test_t11_a_reset_clears_no_stop_that_only_a_forger_has_named(tmp_path: Path) -> None:
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249)
    key = read(tmp_path / "operator.json", OPERATOR)
    fleet = read(tmp_path / "fleet.json")

    async def story(cluster: Cluster, seen: list[Done]) -> None:
        async def forge() -> None:
            while True:
                for counter in range(2, 10):
                    cluster.inject(EmergencyStop(PANEL, 1, counter, 0, tag=7), 38)
                    await elapse(0.05)

        cluster.robots[1].runner.operate(Press(Reason.PERSON_IN_FIELD))
        forger = asyncio.ensure_future(forge())
        await elapse(1.0)
        operator = operator_on(cluster, key.keyring())
        await operator.listen(LISTEN_S, stops=True)
        assert await release(operator, True, RELEASE_S) == []
        forger.cancel()
        await elapse(4.0)
        assert all(r.peer.safety.may_move for r in cluster.running)
        for robot in cluster.running:
            assert not [d for d in robot.peer.safety.stops.cleared if d.slot == PANEL]
        panel = Keyring(fleet.keys, PANEL, b"panel")
        for _ in range(30):
            cluster.inject(panel.sign(EmergencyStop(PANEL, 1, 2, Reason.PERSON_IN_FIELD)), 38)
            await elapse(0.005)
        assert all(r.peer.safety.latched for r in cluster.running)

    at_work(load("small").changed(3, 5, tmp_path / "fleet.json"), story)


def on_field_bus(
    monkeypatch: pytest.MonkeyPatch,
    cluster: Cluster,
    key: Path | None,
    timeout_s: float = RELEASE_S,
) -> Coroutine[Any, Any, int]:
    """`headland release --json` as an operator on the bus of simulated robots calls it."""
    monkeypatch.setattr(reset, "attach", lambda *words: CanBus(FieldBus(cluster.channel)))
    return reset._reset("virtual", "field", 250_000, "", 0, key, False, timeout_s, True)


@pytest.mark.parametrize("signed", [False, True])
def test_release_says_which_stops_it_has_cleared(
    signed: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Without keys it always said that no stop was shown, although it had cleared one."""
    fleet, operator = tmp_path / "fleet.json", tmp_path / "operator.json"
    write(fleet, operator, fresh(), 249)

    async def story(cluster: Cluster, seen: list[Done]) -> None:
        cluster.robots[1].runner.operate(Press(Reason.PERSON_IN_FIELD))
        await elapse(1.0)
        (pressed,) = cluster.robots[0].peer.safety.stops.active
        assert await on_field_bus(monkeypatch, cluster, operator if signed else None) == 0
        told = json.loads(capsys.readouterr().out)
        assert told["cleared"] == [list(pressed)] and told["not_released"] == []
        assert not any(r.peer.safety.latched for r in cluster.running)

    at_work(load("small").changed(3, 5, fleet if signed else None), story)


def test_release_does_not_say_that_it_cleared_what_robots_still_hold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A fleet with keys takes no reset without."""
    fleet = tmp_path / "fleet.json"
    write(fleet, tmp_path / "operator.json", fresh(), 249)

    async def story(cluster: Cluster, seen: list[Done]) -> None:
        cluster.robots[1].runner.operate(Press(Reason.PERSON_IN_FIELD))
        await elapse(1.0)
        assert await on_field_bus(monkeypatch, cluster, None) == 1
        told = json.loads(capsys.readouterr().out)
        assert told["cleared"] == [] and told["not_released"] == [0, 1, 2]

    at_work(load("small").changed(3, 5, fleet), story)


@pytest.mark.parametrize("mute", [False, True])
def test_t11_of_many_stops_none_is_called_cleared_that_robots_still_hold(
    mute: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Robots name four stops at a time, and those that they had not named yet were called cleared.

    `mute`: they name none, as on a bus that loses frames."""
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249)
    panel = Keyring(read(tmp_path / "fleet.json").keys, PANEL, b"panel")

    async def story(cluster: Cluster, seen: list[Done]) -> None:
        for k in range(40):
            cluster.inject(panel.sign(EmergencyStop(PANEL, 1, k, 0)), 38)
            await elapse(0.02)
        await elapse(1.0)
        assert len(cluster.robots[0].peer.safety.stops.active) >= 40
        if mute:
            recount = ShownStops.recount

            def deaf(shown: ShownStops) -> None:
                recount(shown)
                monkeypatch.setattr(ShownStops, "hear_stop", lambda shown, m: None)

            monkeypatch.setattr(ShownStops, "recount", deaf)
        assert await on_field_bus(monkeypatch, cluster, None) == 1
        told = json.loads(capsys.readouterr().out)
        assert told["cleared"] == [] and told["not_released"] == [0, 1, 2]

    at_work(load("small").changed(3, 5, tmp_path / "fleet.json"), story)


def test_what_was_cleared_is_one_line() -> None:
    one = [StopDot(1, 2, 3)]
    assert reset.cleared_line(one, True, "all 1 that hold a robot", []) == "stops cleared: 1.2.3"
    assert reset.cleared_line([], False, "all 90", []) == "stops cleared: all 90"
    assert reset.cleared_line([], False, "", []) == "no stop was shown, so none was cleared"
    for shown, summed in ((True, ""), (False, "all 90")):
        assert "still hold" in reset.cleared_line([], shown, summed, [2])


def test_t9_what_is_pressed_during_a_reset_is_not_cleared() -> None:
    shown, first, second = ShownStops(None), StopDot(1, 1, 1), StopDot(2, 1, 1)
    shown.hear_stop(EmergencyStop(*first, 0))
    shown.hear_held(StopsHeld(0, 1, 77))
    shown.release()
    shown.hear_held(StopsHeld(0, 2, 78))
    assert shown.sums == [77], "more than before"
    shown.hear_stop(EmergencyStop(*second, 0))
    shown.hear_held(StopsHeld(0, 1, 79))
    shown.hear_stop(EmergencyStop(*second, 0, True))
    assert shown.sums == [77] and shown.named == ([first], [])


@pytest.mark.parametrize("after_s", [0.05, 0.4])
@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("by", ["command", "map"])
def test_t11_a_stop_that_is_pressed_after_a_release_was_asked_for_stays(
    by: str,
    signed: bool,
    after_s: float,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """`headland release` and the map listen for 0.7 s, and cleared what was pressed in that time."""
    fleet, operator = tmp_path / "fleet.json", tmp_path / "operator.json"
    write(fleet, operator, fresh(), 249)

    async def ask(cluster: Cluster) -> list[int]:
        key = operator if signed else None
        if by == "command":
            await on_field_bus(monkeypatch, cluster, key)
            told = json.loads(capsys.readouterr().out)
            return told["not_released"]  # type: ignore[no-any-return]
        bus, loop = CanBus(FieldBus(cluster.channel)), asyncio.get_running_loop()
        panel = Panel(bus, None, key)
        bus.subscribe(lambda frame: panel.hear(loop.time(), frame))
        await elapse(0.5)
        return (await panel.release(not signed, True, False))["late"]  # type: ignore[no-any-return]

    async def story(cluster: Cluster, seen: list[Done]) -> None:
        cluster.robots[1].runner.operate(Press(Reason.PERSON_IN_FIELD))
        await elapse(1.0)
        asked = asyncio.ensure_future(ask(cluster))
        await elapse(after_s + (0.5 if by == "map" else 0.0))
        cluster.robots[2].runner.operate(Press(Reason.PERSON_IN_FIELD))
        assert await asked == [0, 1, 2]
        for robot in cluster.running:
            assert 2 in {dot.slot for dot in robot.peer.safety.stops.active}
        assert await ask(cluster) == [], "which is shown now"
        assert not any(r.peer.safety.latched for r in cluster.running)

    at_work(load("small").changed(3, 5, fleet if signed else None), story)


def test_t9_names_and_sums_after_a_press_count_only_without_it() -> None:
    first, second = StopDot(1, 1, 1), StopDot(2, 1, 1)
    far, away = RemoteStopDot(3, 1, 1, 2), RemoteStopDot(4, 1, 1, 2)
    held, more = StopSet(), StopSet()
    held.press(first)
    more.press(first)
    more.press(second)
    none = RemoteStopSet()
    shown = ShownStops(None)
    shown.ask()
    shown.hear_stop(EmergencyStop(*second, 0))
    for dot in (second, first):
        shown.hear_stop(EmergencyStop(*dot, 0, echo=True))
    shown.hear_held(StopsHeld(0, 2, held_digest(more, none)))
    assert shown.sums == [] and shown.named == ([first], [])
    shown.hear_held(StopsHeld(1, 1, held_digest(held, none)))
    assert shown.sums == [held_digest(held, none)], "a robot that has missed the press"
    shown.hear_far(away, False)
    shown.hear_far(away, True)
    shown.hear_far(far, True)
    assert shown.named == ([first], [far])


def test_beats_in_the_name_of_a_latched_robot_do_not_make_its_release_a_success(
    tmp_path: Path,
) -> None:
    """`release` ended with exit code 0 while a robot was latched, if its beats were imitated."""
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249)
    key = read(tmp_path / "operator.json", OPERATOR)

    async def story(cluster: Cluster, seen: list[Done]) -> None:
        address = cluster.robots[1].peer.address
        assert address is not None

        async def forge() -> None:
            while True:
                cluster.inject(Pose(0.0, 0.0, 0.0, 0.0, State.IDLE, False, 0), address)
                beat = Heartbeat(255, State.IDLE, False, False, True, False, 1.0, 0, 0)
                cluster.inject(beat, address)
                await elapse(0.004)

        cluster.robots[1].runner.operate(Press(Reason.PERSON_IN_FIELD))
        await elapse(0.5)
        cluster.robots[1].peer.safety.raise_cause(StopCause.DISK_ERROR, 0)
        forger = asyncio.ensure_future(forge())
        operator = operator_on(cluster, key.keyring())
        await operator.listen(LISTEN_S, stops=True)
        assert await release(operator, False, RELEASE_S) == [1]
        assert [r.peer.safety.latched for r in cluster.running] == [False, True, False]
        forger.cancel()

    at_work(load("small").changed(3, 5, tmp_path / "fleet.json"), story)
