"""The two instants that no clock shows: before all others, and after all others. In microseconds."""

from typing import Final

NEVER_US: Final = -(1 << 62)  # it is infinitely long ago
FOREVER_US: Final = (1 << 62) - 1  # it never comes; the largest integer that mypyc unboxes
