"""A token bucket: how much a gateway may say on its segment, whatever the backbone brings."""

from agent.interface.config import S


class TokenBucket:
    """`share` of the time, at most `burst_us` of it at once."""

    def __init__(self, share: float, burst_us: int, now_us: int) -> None:
        assert 0 < share <= 1
        self.share, self.burst_us = share, burst_us
        self._left_us = float(burst_us)
        self._filled_us = now_us

    def take(self, cost_us: int, now_us: int) -> bool:
        """Whether something that takes so long may begin now."""
        self._fill(now_us)
        if self._left_us < cost_us:
            return False
        self._left_us -= cost_us
        return True

    def ready_us(self, cost_us: int, now_us: int) -> int:
        """When it may, if nothing else does before."""
        self._fill(now_us)
        lacking_us = cost_us - self._left_us
        return now_us if lacking_us <= 0 else now_us + min(int(lacking_us / self.share) + 1, S)

    def _fill(self, now_us: int) -> None:
        gained_us = (now_us - self._filled_us) * self.share
        self._left_us = min(self._left_us + gained_us, self.burst_us)
        self._filled_us = now_us
