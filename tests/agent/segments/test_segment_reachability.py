"""Which messages of other segments a gateway reads."""

from agent.segments.segment_reachability import SegmentReachability
from protocol.backbone_messages import BackboneHeader, BackboneKind


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
