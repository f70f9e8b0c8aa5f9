"""Every frame kind with its parameter group, priority and length: one table."""

from typing import NamedTuple

from protocol.frames.accord_frames import Accord, Fallen
from protocol.frames.delivery_frames import (
    Itinerary,
    PlanOffer,
    PlanRow,
    TaskBid,
    TaskBookDigest,
    TaskOrder,
)  # fmt: skip
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
)  # fmt: skip
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
)  # fmt: skip
from protocol.frames.segment_frames import FleetReset, FleetStop, GatewayBeat, SegmentSummary
from protocol.frames.work_frames import (
    Digests,
    StateSyncRequest,
    StateSyncResponse,
    TaskClaim,
    WorkProgress,
)  # fmt: skip

Message = (
    EmergencyStop | EmergencyReset | OperatorCommand | AllImplementsStop | Challenge | Freshness
    | OperatorGoal | OperatorReport | StopsHeld | HeldReset
    | LeaderElectionVote | TaskClaim | Pose | Heartbeat | Member | Standstill
    | StateSyncRequest | StateSyncResponse | Digests | VectorSlice | WorkProgress | Accord | Fallen
    | MapPatch | MapDigests
    | TaskOrder | TaskBookDigest | TaskBid | Itinerary | PlanOffer | PlanRow
    | FleetStop | FleetReset | GatewayBeat | SegmentSummary
    | AddressClaimed | Request | RepetitionRateRequest | Acknowledgment
    | TransportManagement | TransportData
)  # fmt: skip


class Group(NamedTuple):
    kind: type[Message]
    pgn: int
    priority: int
    length: int  # data bytes
    name: str  # as the mission and the standards spell it


GROUPS = (
    Group(EmergencyStop, 0xFF00, 0, 8, "EMERGENCY_STOP"),
    Group(EmergencyReset, 0xFF01, 1, 8, "EMERGENCY_RESET"),
    Group(HeldReset, 0xFF07, 1, 8, "HELD_RESET"),
    Group(FleetStop, 0xFF30, 0, 8, "FLEET_STOP"),
    Group(FleetReset, 0xFF31, 1, 8, "FLEET_RESET"),
    # Priority 1, so that it leaves before its SET_GOAL.
    Group(OperatorGoal, 0xFF06, 1, 8, "OPERATOR_GOAL"),
    Group(OperatorCommand, 0xFF02, 2, 8, "OPERATOR_COMMAND"),
    Group(Challenge, 0xFF03, 2, 8, "CHALLENGE"),
    Group(Freshness, 0xEF00, 2, 8, "FRESHNESS"),
    Group(AllImplementsStop, 0xFD02, 3, 8, "ALL_IMPLEMENTS_STOP"),
    Group(LeaderElectionVote, 0xFF04, 3, 8, "LEADER_ELECTION_VOTE"),
    Group(OperatorReport, 0xFF05, 4, 8, "OPERATOR_REPORT"),
    Group(StopsHeld, 0xFF09, 4, 8, "STOPS_HELD"),
    Group(TaskClaim, 0xFF08, 4, 8, "TASK_CLAIM"),
    Group(Pose, 0xFF10, 5, 8, "POSE"),
    Group(Heartbeat, 0xFF11, 6, 8, "HEARTBEAT"),
    Group(Member, 0xFF14, 6, 8, "MEMBER"),
    Group(Standstill, 0xFF19, 6, 8, "STANDSTILL"),
    Group(StateSyncRequest, 0xFF0C, 6, 8, "STATE_SYNC_REQUEST"),
    Group(WorkProgress, 0xFF13, 6, 8, "WORK_PROGRESS"),
    Group(Accord, 0xFF15, 6, 8, "ACCORD"),
    Group(Fallen, 0xFF18, 6, 8, "FALLEN"),
    Group(StateSyncResponse, 0xFF0D, 7, 8, "STATE_SYNC_RESPONSE"),
    Group(Digests, 0xFF0E, 7, 8, "DIGESTS"),
    Group(VectorSlice, 0xFF12, 7, 8, "VECTOR_SLICE"),
    Group(MapPatch, 0xFF16, 7, 8, "MAP_PATCH"),
    Group(MapDigests, 0xFF17, 7, 8, "MAP_DIGESTS"),
    Group(TaskOrder, 0xFF20, 6, 8, "TASK_ORDER"),
    Group(TaskBookDigest, 0xFF21, 7, 8, "TASK_BOOK"),
    Group(TaskBid, 0xFF22, 5, 8, "TASK_BID"),
    Group(Itinerary, 0xFF23, 7, 8, "ITINERARY"),
    Group(PlanOffer, 0xFF24, 5, 8, "PLAN_OFFER"),
    Group(PlanRow, 0xFF25, 6, 8, "PLAN_ROW"),
    Group(GatewayBeat, 0xFF32, 6, 8, "GATEWAY_BEAT"),
    Group(SegmentSummary, 0xFF33, 7, 8, "SEGMENT_SUMMARY"),
    Group(AddressClaimed, 0xEE00, 6, 8, "ADDRESS_CLAIMED"),
    Group(Request, 0xEA00, 6, 3, "REQUEST"),
    Group(RepetitionRateRequest, 0xCC00, 6, 8, "REPETITION_RATE_REQUEST"),
    Group(Acknowledgment, 0xE800, 6, 8, "ACKNOWLEDGMENT"),
    Group(TransportManagement, 0xEC00, 7, 8, "TP_CM"),
    Group(TransportData, 0xEB00, 7, 8, "TP_DT"),
)
GROUP_OF = {group.kind: group for group in GROUPS}
assert len({group.pgn for group in GROUPS}) == len(GROUPS)
