"""The health in a heartbeat: the lowest of what a robot knows of itself, from one table."""

from io import StringIO
from math import nan
from pathlib import Path

import pytest
from rich.console import Console

from agent.interface.config import CONTROL_PERIOD_US, MS, S
from agent.interface.effects import Effect, Send, Trace
from agent.interface.lifecycle import State
from agent.peer.inputs import Heard
from agent.peer.peer import Peer
from agent.peer.place_jumps import AGE_MAX_US
from agent.peer.self_health import (
    DEGRADED,
    FAILED,
    FINE,
    HOLDS,
    OF_BUS,
    OF_CAUSE,
    POOR,
    WARNED,
    HealthSource,
    Known,
    health,
    health_table,
    readings,
)
from agent.safety.stop_cause import StopCause
from protocol.controller_health import Health
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member
from protocol.frames.network_frames import AddressClaimed
from protocol.name import fleet_name
from tests.agent.lone_peer import introduce, peer_in, turn
from tools.inspect.inspector import Inspector
from tools.inspect.robot_table import show

# Causes that come from people, other robots or the field.
NOT_OF_ITSELF = frozenset({
    StopCause.NOT_STARTED, StopCause.OBSTACLE_AHEAD, StopCause.CREEP, StopCause.MEMBER_SILENT,
    StopCause.BACKBONE_LOST, StopCause.BACKBONE_CREEP, StopCause.CONFIG_MISMATCH,
    StopCause.DUPLICATE_ID, StopCause.UNAUTHENTICATED_STOP, StopCause.SPENT_STOP,
    StopCause.IMPLEMENTS_STOP, StopCause.STOP_DOT, StopCause.WORK_OFF,
})  # fmt: skip

WELL = Known(1.0, 1.0, Health.ACTIVE, (), 0, True)


def heartbeats(effects: list[Effect]) -> list[Heartbeat]:
    sent = [effect.message for effect in effects if isinstance(effect, Send)]
    return [message for message in sent if isinstance(message, Heartbeat)]


def joined() -> tuple[Peer, int]:
    """A robot at work with an address, and the time; another robot is there."""
    peer, now_us = peer_in(State.IDLE, None), 0
    while not peer.joining.joined:
        now_us += CONTROL_PERIOD_US
        turn(peer, now_us)
    introduce(peer, 141, 1, now_us)
    return peer, now_us


def next_heartbeat(peer: Peer, now_us: int) -> tuple[Heartbeat, list[Effect]]:
    """Of a robot that goes on with its life."""
    said: list[Effect] = []
    while not heartbeats(said):
        now_us += CONTROL_PERIOD_US
        peer.membership.reflected_at_us = now_us
        said += turn(peer, now_us)
    return heartbeats(said)[0], said


def test_m25_nothing_against_it_is_full_health() -> None:
    assert health(WELL) == FINE
    assert health(WELL._replace(battery=None, machine=None, sense_age_us=None,
                                senses_expected=False)) == FINE  # fmt: skip


@pytest.mark.parametrize(
    ("known", "share", "source"),
    [
        (WELL._replace(battery=0.19), 0.19, HealthSource.BATTERY),
        (WELL._replace(battery=0.0), FAILED, HealthSource.BATTERY),
        (WELL._replace(machine=0.4), 0.4, HealthSource.MACHINE),
        (WELL._replace(machine=nan), FAILED, HealthSource.MACHINE),
        (WELL._replace(machine=-3.0), FAILED, HealthSource.MACHINE),
        (WELL._replace(bus=Health.WARNING), WARNED, HealthSource.BUS),
        (WELL._replace(bus=Health.PASSIVE), DEGRADED, HealthSource.BUS),
        (WELL._replace(bus=Health.OFF), FAILED, HealthSource.BUS),
        (WELL._replace(causes=[StopCause.UNHEARD]), HOLDS, HealthSource.BUS),
        (WELL._replace(causes=[StopCause.DISK_ERROR]), FAILED, HealthSource.DISK),
        (WELL._replace(causes=[StopCause.BOOT_UNCONFIRMED]), HOLDS, HealthSource.DISK),
        (WELL._replace(sense_age_us=None), FAILED, HealthSource.SENSES),
        (WELL._replace(sense_age_us=AGE_MAX_US), DEGRADED, HealthSource.SENSES),
        (WELL._replace(sense_age_us=AGE_MAX_US + 1), FAILED, HealthSource.SENSES),
        (WELL._replace(sense_age_us=-1), FAILED, HealthSource.SENSES),
        (WELL._replace(causes=[StopCause.PLACE_FROZEN]), FAILED, HealthSource.SENSES),
        (WELL._replace(causes=[StopCause.SENSES_OLD]), HOLDS, HealthSource.SENSES),
        (WELL._replace(causes=[StopCause.LATE_TICK]), DEGRADED, HealthSource.COMPUTER),
    ],
)
def test_m25_each_source_lowers_health(known: Known, share: float, source: HealthSource) -> None:
    worst = readings(known)[0]
    assert (worst.share, worst.source) == (share, source)
    assert worst.why
    assert health(known) == share


def test_m25_the_worst_source_counts() -> None:
    bad = WELL._replace(
        battery=0.6, bus=Health.PASSIVE, causes=[StopCause.SENSES_OLD, StopCause.UNHEARD]
    )
    assert health(bad) == HOLDS
    assert health(bad._replace(causes=[StopCause.SENSES_OLD, StopCause.DISK_ERROR])) == FAILED


def test_m25_every_cause_and_every_state_of_a_controller_has_its_rule() -> None:
    assert set(OF_CAUSE) | NOT_OF_ITSELF == set(StopCause)
    assert not set(OF_CAUSE) & NOT_OF_ITSELF
    assert set(OF_BUS) == set(Health)
    for cause in NOT_OF_ITSELF:
        assert health(WELL._replace(causes=[cause])) == FINE, "a robot that is held is not ill"


def test_m25_a_heartbeat_of_a_robot_that_is_well_says_so() -> None:
    peer, now_us = joined()
    beat, said = next_heartbeat(peer, now_us)
    assert beat.health == FINE
    assert not [e for e in said if isinstance(e, Trace) and e.machine == "health"]


@pytest.mark.parametrize(("cause", "share"), [(c, share) for c, (share, _) in OF_CAUSE.items()])
def test_m25_a_fault_is_in_the_heartbeat_and_its_reason_in_the_traces(
    cause: StopCause, share: float
) -> None:
    peer, now_us = joined()
    peer.safety.raise_cause(cause, now_us, "", 60 * S)
    if cause is StopCause.ERROR_PASSIVE:
        peer.check._passive_at_us = now_us - 2 * S
    known = peer.self_known(now_us)
    assert health(known) == share
    if cause in (StopCause.BUS_OFF, StopCause.ADDRESS_LOST):  # it says nothing
        return
    beat = list(peer.named.voice.heartbeat(peer.context(now_us)))
    assert heartbeats(beat)[0].health == share
    if share <= POOR:
        (told,) = [e for e in beat if isinstance(e, Trace)]
        assert told.why.startswith(cause.name)
    again = list(peer.named.voice.heartbeat(peer.context(now_us)))
    assert not [e for e in again if isinstance(e, Trace)], "told once"


def test_m25_a_receiver_that_is_silent_shows_before_the_robot_stands() -> None:
    peer, now_us = joined()
    assert health(peer.self_known(now_us)) == FINE
    assert DEGRADED <= health(peer.self_known(now_us + AGE_MAX_US - 10 * MS)) < FINE
    assert health(peer.self_known(now_us + AGE_MAX_US + MS)) == FAILED


def test_m25_health_of_others_is_kept() -> None:
    peer, now_us = joined()
    beat = Heartbeat(1, State.IDLE, False, False, True, False, 0.0, 0, 0)
    peer.step(Heard(141, beat), now_us)
    assert peer.reports.healths == {1: 0.0}


def test_m25_the_table_in_the_documents_is_the_one_in_force() -> None:
    assert health_table() in (Path(__file__).parents[3] / "docs" / "use" / "inspect.md").read_text()


def test_m25_inspect_shows_the_health_that_is_told() -> None:
    inspector = Inspector()
    for message in (
        AddressClaimed(fleet_name("total", 1).pack()),
        Member(1, 0, 1),
        Heartbeat(1, State.IDLE, False, False, True, False, 0.0, 0, 0),
    ):
        inspector.hear(1.0, encode(message, 141, 255))
    seen = inspector.to_dict()
    assert [robot["health"] for robot in seen["robots"]] == [0.0]
    console = Console(width=200, file=StringIO())
    show(seen, console)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert "robot 1 health 0%: headland inspect --traces 1 asks it why" in text
