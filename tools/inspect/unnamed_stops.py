"""How many stops hold a fleet beyond those that a listener keeps by name."""

Dot = tuple[int, int, int]

NAMES = 1 << 24  # a slot, an incarnation and a counter, a byte each


class UnnamedStops:
    """A bit for each name that a stop, 2 MiB in all: each is counted once, however often it is said."""

    def __init__(self) -> None:
        self.count = 0
        self.heard_s = float("-inf")  # when the newest was first heard
        self._bits = bytearray()  # of no size until there is a flood

    def press(self, dot: Dot, t_s: float) -> None:
        """Count a stop, unless it is counted already."""
        self._bits = self._bits or bytearray(NAMES // 8)
        at, bit = _place(dot)
        if not self._bits[at] & bit:
            self._bits[at] |= bit
            self.count, self.heard_s = self.count + 1, t_s

    def clear(self, dot: Dot) -> None:
        """One of them was cleared, or is kept by name from now on."""
        at, bit = _place(dot)
        if self._bits and self._bits[at] & bit:
            self._bits[at] ^= bit
            self.count -= 1

    def clear_all(self) -> None:
        """A reset has named all that is held."""
        self.count, self._bits = 0, bytearray()


def _place(dot: Dot) -> tuple[int, int]:
    number = dot[0] << 16 | dot[1] << 8 | dot[2]
    return number >> 3, 1 << (number & 7)
