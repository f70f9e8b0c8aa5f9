"""Which other segments a gateway receives, and which of them receive it.

A segment counts as reached if both directions work: over a one-way link its summaries arrive but do
not name us. Gateways of one segment are distinguished by term: an earlier one is fenced off.
"""

from collections import Counter
from dataclasses import dataclass, field

from agent.interface.config import S
from protocol.backbone_messages import BackboneHeader, BackboneKind, Summary

GONE_US = 2 * S  # four summaries are missing
SEQUENCES = 1 << 32  # numbers of messages; they begin again after a year or two of a busy gateway
SEGMENTS_MAX = 4096  # segments kept, a few hundred bytes each; larger fleets are not supported


@dataclass
class RemoteSegment:
    """Another segment, as its leading gateway reports it."""

    term: int = 0
    heard_at_us: int = -GONE_US
    hears_this_segment: bool = False
    summary: Summary | None = None
    last: dict[int, tuple[int, int]] = field(default_factory=dict)  # candidate -> boot, sequence


class SegmentReachability:
    """What one gateway knows about the other segments, from their messages."""

    def __init__(self, segment: int) -> None:
        self.segment = segment
        self.remotes: dict[int, RemoteSegment] = {}
        self.counts: Counter[str] = Counter()
        self.ever = False

    def accepts(self, header: BackboneHeader, now_us: int) -> bool:
        """Whether to read a message: no echo, no duplicate, and not from a gateway that has been
        replaced.
        """
        if header.segment == self.segment:
            self.counts["echo"] += 1
            return False
        if header.kind in (BackboneKind.STOPS, BackboneKind.RESETS):
            return True  # accept them from any gateway: they are idempotent and urgent
        remote = self.remotes.get(header.segment)
        if remote is None:
            if len(self.remotes) >= SEGMENTS_MAX:
                # Somebody may have made them up: what is not heard any more leaves room.
                self.remotes = {s: self.remotes[s] for s in self.heard(now_us)}
            if len(self.remotes) >= SEGMENTS_MAX:
                self.counts["too many"] += 1
                return False
            remote = self.remotes[header.segment] = RemoteSegment()
        if header.term < remote.term and now_us - remote.heard_at_us < GONE_US:
            self.counts["fenced"] += 1
            return False
        boot, sequence = remote.last.get(header.candidate, (-1, -1))
        if (
            boot == header.boot
            and not 0 < (header.sequence - sequence) % SEQUENCES < SEQUENCES // 2
        ):
            self.counts["duplicate"] += 1
            return False
        remote.last[header.candidate] = header.boot, header.sequence
        remote.term = header.term
        return True

    def on_summary(self, header: BackboneHeader, summary: Summary, now_us: int) -> None:
        """Take in the summary of another segment; call it after `accepts`."""
        remote = self.remotes[header.segment]
        kept = summary._replace(heard={}, shared={})  # what grows with the fleet is not kept
        remote.summary, remote.heard_at_us = kept, now_us
        remote.hears_this_segment = self.segment in summary.heard
        self.ever |= remote.hears_this_segment

    def heard(self, now_us: int) -> dict[int, int]:
        """Segments that are received now, with the terms of their gateways."""
        return {s: r.term for s, r in self.remotes.items() if now_us - r.heard_at_us < GONE_US}

    def reached(self, now_us: int) -> list[int]:
        """Segments that we receive and that receive us."""
        return [s for s in self.heard(now_us) if self.remotes[s].hears_this_segment]
