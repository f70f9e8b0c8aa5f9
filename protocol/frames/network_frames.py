"""Frames of ISO 11783-3 and -5 themselves: addresses, requests, acknowledgments, transport."""

from enum import IntEnum
from typing import NamedTuple


class AddressClaimed(NamedTuple):
    """PGN 60928. The source address claims itself for this NAME; from 254: cannot claim. Priority 6."""

    name: int  # 64 bits; see protocol/name.py

    def pack(self) -> bytes:
        return self.name.to_bytes(8, "little")

    @classmethod
    def unpack(cls, data: bytes) -> "AddressClaimed":
        return cls(int.from_bytes(data, "little"))


class Request(NamedTuple):
    """PGN 59904. Asks the destination (or all) to send a parameter group. 3 bytes. Priority 6."""

    pgn: int

    def pack(self) -> bytes:
        return self.pgn.to_bytes(3, "little")

    @classmethod
    def unpack(cls, data: bytes) -> "Request":
        return cls(int.from_bytes(data, "little"))


class RepetitionRateRequest(NamedTuple):
    """PGN 52224. Asks a device to send a parameter group at another rate. Priority 6.

    byte  field    type  meaning
    0..2  pgn      u24   what is asked for
    3..4  rate     u16   milliseconds; 0 stop sending, 0xFFFF the group's own rate
    5..7  reserved       0xFF
    """

    pgn: int
    rate_ms: int

    def pack(self) -> bytes:
        return self.pgn.to_bytes(3, "little") + self.rate_ms.to_bytes(2, "little") + b"\xff" * 3

    @classmethod
    def unpack(cls, data: bytes) -> "RepetitionRateRequest":
        return cls(int.from_bytes(data[:3], "little"), int.from_bytes(data[3:5], "little"))


class Control(IntEnum):
    ACK = 0
    NACK = 1
    DENIED = 2
    CANNOT_RESPOND = 3


class Acknowledgment(NamedTuple):
    """PGN 59392. Priority 6.

    byte  field           type  meaning
    0     control         u8    0 ACK, 1 NACK, 2 access denied, 3 cannot respond
    1     group_function  u8    0xFF: none
    2..3  reserved              0xFF
    4     address         u8    of the device that asked
    5..7  pgn             u24   what was asked for
    """

    control: int
    group_function: int
    address: int
    pgn: int

    def pack(self) -> bytes:
        head = bytes((self.control, self.group_function, 0xFF, 0xFF, self.address))
        return head + self.pgn.to_bytes(3, "little")

    @classmethod
    def unpack(cls, data: bytes) -> "Acknowledgment":
        if data[0] > 3:
            raise ValueError("range")
        return cls(data[0], data[1], data[4], int.from_bytes(data[5:], "little"))


class TransportManagement(NamedTuple):
    """PGN 60416, TP.CM: RTS 16, CTS 17, end of message 19, BAM 32, abort 255. Priority 7."""

    control: int
    body: bytes  # 4 bytes, by control
    pgn: int

    def pack(self) -> bytes:
        return bytes((self.control,)) + self.body + self.pgn.to_bytes(3, "little")

    @classmethod
    def unpack(cls, data: bytes) -> "TransportManagement":
        return cls(data[0], data[1:5], int.from_bytes(data[5:], "little"))


class TransportData(NamedTuple):
    """PGN 60160, TP.DT: a sequence number from 1 and seven bytes. Priority 7."""

    sequence: int
    body: bytes

    def pack(self) -> bytes:
        return bytes((self.sequence,)) + self.body.ljust(7, b"\xff")

    @classmethod
    def unpack(cls, data: bytes) -> "TransportData":
        return cls(data[0], data[1:])
