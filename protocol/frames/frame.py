"""A CAN data frame as the core sees it: free of python-can."""

from typing import NamedTuple


class Frame(NamedTuple):
    """One classic CAN data frame with a 29-bit identifier and 0 to 8 bytes."""

    identifier: int
    data: bytes
