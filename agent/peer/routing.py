"""The one routing table: which part of a peer handles a message, and which senders it is taken from.

Stops come first, in every state. `docs/how/routes.md` is printed from this table. A fleet of several
segments adds `agent/segments/segment_parts.py`.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from agent.peer.diagnostic_broadcasts import DiagnosticBroadcasts
from agent.peer.fleet_clock import FleetClock
from agent.peer.key_renewal import KeyRenewal
from agent.peer.leader_votes import LeaderVotes
from agent.peer.map_exchange import MapExchange
from agent.peer.member_reports import MemberReports
from agent.peer.membership import Membership
from agent.peer.mission_messages import MissionMessages
from agent.peer.operator_directive import OperatorDirective
from agent.peer.part import Part, Senders
from agent.peer.pgn_responder import PgnResponder
from agent.peer.proven_frames import ProvenFrames
from agent.peer.sender_origins import SenderOrigins
from agent.peer.state_sync import StateSync
from agent.peer.stop_reception import StopReception
from agent.peer.stop_release import StopRelease
from agent.peer.task_reporting import TaskReporting
from agent.peer.terminal_service import TerminalService
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
from protocol.frames.diagnostic_frames import (
    ActiveFaults,
    BroadcastControl,
    ClearFault,
    DiagnosticProtocols,
    Functionalities,
    PreviousFaults,
    StandardHeartbeat,
)
from protocol.frames.fleet_frames import (
    Heartbeat,
    LeaderElectionVote,
    Member,
    Pose,
    Standstill,
    VectorSlice,
)
from protocol.frames.key_frames import KeyPart, KeysHeld, KeySwitch
from protocol.frames.map_frames import MapDigests, MapPatch
from protocol.frames.network_frames import (
    Acknowledgment,
    AddressClaimed,
    ExtendedTransportData,
    ExtendedTransportManagement,
    RepetitionRateRequest,
    Request,
    Request2,
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
from protocol.frames.task_frames import ProcessData, WorkingSetMaster
from protocol.frames.terminal_frames import TerminalMessage, TerminalRequest
from protocol.frames.trust_frames import FleetTimeTold, OperatorBadge, Proof, TimeQuestion
from protocol.frames.work_frames import (
    Digests,
    StateSyncRequest,
    StateSyncResponse,
    TaskClaim,
    WorkProgress,
)

URGENT, DEVICE, ANYONE, MEMBER = Senders.URGENT, Senders.DEVICE, Senders.ANYONE, Senders.MEMBER
MEMBER_ONLY = Senders.MEMBER_ONLY


class MessageRoute(NamedTuple):
    """The part that handles a message, and the senders that it is taken from."""

    part: type[Part]
    senders: Senders


Routes = Mapping[type[Any], MessageRoute]
ROUTES: Routes = {
    EmergencyStop: MessageRoute(StopReception, URGENT),
    EmergencyReset: MessageRoute(StopReception, ANYONE),
    HeldReset: MessageRoute(StopReception, ANYONE),
    AllImplementsStop: MessageRoute(StopReception, ANYONE),
    Challenge: MessageRoute(StopReception, ANYONE),
    Freshness: MessageRoute(StopReception, ANYONE),
    OperatorBadge: MessageRoute(StopReception, ANYONE),
    KeyPart: MessageRoute(KeyRenewal, ANYONE),
    KeySwitch: MessageRoute(KeyRenewal, ANYONE),
    KeysHeld: MessageRoute(KeyRenewal, ANYONE),
    StopsHeld: MessageRoute(StopRelease, MEMBER_ONLY),
    Proof: MessageRoute(ProvenFrames, ANYONE),
    TimeQuestion: MessageRoute(FleetClock, ANYONE),
    FleetTimeTold: MessageRoute(FleetClock, ANYONE),
    OperatorCommand: MessageRoute(OperatorDirective, ANYONE),
    OperatorGoal: MessageRoute(OperatorDirective, ANYONE),
    Pose: MessageRoute(Membership, ANYONE),
    Heartbeat: MessageRoute(Membership, ANYONE),
    Member: MessageRoute(Membership, ANYONE),
    Standstill: MessageRoute(MemberReports, MEMBER_ONLY),
    VectorSlice: MessageRoute(MemberReports, ANYONE),
    LeaderElectionVote: MessageRoute(LeaderVotes, MEMBER_ONLY),
    TaskClaim: MessageRoute(StateSync, MEMBER),
    WorkProgress: MessageRoute(StateSync, MEMBER),
    StateSyncRequest: MessageRoute(StateSync, ANYONE),
    StateSyncResponse: MessageRoute(StateSync, MEMBER),
    Digests: MessageRoute(StateSync, MEMBER),
    MapPatch: MessageRoute(MapExchange, MEMBER),
    MapDigests: MessageRoute(MapExchange, MEMBER),
    AgreementMessage: MessageRoute(MissionMessages, MEMBER),
    SilentPosition: MessageRoute(MissionMessages, MEMBER),
    TaskOrder: MessageRoute(MissionMessages, ANYONE),
    TaskBookDigest: MessageRoute(MissionMessages, ANYONE),
    TaskBid: MessageRoute(MissionMessages, MEMBER),
    Itinerary: MessageRoute(MissionMessages, MEMBER),
    PlanOffer: MessageRoute(MissionMessages, MEMBER),
    PlanRow: MessageRoute(MissionMessages, MEMBER),
    AddressClaimed: MessageRoute(SenderOrigins, ANYONE),
    Malformed: MessageRoute(SenderOrigins, ANYONE),
    Request: MessageRoute(PgnResponder, DEVICE),
    Request2: MessageRoute(PgnResponder, DEVICE),
    RepetitionRateRequest: MessageRoute(DiagnosticBroadcasts, DEVICE),
    ProcessData: MessageRoute(TaskReporting, DEVICE),
    Acknowledgment: MessageRoute(TaskReporting, DEVICE),
    BroadcastControl: MessageRoute(DiagnosticBroadcasts, DEVICE),
    ClearFault: MessageRoute(DiagnosticBroadcasts, DEVICE),
    TransportManagement: MessageRoute(PgnResponder, DEVICE),
    TransportData: MessageRoute(PgnResponder, DEVICE),
    TerminalMessage: MessageRoute(TerminalService, DEVICE),
    ExtendedTransportManagement: MessageRoute(TerminalService, DEVICE),
    ExtendedTransportData: MessageRoute(TerminalService, DEVICE),
}
# Messages that no robot handles, and which devices they are for.
NOT_FOR_ROBOTS: Mapping[type[Any], str] = {
    OperatorReport: "operators' devices",
    ActiveFaults: "diagnostic tools",
    PreviousFaults: "diagnostic tools",
    DiagnosticProtocols: "diagnostic tools",
    Functionalities: "diagnostic tools",
    StandardHeartbeat: "the device that asked for it",
    WorkingSetMaster: "task controllers and virtual terminals",
    TerminalRequest: "virtual terminals",
}
