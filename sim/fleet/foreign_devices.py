"""Faults by devices that are not robots: several shortcut buttons, and a panel with used names.

Each device claims its address before it sends, and answers requests for its NAME (ISO 11783-5).

A pressed button is a level: no robot moves from the first stop frame until the last. If all robots
receive the device and no other trouble occurs, `sim/fleet/stop_monitor.py` checks this from true
positions.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from random import Random
from types import MappingProxyType
from typing import Final

from agent.interface.config import ADDRESS_FIRST, MS, S
from agent.peer.network_join import CLAIM_PGN
from protocol.frames.codec import decode_once, destination_of, encode
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS
from protocol.frames.network_frames import AddressClaimed, Request
from protocol.frames.safety_frames import (
    AllImplementsStop,
    EmergencyReset,
    EmergencyStop,
    Reason,
    Switch,
)
from protocol.name import Name, tool_name
from sim.can.simulated_bus import FieldBus
from sim.fleet.scheduler import Script
from sim.fleet.simulated_fleet import OPERATOR, Cluster
from sim.scenarios import scenario as kinds

FIRST_ADDRESS: Final = 38  # of the buttons
BUTTONS_MAX: Final = 8
LOTS: Final = 10  # numbers of devices that have separate addresses
assert FIRST_ADDRESS + LOTS * BUTTONS_MAX < ADDRESS_FIRST - BUTTONS_MAX
OTHER_MAKER: Final = Name(0, manufacturer=100, function=61, device_class=0)
CYCLE_US: Final = 1 * S  # ISO 11783-7
# All buttons send "permit" for this long before and after a press.
BEFORE_US, AFTER_US = 2_500 * MS, 3_500 * MS
NEVER: Final = -1  # disturbances are counted from 0
HEARD_US: Final = 150 * MS  # limit for a stop on one bus: 120 ms, and a frame that blocks it
UNHEARD_HOLD_US: Final = 2_800 * MS  # robots stand for 3 s after a press that they have missed
PANEL: Final = 180  # slot of a stop panel
PANEL_ADDRESS: Final = 120
NAMED_US: Final = 300 * MS  # from the clearance in advance to the press
LATCHED_US: Final = 250 * MS  # and two frames: a press that is still being sent counts as a new one


def times(cluster: Cluster, for_s: float, period_us: int) -> range:
    """Each period from now on for `for_s` seconds, in microseconds."""
    now_us = cluster.host.now_us()
    return range(now_us, now_us + round(for_s * S), period_us)


@contextmanager
def device(
    cluster: Cluster, names: Mapping[int, Name] = MappingProxyType({})
) -> Iterator[FieldBus]:
    """A controller that owns these NAMEs, by address."""
    bus = FieldBus(cluster.channel)
    said = {
        address: encode(AddressClaimed(name.pack()), address) for address, name in names.items()
    }

    def answer(frame: Frame) -> None:
        message = decode_once(frame)[1]
        if isinstance(message, Request) and message.pgn == CLAIM_PGN:
            asked = destination_of(frame)
            for address in said if asked == GLOBAL_ADDRESS else said.keys() & {asked}:
                bus.submit(said[address])

    bus.subscribe(answer)
    for claim in said.values():
        bus.submit(claim)
    try:
        yield bus
    finally:
        bus.shutdown()


def buttons(cluster: Cluster, fault: kinds.Buttons, rng: Random, lot: int) -> Script[None]:
    """All send "permit" once a second; one is pressed, and released. Each `lot` has other
    devices."""
    first, begin_at_us = FIRST_ADDRESS + BUTTONS_MAX * (lot % LOTS), cluster.host.now_us()
    press_at_us = begin_at_us + BEFORE_US
    release_at_us = press_at_us + round(fault.for_s * S)
    end_at_us, count = release_at_us + AFTER_US, rng.randrange(250)
    stops = (
        [] if fault.unheard else [*range(press_at_us, release_at_us, CYCLE_US * (1 + fault.lost))]
    )
    permits = [
        *range(begin_at_us, press_at_us, CYCLE_US),
        *range(release_at_us, end_at_us, CYCLE_US),
    ]
    said = [(t_us, first, count + 1, Switch.STOP) for t_us in stops]
    said += [(t_us, first, count + (t_us >= release_at_us), Switch.PERMIT) for t_us in permits]
    for k in range(1, fault.buttons):
        first_at_us = begin_at_us + rng.randrange(CYCLE_US)
        said += [
            (t_us, first + k, 0, Switch.PERMIT) for t_us in range(first_at_us, end_at_us, CYCLE_US)
        ]
    before = cluster.stops.disturbances if cluster.stops.calm else NEVER
    level, latch_ends_at_us = (
        None,
        release_at_us + UNHEARD_HOLD_US if fault.unheard else release_at_us,
    )
    names = {
        first + k: OTHER_MAKER._replace(identity=BUTTONS_MAX * lot + k)
        for k in range(fault.buttons)
    }
    with device(cluster, names) as bus:
        for due_at_us, address, counted, switch in sorted(said):
            if level is not None and due_at_us >= latch_ends_at_us:
                yield latch_ends_at_us
                cluster.stops.end_level(level)
            yield due_at_us
            # A robot that missed the earlier counts has no way to detect that the button was
            # pressed.
            missed = fault.unheard and due_at_us == release_at_us
            stopping = switch is Switch.STOP or (missed and cluster.stops.disturbances == before)
            if stopping and address == first and level is None:
                level = cluster.stops.level(HEARD_US)
            bus.submit(encode(AllImplementsStop(counted & 0xFF, switch), address))
        cluster.stops.end_level(level)


def used_stop(cluster: Cluster, fault: kinds.UsedStop, rng: Random) -> Script[None]:
    """An operator's device clears the next names of a panel in advance; then that panel is
    pressed.

    The panel holds no key. A fleet with keys stands while it sends, and is free by itself afterwards."""
    keyed = cluster.setting.keyring(OPERATOR, "used stop") is not None
    incarnation = rng.randrange(256)
    for counter in range(fault.names):
        cluster.inject(EmergencyReset(PANEL, incarnation, counter, OPERATOR))
    press_at_us = cluster.host.now_us() + NAMED_US
    period_us, end_at_us = round(fault.every_s * S), press_at_us + round(fault.for_s * S)
    latched_at_us, latched = press_at_us + LATCHED_US + 2 * period_us, False
    word = encode(EmergencyStop(PANEL, incarnation, 0, Reason.PERSON_IN_FIELD), PANEL_ADDRESS)
    with device(cluster, {PANEL_ADDRESS: tool_name(PANEL_ADDRESS)}) as bus:
        yield press_at_us
        level = cluster.stops.level(HEARD_US)
        now_us = press_at_us
        while now_us <= end_at_us:
            bus.submit(word)
            now_us += period_us
            yield now_us
            if now_us >= latched_at_us and not latched and not keyed:
                latched, bound = True, cluster.stops.obey(level)
                # What robots press instead may have been cleared before this time.
                if bound and cluster.stops.cleared_at_us < press_at_us:
                    cluster.stops.pressed(now_us, bound)
        cluster.stops.end_level(level)
