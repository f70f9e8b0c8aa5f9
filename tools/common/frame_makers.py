"""Which proprietary frames a listener reads: those of our maker, as robots do
(`agent/peer/frame_origin.py`).

PGN 0xFF00 to 0xFFFF and 0xEF00 mean something else to each maker. A listener may come later than the
claims, or read a log that has none. So frames from an address without a known claim are read, until
another maker claims that address.

Robots may have the manufacturer code of who builds them (`[device]` of the robot file). A tool is told
that code by the environment variable HEADLAND_MANUFACTURER.
"""

import os
from collections import Counter

from protocol.frames.frame import Frame
from protocol.name import AGRICULTURE, OWN_FUNCTIONS, Name, is_ours

MAKER_VARIABLE = "HEADLAND_MANUFACTURER"
PROPRIETARY = (0xEF, 0xFF)  # upper byte of the parameter group


class Makers:
    """Learns from address claims which addresses belong to our maker, and counts the frames of
    others."""

    def __init__(self) -> None:
        self.refused: Counter[int] = Counter()  # PGN -> frames of other makers that were not read
        self._ours: dict[int, bool] = {}  # by claimed address
        self._maker = os.environ.get(MAKER_VARIABLE, "")

    def claimed(self, address: int, number: int) -> bool:
        """Whether the NAME that claims it is ours."""
        name = Name.unpack(number)
        own = (
            f"{name.manufacturer}" == self._maker
            and name.industry_group == AGRICULTURE
            and name.function in OWN_FUNCTIONS
        )
        self._ours[address] = ours = own or is_ours(name)
        return ours

    def knows(self, address: int) -> bool:
        """A NAME of ours has claimed it."""
        return self._ours.get(address, False)

    def refuse(self, frame: Frame) -> bool:
        """A proprietary frame of another maker. It is counted."""
        upper = frame.identifier >> 16 & 0x3FF
        if upper not in PROPRIETARY or self._ours.get(frame.identifier & 0xFF, True):
            return False
        self.refused[upper << 8 | (frame.identifier >> 8 & 0xFF if upper == 0xFF else 0)] += 1
        return True
