"""What a robot tells diagnostic tools of itself: identification of ISO 11783-12, faults of SAE J1939-73.

A fault is a cause for which the robot stands or creeps now, the same as in STANDSTILL. A cause that only
follows from another one is no fault of its own (`CONSEQUENCES`). A cause that holds a whole fleet is
repeated by the elected leader alone (`SHARED`, `repeated_causes`). A robot that is asked tells all of its
causes.
"""

from collections.abc import Collection, Sequence
from typing import Final

from agent.interface.identity import Identity
from agent.safety.stop_cause import StopCause, about, further
from protocol.frames.diagnostic_frames import (
    SPN_FIRST,
    ActiveFaults,
    DiagnosticProtocols,
    Functionalities,
    PreviousFaults,
)
from protocol.frames.fleet_frames import Standstill

_SILENCES: Final = (StopCause.MEMBER_SILENT.number, StopCause.CREEP.number)
COMPONENT_PGN: Final = 65259  # SAE J1939-71: make*model*serial number*unit*
ECU_PGN: Final = 64965  # ISO 11783-12: part*serial number*location*type*maker*hardware*
SOFTWARE_PGN: Final = 65242  # number of fields, then each with a *
PRODUCT_PGN: Final = 64653  # ISO 11783-12: code*brand*model*
CLEAR_PREVIOUS_PGN: Final = 65228  # DM3: asks to forget earlier faults
COMMANDED_ADDRESS_PGN: Final = 65240  # ISO 11783-5: a NAME, and the address that it is to claim
MAKER: Final = "Headland"
NO_FAULT: Final = (0, 0, 0, 0)
OCCURRENCES_MAX: Final = 126  # SAE J1939-73; 127 means that they are not counted
PROTOCOLS: Final = DiagnosticProtocols(1)
MINIMUM: Final = Functionalities(1, 0, 1, 1, 0)
CONDITION_EXISTS: Final = 31
# Failure modes of SAE J1939-73; of all other causes: the condition exists.
FAILURE_MODES: Final = {
    StopCause.MEMBER_SILENT: 9,  # abnormal update rate
    StopCause.CREEP: 9,
    StopCause.BACKBONE_LOST: 9,
    StopCause.BACKBONE_CREEP: 9,
    StopCause.UNHEARD: 9,
    StopCause.SENSES_OLD: 9,
    StopCause.SCAN_LOST: 9,
    StopCause.BUS_OFF: 19,  # received network data in error
    StopCause.ERROR_PASSIVE: 19,
    StopCause.PLACE_FROZEN: 7,  # mechanical system does not respond
    StopCause.IMPLEMENT_DOWN: 7,
    StopCause.PLACE_LOST: 2,  # data erratic
    StopCause.CONFIG_MISMATCH: 13,  # out of calibration
    StopCause.DUPLICATE_ID: 13,
    StopCause.DISK_ERROR: 12,  # bad intelligent device
    StopCause.BOOT_UNCONFIRMED: 12,
}
# A cause -> the causes from which it follows. Every reset takes the start away, so a latched robot has
# to be started anyway. The fault is then the latch alone: one frame a second instead of three.
CONSEQUENCES: Final = {
    StopCause.NOT_STARTED: frozenset({
        StopCause.STOP_DOT, StopCause.BOOT_UNCONFIRMED, StopCause.DISK_ERROR,
    }),
}  # fmt: skip


# Causes that hold a whole fleet at once. They are no faults of the device that they hold: a person
# pressed something or has to start the fleet, or another device failed. SAE J1939-73 leaves it to the
# maker which device finds a fault of its own numbers (from 516096 on).
SHARED: Final = frozenset({
    StopCause.NOT_STARTED, StopCause.STOP_DOT, StopCause.IMPLEMENTS_STOP, StopCause.UNAUTHENTICATED_STOP,
    StopCause.SPENT_STOP, StopCause.MEMBER_SILENT, StopCause.CREEP, StopCause.BACKBONE_LOST,
    StopCause.BACKBONE_CREEP, StopCause.CONFIG_MISMATCH,
})  # fmt: skip


def texts(identity: Identity) -> dict[int, str]:
    """Parameter group -> the text by which this robot answers a request for it."""
    serial = f"{identity.name.identity:07d}"
    return {
        COMPONENT_PGN: identity.component,
        ECU_PGN: f"peer*{serial}*robot {identity.slot}*peer*{MAKER}**",
        SOFTWARE_PGN: f"\x01{MAKER} {identity.release}".rstrip() + "*",
        PRODUCT_PGN: f"peer*{MAKER}*robot*",
    }


def fault_of(cause: StopCause) -> tuple[int, int]:
    """Suspect parameter and failure mode of a cause."""
    return SPN_FIRST + cause.number, FAILURE_MODES.get(cause, CONDITION_EXISTS)


def root_causes(causes: Sequence[tuple[StopCause, str]]) -> tuple[StopCause, ...]:
    """The active causes without those that only follow from another active one, in their order."""
    active = {cause for cause, _ in causes}
    return tuple(
        cause for cause, _ in causes if active.isdisjoint(CONSEQUENCES.get(cause, frozenset()))
    )


def repeated_causes(
    causes: Sequence[tuple[StopCause, str]], leader_tells: Collection[Standstill]
) -> tuple[StopCause, ...]:
    """The causes that this robot's DM1 repeats each second, the worst first.

    `leader_tells`: why the leader of the fleet stands, by its newest frames; empty for the leader
    itself, and while none is heard. A shared cause is left to a leader that tells the same one, of the
    same device. What is left is never empty while a cause is active.
    """
    told = {(m.cause, m.about, m.number if m.cause in _SILENCES else 0) for m in leader_tells}
    roots = root_causes(causes)
    details = dict(causes)
    own = tuple(
        cause for cause in roots
        if cause not in SHARED
        or (cause.number, about(cause, details[cause]), further(cause, details[cause])) not in told
    )  # fmt: skip
    return own or roots[:1]


def fault_table() -> str:
    """The Markdown table of all faults for the documents."""
    rows = sorted((*fault_of(cause), cause.name) for cause in StopCause)
    lines = [f"| {spn} | {mode} | {name} |" for spn, mode, name in rows]
    return "\n".join(["| SPN | FMI | cause |", "|---|---|---|", *lines])


class FaultMemory:
    """How often each cause was active since power-up, and which ones are earlier faults now."""

    def __init__(self) -> None:
        self._times: dict[StopCause, int] = {}
        self._active: frozenset[StopCause] = frozenset()

    def see(self, active: Collection[StopCause]) -> None:
        """These causes are active now, and no others."""
        for cause in active:
            if cause not in self._active:
                self._times[cause] = min(self._times.get(cause, 0) + 1, OCCURRENCES_MAX)
        self._active = frozenset(active)

    @property
    def earlier(self) -> tuple[StopCause, ...]:
        """The causes that were active and are not any more."""
        return tuple(cause for cause in self._times if cause not in self._active)

    def forget(self, cause: StopCause | None = None) -> None:
        """Forget one earlier fault, or all of them. What is active stays, with its count."""
        for each in self.earlier if cause is None else (cause,):
            if each not in self._active:
                self._times.pop(each, None)

    def active_faults(self, causes: Sequence[StopCause]) -> ActiveFaults | bytes:
        """DM1 with these of the active causes: a frame for at most one, else the data of a longer
        message.
        """
        if len(causes) > 1:
            return self._data(causes)
        return ActiveFaults(*(self._fields(causes[0]) if causes else NO_FAULT))

    def previous_faults(self) -> PreviousFaults | bytes:
        """DM2 with the earlier faults, in the same form."""
        causes = self.earlier
        if len(causes) > 1:
            return self._data(causes)
        return PreviousFaults(*(self._fields(causes[0]) if causes else NO_FAULT))

    def _fields(self, cause: StopCause) -> tuple[int, int, int, int]:
        spn, mode = fault_of(cause)
        return spn & 0xFFFF, mode, spn >> 16, self._times.get(cause, 1)

    def _data(self, causes: Sequence[StopCause]) -> bytes:
        fields = [self._fields(cause) for cause in causes]
        return b"\xff\xff" + b"".join(
            low.to_bytes(2, "little") + bytes((high << 5 | mode, times))
            for low, mode, high, times in fields
        )
