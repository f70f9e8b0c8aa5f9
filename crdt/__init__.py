"""Replicated state: pure values joined by maximum or union; no clocks, no I/O."""

from crdt.allocation import FieldAllocationCRDT
from crdt.clock import Dot, VectorClock
from crdt.progress import Progress
from crdt.register import Claim, Phase

__all__ = ["Claim", "Dot", "FieldAllocationCRDT", "Phase", "Progress", "VectorClock"]
