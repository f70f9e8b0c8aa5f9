"""The health of a robot as its heartbeats report it: 0.0 failed to 1.0 healthy.

The number is the lowest of the readings that the robot has of itself: battery, machine, bus, disk,
senses and computer. Every rule is in the tables below. The number shows people where to look. No
robot decides by it: causes stop robots, claims assign work, and votes elect the leader.
"""

from collections.abc import Collection, Mapping
from enum import Enum
from typing import Final, NamedTuple

from agent.interface.config import CONTROL_PERIOD_US
from agent.peer.place_jumps import AGE_MAX_US
from agent.peer.self_check import SelfCheck
from agent.peer.sense_freshness import Senses
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController
from protocol.controller_health import Health

FINE: Final = 1.0  # no fault is known
WARNED: Final = 0.75  # it works fully; a person should check it before it gets worse
DEGRADED: Final = 0.5  # it still works, without any reserve
HOLDS: Final = 0.25  # the robot stands still because of it, and may go on by itself
FAILED: Final = 0.0  # it does not work
POOR: Final = DEGRADED  # a source at this value or below is reported in the traces


class HealthSource(Enum):
    """What a reading of a robot's health is about."""

    BATTERY = "battery"
    MACHINE = "machine"
    BUS = "bus"
    DISK = "disk"
    SENSES = "senses"
    COMPUTER = "computer"


class Reading(NamedTuple):
    """The reading of one source. `share`: 0.0 failed to 1.0 healthy."""

    share: float
    source: HealthSource
    why: str  # empty if it is fine


class Known(NamedTuple):
    """What a robot knows about itself. None means that there is no such source."""

    battery: float | None  # share of a full charge
    machine: float | None  # self-reported health of the machine's controller, 0 to 1
    bus: Health
    causes: Collection[StopCause]
    sense_age_us: int | None  # of the newest observation
    senses_expected: bool  # it needs its senses to drive, or has sensed before


class SelfKnowledge:
    """Collects what this robot knows about itself."""

    def __init__(self, safety: StopController, senses: Senses, check: SelfCheck) -> None:
        self.safety, self.senses, self.check = safety, senses, check

    def known(self, now_us: int) -> Known:
        """What the health in our heartbeats is computed from."""
        here = self.senses.here
        return Known(
            None if here is None else here.battery,
            None if here is None else here.health,
            self.check.controller,
            [cause for cause, _ in self.safety.causes],
            self.senses.age_us(now_us),
            self.senses.expected,
        )


# The controller's own state, ISO 11898-1: warning from 96 errors, passive from 128, off from 256.
OF_BUS: Final[Mapping[Health, tuple[float, str]]] = {
    Health.ACTIVE: (FINE, ""),
    Health.WARNING: (WARNED, "the controller counts many errors"),
    Health.PASSIVE: (DEGRADED, "the controller is error passive"),
    Health.OFF: (FAILED, "the controller left the bus"),
}

# Causes that a fault of this robot raises. All others come from people, other robots or the field.
OF_CAUSE: Final[Mapping[StopCause, tuple[float, HealthSource]]] = {
    StopCause.BUS_OFF: (FAILED, HealthSource.BUS),
    StopCause.ERROR_PASSIVE: (HOLDS, HealthSource.BUS),  # for 1 s: no burst
    StopCause.UNHEARD: (HOLDS, HealthSource.BUS),  # its beats do not leave, or are not reflected
    StopCause.ADDRESS_LOST: (HOLDS, HealthSource.BUS),
    StopCause.DISK_ERROR: (FAILED, HealthSource.DISK),  # a write failed, or the disk is full
    StopCause.BOOT_UNCONFIRMED: (HOLDS, HealthSource.DISK),  # it has lost what it had written
    StopCause.SENSES_OLD: (HOLDS, HealthSource.SENSES),  # lower while they are old; see `_senses`
    StopCause.PLACE_FROZEN: (FAILED, HealthSource.SENSES),  # the sensed place is wrong
    StopCause.PLACE_LOST: (FAILED, HealthSource.SENSES),
    StopCause.SCAN_LOST: (FAILED, HealthSource.SENSES),
    StopCause.IMPLEMENT_DOWN: (FAILED, HealthSource.MACHINE),
    StopCause.LATE_TICK: (DEGRADED, HealthSource.COMPUTER),
}


def readings(known: Known) -> list[Reading]:
    """The reading of each available source, worst first."""
    found = [Reading(*_bus(known.bus)), _senses(known)]
    if known.battery is not None:
        found.append(_told(known.battery, HealthSource.BATTERY, "charged to"))
    if known.machine is not None:
        found.append(_told(known.machine, HealthSource.MACHINE, "says of itself"))
    for cause in known.causes:
        if cause in OF_CAUSE:
            share, source = OF_CAUSE[cause]
            found.append(Reading(share, source, f"{cause.name}: {cause.value.why}"))
    return sorted(found, key=lambda reading: (reading.share, reading.source.value))


def health(known: Known) -> float:
    """The lowest reading of all sources, a share of 0.0 failed to 1.0 healthy."""
    return readings(known)[0].share


def _bus(controller: Health) -> tuple[float, HealthSource, str]:
    share, why = OF_BUS[controller]
    return share, HealthSource.BUS, why


def _told(share: float, source: HealthSource, word: str) -> Reading:
    """A share that comes from outside the core. NaN counts as a failed source."""
    share = min(max(share, FAILED), FINE) if share == share else FAILED
    return Reading(share, source, "" if share == FINE else f"{word} {share:.0%}")


def _senses(known: Known) -> Reading:
    """Fine for one control period, then falling to 0.5 at the age that stops the robot, then failed."""
    if not known.senses_expected:
        return Reading(FINE, HealthSource.SENSES, "")
    age_us = known.sense_age_us
    if age_us is None:
        return Reading(FAILED, HealthSource.SENSES, "nothing is sensed")
    if not 0 <= age_us <= AGE_MAX_US:
        return Reading(FAILED, HealthSource.SENSES, f"sensed {age_us / 1000:.0f} ms ago")
    if age_us <= CONTROL_PERIOD_US:
        return Reading(FINE, HealthSource.SENSES, "")
    late = (age_us - CONTROL_PERIOD_US) / (AGE_MAX_US - CONTROL_PERIOD_US)
    share = FINE - (FINE - DEGRADED) * late
    return Reading(share, HealthSource.SENSES, f"sensed {age_us / 1000:.0f} ms ago")


def health_table() -> str:
    """The Markdown table of all health rules for the documents."""
    limit_for_ms, fine_for_ms = AGE_MAX_US // 1000, CONTROL_PERIOD_US // 1000
    rows = [
        (
            "battery, machine",
            "the share that is told; a machine without a battery has a full one",
            "",
        ),
        *(
            ("bus", f"controller {state.name}", f"{share:g}")
            for state, (share, _) in OF_BUS.items()
        ),
        *((source.value, cause.name, f"{share:g}") for cause, (share, source) in OF_CAUSE.items()),
        ("senses", f"up to {fine_for_ms} ms old", f"{FINE:g}"),
        ("senses", f"then less, at {limit_for_ms} ms", f"{DEGRADED:g}"),
        ("senses", f"older than {limit_for_ms} ms, from the future, or absent", f"{FAILED:g}"),
    ]
    head = "| source | what it knows | health |\n|---|---|---|"
    return "\n".join([head, *(f"| {source} | {what} | {share} |" for source, what, share in rows)])
