"""What diagnostic tools of other makers ask first: faults, and what a device can do."""

from enum import IntEnum
from typing import Final, NamedTuple

from protocol.frames.layout import (
    ANY_DEVICE,
    FrameField,
    FrameLayout,
    choice,
    integer,
    reserved,
)

SPN_FIRST: Final = 516_096  # SAE J1939: suspect parameters that each maker defines begin here


class ActiveFaults(NamedTuple):
    """The one active fault of a device, or zeros if it has none (DM1, SAE J1939-73, PGN 65226).

    A robot sends it when it is asked, each second while it has a fault, and when its faults change.
    Several faults go by the transport protocol: two bytes for lamps, then four for each fault.
    """

    spn_low: int
    fmi: int
    spn_high: int
    occurrences: int

    @property
    def spn(self) -> int:
        """The suspect parameter."""
        return self.spn_high << 16 | self.spn_low


class PreviousFaults(NamedTuple):
    """The one earlier fault of a device, or zeros if it has none (DM2, SAE J1939-73, PGN 65227).

    A robot sends it when it is asked: the causes for which it stood since power-up, and does not any
    more. Several go by the transport protocol.
    """

    spn_low: int
    fmi: int
    spn_high: int
    occurrences: int


def _fault_fields() -> tuple[FrameField, ...]:
    return (
        reserved(16, ones=True),  # lamps, which ISO 11783-12 does not use
        integer("spn_low", 16, "suspect parameter, bits 0 to 15; a robot's are 516096 + the number "
                "of the cause for which it stands"),
        integer("fmi", 5, "failure mode of SAE J1939-73; 31: the condition exists"),
        integer("spn_high", 3, "suspect parameter, bits 16 to 18"),
        integer("occurrences", 7, "how often it was active since power-up, up to 126; 127: not counted",
                special=((127, "NOT_COUNTED"),)),
        reserved(1),
        reserved(16, ones=True),
    )  # fmt: skip


DM1 = FrameLayout(
    ActiveFaults, "DM1", pgn=0xFECA, priority=6, sender=ANY_DEVICE, fields=_fault_fields()
)
DM2 = FrameLayout(
    PreviousFaults, "DM2", pgn=0xFECB, priority=6, sender=ANY_DEVICE, fields=_fault_fields()
)


class DiagnosticProtocols(NamedTuple):
    """Protocols by which a device can be diagnosed (ISO 11783-12, PGN 64818).

    A robot sends it when it is asked.
    """

    protocols: int


DIAGNOSTIC_PROTOCOLS = FrameLayout(
    DiagnosticProtocols, "DIAGNOSTIC_PROTOCOLS", pgn=0xFD32, priority=6, sender=ANY_DEVICE,
    fields=(
        integer("protocols", 8, "bit 0: SAE J1939-73, bit 1: ISO 14230, bit 2: ISO 15765-3"),
        reserved(56, ones=True),
    ),
)  # fmt: skip


class Functionalities(NamedTuple):
    """The one functionality of a device with its generation (ISO 11783-7, PGN 64654).

    A robot sends it when it is asked: the minimum control function, generation 1, without options.
    """

    number: int
    functionality: int
    generation: int
    option_bytes: int
    options: int


FUNCTIONALITIES = FrameLayout(
    Functionalities, "FUNCTIONALITIES", pgn=0xFC8E, priority=6, sender=ANY_DEVICE,
    fields=(
        reserved(8, ones=True),
        integer("number", 8, "of functionalities; more than one go by the transport protocol"),
        integer("functionality", 8, "0: minimum control function"),
        integer("generation", 8, "of the functionality"),
        integer("option_bytes", 8, "number of bytes of options that follow"),
        integer("options", 8, "0: none"),
        reserved(16, ones=True),
    ),
)  # fmt: skip


class BroadcastControl(NamedTuple):
    """Asks devices to stop or start their broadcasts (DM13, SAE J1939-73, PGN 57088).

    A diagnostic tool sends it. A robot refuses with ACKNOWLEDGMENT, because its beats hold the fleet.
    """

    networks: int


DM13 = FrameLayout(
    BroadcastControl, "DM13", pgn=0xDF00, priority=6, sender=ANY_DEVICE,
    fields=(
        integer("networks", 16, "two bits for each; 0: stop, 1: start, 3: as it is; bits 6 and 7: "
                "the network of this frame"),
        reserved(48, ones=True),
    ),
)  # fmt: skip


class ClearControl(IntEnum):
    """The control byte of DM22."""

    CLEAR_PREVIOUS = 1
    PREVIOUS_CLEARED = 2
    PREVIOUS_KEPT = 3
    CLEAR_ACTIVE = 17
    ACTIVE_CLEARED = 18
    ACTIVE_KEPT = 19


class ClearRefusal(IntEnum):
    """Why a fault is not cleared: the second byte of DM22."""

    GENERAL = 0
    ACCESS_DENIED = 1
    UNKNOWN_FAULT = 2
    NOT_PREVIOUS = 3
    NOT_ACTIVE = 4
    NOT_AVAILABLE = 255


class ClearFault(NamedTuple):
    """Asks a device to forget one fault, and its answer (DM22, SAE J1939-73, PGN 49920).

    A diagnostic tool sends it. A robot forgets an earlier fault. It refuses for an active one, because
    what holds it ends by its own condition.
    """

    control: int
    refusal: int
    spn_low: int
    fmi: int
    spn_high: int


DM22 = FrameLayout(
    ClearFault, "DM22", pgn=0xC300, priority=6, sender=ANY_DEVICE,
    fields=(
        choice("control", 8, ClearControl, "what is asked or answered"),
        choice("refusal", 8, ClearRefusal, "why not; 255 in a request", strict=False),
        reserved(24, ones=True),
        integer("spn_low", 16, "suspect parameter, bits 0 to 15"),
        integer("fmi", 5, "failure mode"),
        integer("spn_high", 3, "suspect parameter, bits 16 to 18"),
    ),
)  # fmt: skip


class StandardHeartbeat(NamedTuple):
    """A device counts that it is alive, for another one that relies on it (ISO 11783-7, PGN 61668).

    A robot sends it each 100 ms after REPETITION_RATE_REQUEST has asked for it, until that asks for 0.
    """

    sequence: int


STANDARD_HEARTBEAT = FrameLayout(
    StandardHeartbeat, "STANDARD_HEARTBEAT", pgn=0xF0E4, priority=3, sender=ANY_DEVICE,
    fields=(
        integer("sequence", 8, "0 to 250 in turn; 251: the first one, 254: a fault, 255: the last one",
                special=((251, "FIRST"), (254, "FAULT"), (255, "LAST"))),
    ),
)  # fmt: skip
