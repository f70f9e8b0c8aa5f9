"""A token bucket: limits what a gateway sends on its segment, regardless of the backbone traffic."""

from agent.interface.config import S


class TokenBucket:
    """Allows `share` of the bus time, with bursts of at most `burst_us`."""

    def __init__(self, share: float, burst_us: int, now_us: int) -> None:
        """`share`: above 0, up to 1. `burst_us`: bus time that may be used without a pause."""
        assert 0 < share <= 1
        self.share, self.burst_us = share, burst_us
        self._tokens_us = float(burst_us)
        self._filled_at_us = now_us

    def take(self, cost_us: int, now_us: int) -> bool:
        """Whether a transmission of `cost_us` may begin now; if so, it is charged."""
        self._fill(now_us)
        if self._tokens_us < cost_us:
            return False
        self._tokens_us -= cost_us
        return True

    def ready_at_us(self, cost_us: int, now_us: int) -> int:
        """When a transmission of `cost_us` may begin if nothing else is sent before."""
        self._fill(now_us)
        lacking_for_us = cost_us - self._tokens_us
        return (
            now_us if lacking_for_us <= 0 else now_us + min(int(lacking_for_us / self.share) + 1, S)
        )

    def _fill(self, now_us: int) -> None:
        gained_for_us = (now_us - self._filled_at_us) * self.share
        self._tokens_us = min(self._tokens_us + gained_for_us, self.burst_us)
        self._filled_at_us = now_us
