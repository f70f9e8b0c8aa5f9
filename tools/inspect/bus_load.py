"""How full a bus is, second by second, from the frames heard."""

from collections import deque

SECONDS = 120  # kept; more do not fit a terminal
BIT_RATE = 250_000


def bits_of(data_bytes: int) -> int:
    """An extended frame with worst-case stuffing (Davis et al. 2007)."""
    return 80 + 10 * data_bytes


class BusLoad:
    """Shares of the bus, 0 to 1, of the newest whole seconds; the last one is still filling."""

    def __init__(self, bitrate: int = BIT_RATE) -> None:
        self.bitrate = bitrate
        self._bins: deque[int] = deque([0], maxlen=SECONDS)
        self._second: int | None = None

    def hear(self, t_s: float, data_bytes: int) -> None:
        """Count one frame with this number of data bytes."""
        second = int(t_s)
        if self._second is None or second < self._second:  # the first; or another log
            self._second = second
        for _ in range(min(second - self._second, SECONDS)):
            self._bins.append(0)
        self._second = second
        self._bins[-1] += bits_of(data_bytes)

    @property
    def whole(self) -> int | None:
        """Changes when a second is over."""
        return self._second

    @property
    def shares(self) -> list[float]:
        """One share of 0 to 1 for each second, the oldest first."""
        return [bits / self.bitrate for bits in self._bins]

    @property
    def newest(self) -> float:
        """Of the last second that is whole, or of what there is."""
        shares = self.shares
        return shares[-2] if len(shares) > 1 else shares[-1]
