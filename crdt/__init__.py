"""Replicated state: pure values joined by maximum or union; no clocks, no I/O."""

from crdt.allocation import FieldAllocationCRDT
from crdt.claim_register import Claim, Phase
from crdt.clock import Dot, VectorClock
from crdt.progress import Progress

__all__ = ["Claim", "Dot", "FieldAllocationCRDT", "Phase", "Progress", "VectorClock"]
