"""What a peer has in addition in a fleet of several segments: two parts, and rows for the routing table.

On its own segment frames and rules are the same. Added are stops and resets for all segments
(`agent/segments/fleet_stops.py`), and whether other segments are reached
(`agent/segments/remote_segments.py`). A section lent by another segment is claimed only while that
segment is reached, because only that segment decides about it.
"""

from agent.interface.identity import SilencePolicy
from agent.peer.part import Senders
from agent.peer.peer import Peer, Segments
from agent.peer.peer_parts import PeerParts
from agent.peer.routing import MessageRoute, Routes
from agent.segments.fleet_stops import FleetStops
from agent.segments.remote_segments import RemoteSegments
from agent.segments.segment_area import Area
from agent.segments.work_relay import LAST_SLOT
from protocol.fleet_tags import FleetTags
from protocol.frames.fleet_frames import Pose
from protocol.frames.map_frames import MapDigests, MapPatch
from protocol.frames.segment_frames import FleetReset, FleetStop, GatewayBeat, SegmentSummary
from protocol.frames.trust_frames import Proof, TimeQuestion
from protocol.frames.work_frames import (
    StateSyncRequest,
    StateSyncResponse,
    TaskClaim,
    WorkProgress,
)

SEGMENT_ROUTES: Routes = {
    FleetStop: MessageRoute(FleetStops, Senders.URGENT),
    FleetReset: MessageRoute(FleetStops, Senders.ANYONE),
    GatewayBeat: MessageRoute(RemoteSegments, Senders.GATEWAY),
    SegmentSummary: MessageRoute(RemoteSegments, Senders.GATEWAY),
}
# What a gateway brings from other segments, as if one of its robots were a member here.
CARRIED = frozenset((
    TaskClaim, WorkProgress, StateSyncRequest, StateSyncResponse, MapPatch, MapDigests, FleetReset,
    Proof, TimeQuestion,
))  # fmt: skip


def segments_of(parts: PeerParts, area: Area, policy: SilencePolicy, now_us: int) -> Segments:
    """The additional parts of one peer, which share its stops and its claims.

    `area`: the sections that concern its segment. `policy`: what it does if no other segment is
    reached any more.
    """
    guests = frozenset(area.guest(segment) for segment in area.neighbours)
    admission = parts.admission
    admission.owners = parts.identity.members | guests | {LAST_SLOT}
    if admission.sections:
        admission.sections = admission.sections | area.borrowed.keys()
    keyring = parts.safety.authority.keyring
    tags = None if keyring is None else FleetTags(keyring.keys)
    stops = FleetStops(area.segment, parts.safety, parts.senders, tags)
    remote = RemoteSegments(area, policy, parts.safety, now_us)
    parts.work.may_claim = remote.may_claim
    return Segments((stops, remote), SEGMENT_ROUTES, CARRIED, {Pose: stops.on_pose})


def remote_segments_of(peer: Peer) -> RemoteSegments:
    """What this peer knows of other segments. Raises StopIteration in a fleet of one segment."""
    return next(part for part in peer.parts if isinstance(part, RemoteSegments))
