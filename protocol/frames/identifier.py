"""The 29-bit identifier of ISO 11783-3 (SAE J1939-21).

    bit    28..26    25           24        23..16  15..8   7..0
           priority  extended DP  data page  PF      PS      source address

PF below 240 (PDU1) makes the group addressed: PS is then the destination, and the parameter group
number has a low byte of 0. PF of 240 and above (PDU2) is broadcast, and PS belongs to the PGN.
"""

from typing import NamedTuple

GLOBAL_ADDRESS = 255
NULL_ADDRESS = 254  # source address of a device that could not claim an address


class Identifier(NamedTuple):
    """The parts of a CAN identifier; a group that is addressed has no destination in its `pgn`."""

    priority: int  # 0 is the most urgent and wins arbitration, 7 the least
    pgn: int  # parameter group number, 18 bits
    destination: int  # 255 for every broadcast group
    source: int

    def pack(self) -> int:
        """The 29 bits of the identifier as a number."""
        assert 0 <= self.priority <= 7 and 0 <= self.pgn < 1 << 18
        assert 0 <= self.source <= 0xFF and 0 <= self.destination <= 0xFF
        group = self.pgn
        if group >> 8 & 0xFF < 240:
            assert group & 0xFF == 0, "an addressed group ends in 0: the destination goes there"
            group |= self.destination
        return self.priority << 26 | group << 8 | self.source

    @classmethod
    def unpack(cls, identifier: int) -> "Identifier":
        """Take a 29-bit identifier apart; higher bits are ignored.

        >>> Identifier.unpack(0x18EEFF80)
        Identifier(priority=6, pgn=60928, destination=255, source=128)
        """
        group, source = identifier >> 8 & 0x3FFFF, identifier & 0xFF
        if group >> 8 & 0xFF < 240:
            return cls(identifier >> 26 & 7, group & 0x3FF00, group & 0xFF, source)
        return cls(identifier >> 26 & 7, group, GLOBAL_ADDRESS, source)
