"""A clock that a fleet shares without agreeing on the time of day: a Lamport clock that also ticks.

It counts ticks since it was made and jumps ahead to every later stamp it receives. So no clock is
behind what its robot has seen, and all clocks of a fleet follow the one that is ahead. Nothing is
compared with a wall clock. One wrong stamp can carry all clocks to the end of their range, where
they stop.

After Lamport (1978); the idea to let a logical clock follow physical time is that of hybrid logical
clocks (Kulkarni et al. 2014), here without their separate logical part.
"""


class HybridClock:
    """Counts ticks of `tick_period_us` from 1 to `last`, and never less than the greatest stamp
    received."""

    def __init__(self, now_us: int, tick_period_us: int, last: int) -> None:
        """Its first tick is 1, because nothing was written before. `last`: where it stops."""
        assert tick_period_us > 0 and last > 0
        self._zero_at_us, self.tick_period_us, self.last = (
            now_us - tick_period_us,
            tick_period_us,
            last,
        )

    def read(self, now_us: int) -> int:
        """The stamp for something that happens now: a number of ticks, 1 to `last`."""
        return min(max((now_us - self._zero_at_us) // self.tick_period_us, 1), self.last)

    def witness(self, stamp: int, now_us: int) -> None:
        """Move the clock forward, if need be, so that it is not behind a stamp that was received."""
        self._zero_at_us = min(self._zero_at_us, now_us - stamp * self.tick_period_us)
