"""The one place that makes peers: of robots, of simulated fleets, of the engine, and of tests.

A peer is made from its identity, a random source, its durable memory, and its `MissionParts`.
A fleet of several segments names its `Area`, and the peer then also knows the other segments.
"""

from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from random import Random
from time import time
from typing import Final, NamedTuple

from agent.interface.identity import Identity, SilencePolicy
from agent.interface.mission import Mission
from agent.interface.motion_controller import MotionController
from agent.peer.peer import ONE_SEGMENT, Peer
from agent.peer.peer_parts import PeerParts
from agent.segments.segment_area import Area
from agent.segments.segment_parts import segments_of
from protocol.authentication import Keyring, Keys
from protocol.name import IN_VIRTUAL_TIME, DeviceFields, fleet_name
from protocol.operator_badges import BadgeBook
from protocol.sync.map_sync import MapSync
from protocol.units import S

KNOWN_FROM_S: Final = (
    1_792_972_800  # 2026-10-26: a computer that says an earlier date does not know it
)
NO_MEMORY: Mapping[str, bytes] = {}


class MissionParts(NamedTuple):
    """What a mission brings to its peer. Without any, the peer is a member that does no work."""

    mission: Mission | None = None
    motion: MotionController | None = None
    chart: MapSync | None = None  # the fleet's map, if the mission makes one


NO_MISSION = MissionParts()


def identity_of(
    fleet: str,
    slot: int,
    robots: int,
    field_hash: int,
    silence: SilencePolicy = SilencePolicy.STOP,
    *,
    first_boot: bool = False,
    diagnostics: bool = False,
    implement_width_m: float = 0.0,
    device: DeviceFields = IN_VIRTUAL_TIME,
) -> Identity:
    """The identity of one slot of a fleet of `robots` robots, with permission to move at boot.

    `fleet`: the name that all its robots share; their NAMEs on the bus are made from it.
    `field_hash`: u24; robots with another one work somewhere else and are refused.
    `first_boot`: a new machine, for which an empty memory is no loss. `diagnostics`: whether active
    faults are told unasked (DM1), and a task controller is answered, with `implement_width_m`.
    `device`: fields of the NAMEs, equal for all robots of the fleet.
    """
    return Identity(
        slot=slot,
        members=frozenset(range(robots)),
        name=fleet_name(fleet, slot, device),
        field_hash=field_hash,
        silence=silence,
        started=True,
        first_boot=first_boot,
        release=release(),
        diagnostics=diagnostics,
        implement_width_mm=round(1000 * implement_width_m),
    )


@cache
def release() -> str:
    """The release of the installed software; "" if it runs from a tree that is not installed."""
    try:
        return version("headland")
    except PackageNotFoundError:
        return ""


def keyring_of(
    keys: Keys | None, sender: int, lot: bytes, clock_zero_at_s: int | None = None
) -> Keyring | None:
    """The keyring of one robot; None for a fleet without keys.

    `lot`: any value that no two boots of this robot share, because it names the boot in questions
    about freshness. `clock_zero_at_s`: the time of day, seconds since 1970, when `now_us` was 0; None:
    unknown, so that no operator's key that expires is believed."""
    if keys is None:
        return None
    return Keyring(keys, sender, lot, badges=BadgeBook(clock_zero_at_s))


def clock_zero_at_s(now_us: int) -> int | None:
    """The time of day of this computer when `now_us` was 0, seconds since 1970; None: it does not
    know it, as without a battery before a network tells it."""
    now_s = round(time())
    return None if now_s < KNOWN_FROM_S else now_s - now_us // S


def make_peer(
    identity: Identity,
    rng: Random,
    now_us: int,
    recalled: Mapping[str, bytes] = NO_MEMORY,
    parts: MissionParts = NO_MISSION,
    *,
    keyring: Keyring | None = None,
    area: Area | None = None,
    backbone: SilencePolicy = SilencePolicy.CONTINUE,
) -> Peer:
    """One peer, before its first frame.

    `now_us`: the time of its boot on the clock of all its later inputs. `recalled`: the contents of
    its durable memory. `area`: its segment, in a fleet of several. `backbone`: what it does while no
    other segment is reached.
    """
    all_parts = PeerParts(identity, rng, now_us, recalled, *parts[:2], keyring, parts.chart)
    segments = ONE_SEGMENT if area is None else segments_of(all_parts, area, backbone, now_us)
    return Peer(all_parts, segments)
