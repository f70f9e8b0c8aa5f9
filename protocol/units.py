"""Units of time, and the length of a frame, in microseconds."""

from typing import Final

MS: Final = 1_000  # microseconds in a millisecond
S: Final = 1_000_000  # microseconds in a second
FRAME_US: Final = 640  # a frame of 8 bytes at worst-case stuffing, 250 kbit/s
