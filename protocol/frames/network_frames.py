"""Frames of ISO 11783-3 and -5 themselves: addresses, requests, acknowledgments, transport."""

from enum import IntEnum
from typing import NamedTuple

from protocol.frames.layout import ANY_DEVICE, FrameLayout, choice, integer, octets, reserved
from protocol.name import FIELDS


class AddressClaimed(NamedTuple):
    """Claims the source address for a NAME (ISO 11783-5, PGN 60928).

    Every device sends it when it starts, when it is asked, and when another device claims the same
    address. The lower NAME keeps the address. From the null address 254 it says that no address
    could be claimed.
    """

    name: int


ADDRESS_CLAIMED = FrameLayout(
    AddressClaimed, "ADDRESS_CLAIMED", pgn=0xEE00, priority=6, sender=ANY_DEVICE,
    fields=(integer("name", 64, "NAME of ISO 11783-5", subfields=FIELDS),),
)  # fmt: skip


class Request(NamedTuple):
    """Asks the destination, or all devices, to send a parameter group (ISO 11783-3, PGN 59904).

    Any device sends it when it needs the group. The receiver sends the group, or refuses with
    ACKNOWLEDGMENT if it alone was asked.
    """

    pgn: int


REQUEST = FrameLayout(
    Request, "REQUEST", pgn=0xEA00, priority=6, sender=ANY_DEVICE,
    fields=(integer("pgn", 24, "the group that is asked for"),),
    padded=True,  # many devices fill it up to eight bytes
)  # fmt: skip


class Request2(NamedTuple):
    """Asks for a parameter group as REQUEST does (ISO 11783-3, PGN 51456).

    Devices of other makers send it. A robot answers as it answers REQUEST, and refuses an answer in a
    transfer group.
    """

    pgn: int
    transfer: int


REQUEST2 = FrameLayout(
    Request2, "REQUEST2", pgn=0xC900, priority=6, sender=ANY_DEVICE,
    fields=(
        integer("pgn", 24, "the group that is asked for"),
        integer("transfer", 2, "1: the answer is to come in a transfer group"),
        reserved(6, ones=True),
        reserved(32, ones=True),
    ),
)  # fmt: skip


class RepetitionRateRequest(NamedTuple):
    """Asks a device to send a parameter group at another rate (SAE J1939-21, PGN 52224).

    Devices of other makers send it. A robot sends STANDARD_HEARTBEAT if that was asked for, and
    refuses every other group with ACKNOWLEDGMENT.
    """

    pgn: int
    rate_ms: int


REPETITION_RATE_REQUEST = FrameLayout(
    RepetitionRateRequest, "REPETITION_RATE_REQUEST", pgn=0xCC00, priority=6, sender=ANY_DEVICE,
    fields=(
        integer("pgn", 24, "the group that is asked for"),
        integer("rate_ms", 16, "period; 0: stop sending, 0xFFFF: the group's own rate", "ms",
                special=((0, "STOP"), (0xFFFF, "OWN_RATE"))),
        reserved(24, ones=True),
    ),
)  # fmt: skip


class AcknowledgmentControl(IntEnum):
    """What a device answers to a request: the control byte of PGN 59392."""

    ACK = 0
    NACK = 1
    DENIED = 2
    CANNOT_RESPOND = 3


class Acknowledgment(NamedTuple):
    """Accepts or refuses what another device asked for (ISO 11783-3, PGN 59392).

    A device sends it when it alone was asked for a group that it does not send now.
    """

    control: int
    group_function: int
    address: int
    pgn: int


ACKNOWLEDGMENT = FrameLayout(
    Acknowledgment, "ACKNOWLEDGMENT", pgn=0xE800, priority=6, sender=ANY_DEVICE,
    fields=(
        choice("control", 8, AcknowledgmentControl, "the answer"),
        integer("group_function", 8, "0xFF: none", special=((0xFF, "NONE"),)),
        reserved(16, ones=True),
        integer("address", 8, "of the device that asked"),
        integer("pgn", 24, "the group that was asked for"),
    ),
)  # fmt: skip


PGN_MASK = 0x3FFFF  # 18 bits


def acknowledgment(control: AcknowledgmentControl, asker: int, pgn: int) -> Acknowledgment:
    """What a device answers to a request for a group (ISO 11783-3).

    `asker`: the source address of the request.
    """
    return Acknowledgment(control, 0xFF, asker, pgn & PGN_MASK)


def refusal(asker: int, pgn: int) -> Acknowledgment:
    """The answer of a device that alone was asked for a group which it does not send (ISO 11783-3).

    `asker`: the source address of the request.
    """
    return acknowledgment(AcknowledgmentControl.NACK, asker, pgn)


class TransportManagement(NamedTuple):
    """Opens, controls and closes the transfer of a longer message (ISO 11783-3, PGN 60416).

    A sender announces a message to all (BAM) or to one device (RTS); that device answers with CTS
    and with the end of the message. `protocol/transport.py` has the sequences.
    """

    control: int
    body: bytes
    pgn: int


TP_CM = FrameLayout(
    TransportManagement, "TP_CM", pgn=0xEC00, priority=7, sender=ANY_DEVICE,
    fields=(
        integer("control", 8, "16 RTS, 17 CTS, 19 end of message, 32 BAM, 255 abort", special=(
            (16, "RTS"), (17, "CTS"), (19, "END"), (32, "BAM"), (255, "ABORT")
        )),
        octets("body", 4, "by control"),
        integer("pgn", 24, "group of the message that is transferred"),
    ),
)  # fmt: skip


class TransportData(NamedTuple):
    """Seven bytes of a longer message (ISO 11783-3, PGN 60160).

    The sender of an announced message sends them in order, 50 ms apart to all devices.
    """

    sequence: int
    body: bytes


TP_DT = FrameLayout(
    TransportData, "TP_DT", pgn=0xEB00, priority=7, sender=ANY_DEVICE,
    fields=(
        integer("sequence", 8, "counted from 1"),
        octets("body", 7, "the last packet is filled up with 0xFF"),
    ),
)  # fmt: skip


class ExtendedTransportManagement(NamedTuple):
    """Opens, controls and closes the transfer of a message above 1,785 bytes (ISO 11783-3, PGN 51200).

    A sender announces it (RTS) to one device, which grants packets (CTS). Before each grant is sent, the
    sender says where it begins (DPO). `protocol/extended_transport.py` has the sequences.
    """

    control: int
    body: bytes
    pgn: int


ETP_CM = FrameLayout(
    ExtendedTransportManagement, "ETP_CM", pgn=0xC800, priority=7, sender=ANY_DEVICE,
    fields=(
        integer("control", 8, "20 RTS, 21 CTS, 22 DPO, 23 end of message, 255 abort", special=(
            (20, "RTS"), (21, "CTS"), (22, "DPO"), (23, "END"), (255, "ABORT")
        )),
        octets("body", 4, "by control"),
        integer("pgn", 24, "group of the message that is transferred"),
    ),
)  # fmt: skip


class ExtendedTransportData(NamedTuple):
    """Seven bytes of a message above 1,785 bytes (ISO 11783-3, PGN 50944).

    The sender of such a message sends them in order, at most 255 after each DPO.
    """

    sequence: int
    body: bytes


ETP_DT = FrameLayout(
    ExtendedTransportData, "ETP_DT", pgn=0xC700, priority=7, sender=ANY_DEVICE,
    fields=(
        integer("sequence", 8, "counted from 1 after each DPO"),
        octets("body", 7, "the last packet is filled up with 0xFF"),
    ),
)  # fmt: skip
