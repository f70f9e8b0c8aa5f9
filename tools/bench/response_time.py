"""The longest time a frame can take on a CAN bus: the analysis that measurements must stay below.

Davis, Burns, Bril, Lukkien (2007), "Controller Area Network schedulability analysis: refuted, revisited
and revised", Real-Time Systems 35, equations 4 to 12, for frames of at most `length_us`.
"""

from collections.abc import Sequence
from typing import NamedTuple

from sim.can.frame_timing import BIT_US


class Stream(NamedTuple):
    """A frame with one identifier that is sent again after `period_us` at the earliest."""

    identifier: int
    period_us: int
    length_us: int
    jitter_us: int = 0


def bound_us(stream: Stream, others: Sequence[Stream], blocking_us: int) -> int | None:
    """Worst response time of a stream, from being queued to the end of the frame; None: no bound.

    `blocking_us`: the longest frame of less urgency that anybody may have on the wire.
    """
    urgent = [o for o in others if o.identifier < stream.identifier]
    load = sum(o.length_us / o.period_us for o in urgent) + stream.length_us / stream.period_us
    if load >= 1.0:
        return None
    busy_us = _fixed_point(
        stream.length_us,
        lambda t: (
            blocking_us
            + sum(_count(t + o.jitter_us, o.period_us) * o.length_us for o in (*urgent, stream))
        ),
    )
    worst_us = 0
    for q in range(_count(busy_us + stream.jitter_us, stream.period_us)):
        own_us = blocking_us + q * stream.length_us
        wait_us = _fixed_point(
            own_us,
            lambda w, own_us=own_us: (
                own_us
                + sum(_count(w + o.jitter_us + BIT_US, o.period_us) * o.length_us for o in urgent)
            ),
        )
        response_us = stream.jitter_us + wait_us - q * stream.period_us + stream.length_us
        worst_us = max(worst_us, response_us)
    return worst_us + BIT_US  # a frame enters the arbitration at the next bit


def _count(span_us: int, period_us: int) -> int:
    return -(-span_us // period_us)


def _fixed_point(start_us: int, step) -> int:  # type: ignore[no-untyped-def]
    now_us = start_us
    while (after_us := step(now_us)) != now_us:
        now_us = after_us
    return int(now_us)
