"""Which messages of other segments a gateway reads."""

from agent.segments.segment_reachability import GONE_US, SEGMENTS_MAX, SegmentReachability
from protocol.backbone_messages import BackboneHeader, BackboneKind, Summary


def test_a_gateway_is_heard_after_its_numbers_have_begun_again() -> None:
    """All that it said counted as told before, so its segment was lost for the others."""
    reach = SegmentReachability(1)

    def accepts(sequence: int) -> bool:
        header = BackboneHeader(BackboneKind.SUMMARY, 2, 0, 124, 7, sequence)
        return reach.accepts(header, 0)

    last = (1 << 32) - 1
    assert [accepts(n) for n in (last - 1, last - 1, last, 0, last, 0, 1)] == [
        True, False, True, True, False, False, True,
    ]  # fmt: skip
    assert reach.counts["duplicate"] == 3


def test_segments_that_somebody_has_made_up_leave_room_when_they_are_silent() -> None:
    """4,096 messages of one hostile device shut out every segment that was heard later, for good."""
    reach = SegmentReachability(1)
    summary = Summary(1, 0, 0, 0, 10, 0, 0, 0, {}, {1: 0})

    def hears(segment: int, now_us: int) -> bool:
        header = BackboneHeader(BackboneKind.SUMMARY, segment, 0, 124, 7, now_us + 1)
        accepted = reach.accepts(header, now_us)
        if accepted:
            reach.on_summary(header, summary, now_us)
        return accepted

    real = 2
    assert hears(real, 0)
    made_up = range(100, 100 + SEGMENTS_MAX)
    assert sum(hears(segment, GONE_US // 2) for segment in made_up) == SEGMENTS_MAX - 1
    assert hears(real, GONE_US) and not hears(3, GONE_US), "there is no room for more that speak"
    assert hears(3, 2 * GONE_US - 1)
    assert reach.reached(2 * GONE_US - 1) == [real, 3] == sorted(reach.remotes)
