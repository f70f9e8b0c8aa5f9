"""The one routing table: which part of a peer handles a message, and from whom it is taken.

Stops come first, in every state. `docs/how/routes.md` is printed from this table. A fleet of several
segments adds `agent/segments/segment_parts.py`.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from agent.peer.leader_votes import LeaderVotes
from agent.peer.map_exchange import MapExchange
from agent.peer.member_reports import MemberReports
from agent.peer.membership import Membership
from agent.peer.mission_messages import MissionMessages
from agent.peer.operator_directive import OperatorDirective
from agent.peer.part import Part, Senders
from agent.peer.pgn_responder import PgnResponder
from agent.peer.sender_origins import SenderOrigins
from agent.peer.state_sync import StateSync
from agent.peer.stop_reception import StopReception
from agent.peer.stop_release import StopRelease
from protocol.frames.agreement_frames import AgreementMessage, SilentPosition
from protocol.frames.codec import Malformed
from protocol.frames.delivery_frames import (
    Itinerary,
    PlanOffer,
    PlanRow,
    TaskBid,
    TaskBookDigest,
    TaskOrder,
)
from protocol.frames.fleet_frames import (
    Heartbeat,
    LeaderElectionVote,
    Member,
    Pose,
    Standstill,
    VectorSlice,
)
from protocol.frames.map_frames import MapDigests, MapPatch
from protocol.frames.network_frames import (
    Acknowledgment,
    AddressClaimed,
    RepetitionRateRequest,
    Request,
    TransportData,
    TransportManagement,
)
from protocol.frames.operator_frames import OperatorGoal, OperatorReport
from protocol.frames.safety_frames import (
    AllImplementsStop,
    Challenge,
    EmergencyReset,
    EmergencyStop,
    Freshness,
    HeldReset,
    OperatorCommand,
    StopsHeld,
)
from protocol.frames.work_frames import (
    Digests,
    StateSyncRequest,
    StateSyncResponse,
    TaskClaim,
    WorkProgress,
)

URGENT, DEVICE, ANYONE, MEMBER = Senders.URGENT, Senders.DEVICE, Senders.ANYONE, Senders.MEMBER
MEMBER_ONLY = Senders.MEMBER_ONLY


class Route(NamedTuple):
    """The part that handles a message, and the senders from whom it is taken."""

    part: type[Part]
    senders: Senders


Routes = Mapping[type[Any], Route]
ROUTES: Routes = {
    EmergencyStop: Route(StopReception, URGENT),
    EmergencyReset: Route(StopReception, ANYONE),
    HeldReset: Route(StopReception, ANYONE),
    AllImplementsStop: Route(StopReception, ANYONE),
    Challenge: Route(StopReception, ANYONE),
    Freshness: Route(StopReception, ANYONE),
    StopsHeld: Route(StopRelease, MEMBER_ONLY),
    OperatorCommand: Route(OperatorDirective, ANYONE),
    OperatorGoal: Route(OperatorDirective, ANYONE),
    Pose: Route(Membership, ANYONE),
    Heartbeat: Route(Membership, ANYONE),
    Member: Route(Membership, ANYONE),
    Standstill: Route(MemberReports, MEMBER_ONLY),
    VectorSlice: Route(MemberReports, ANYONE),
    LeaderElectionVote: Route(LeaderVotes, MEMBER_ONLY),
    TaskClaim: Route(StateSync, MEMBER),
    WorkProgress: Route(StateSync, MEMBER),
    StateSyncRequest: Route(StateSync, ANYONE),
    StateSyncResponse: Route(StateSync, MEMBER),
    Digests: Route(StateSync, MEMBER),
    MapPatch: Route(MapExchange, MEMBER),
    MapDigests: Route(MapExchange, MEMBER),
    AgreementMessage: Route(MissionMessages, MEMBER),
    SilentPosition: Route(MissionMessages, MEMBER),
    TaskOrder: Route(MissionMessages, ANYONE),
    TaskBookDigest: Route(MissionMessages, MEMBER),
    TaskBid: Route(MissionMessages, MEMBER),
    Itinerary: Route(MissionMessages, MEMBER),
    PlanOffer: Route(MissionMessages, MEMBER),
    PlanRow: Route(MissionMessages, MEMBER),
    AddressClaimed: Route(SenderOrigins, ANYONE),
    Malformed: Route(SenderOrigins, ANYONE),
    Request: Route(PgnResponder, DEVICE),
    RepetitionRateRequest: Route(PgnResponder, DEVICE),
    TransportManagement: Route(PgnResponder, DEVICE),
    TransportData: Route(PgnResponder, DEVICE),
}
# Messages that no robot handles, and for whom they are.
NOT_FOR_ROBOTS: Mapping[type[Any], str] = {
    OperatorReport: "operators' devices",
    Acknowledgment: "the device whose request was refused",
}
