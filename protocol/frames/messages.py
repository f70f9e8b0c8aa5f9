"""Every kind of frame: one union of message types, and one table of layouts by urgency."""

from typing import Any

from protocol.frames import (
    agreement_frames,
    delivery_frames,
    diagnostic_frames,
    fleet_frames,
    key_frames,
    map_frames,
    network_frames,
    operator_frames,
    safety_frames,
    segment_frames,
    task_frames,
    terminal_frames,
    trust_frames,
    work_frames,
)
from protocol.frames.agreement_frames import AgreementMessage, SilentPosition
from protocol.frames.delivery_frames import (
    Itinerary,
    PlanOffer,
    PlanRow,
    TaskBid,
    TaskBookDigest,
    TaskOrder,
)  # fmt: skip
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
from protocol.frames.layout import FrameLayout
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
from protocol.frames.task_frames import ProcessData, WorkingSetMaster
from protocol.frames.terminal_frames import TerminalMessage, TerminalRequest
from protocol.frames.trust_frames import FleetTimeTold, OperatorBadge, Proof, TimeQuestion
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
    | StateSyncRequest | StateSyncResponse | Digests | VectorSlice | WorkProgress | AgreementMessage
    | SilentPosition
    | MapPatch | MapDigests
    | TaskOrder | TaskBookDigest | TaskBid | Itinerary | PlanOffer | PlanRow
    | FleetStop | FleetReset | GatewayBeat | SegmentSummary
    | Proof | TimeQuestion | FleetTimeTold | OperatorBadge
    | KeyPart | KeySwitch | KeysHeld
    | AddressClaimed | Request | Request2 | RepetitionRateRequest | Acknowledgment
    | TransportManagement | TransportData
    | ActiveFaults | PreviousFaults | DiagnosticProtocols | Functionalities
    | BroadcastControl | ClearFault | StandardHeartbeat
    | ProcessData | WorkingSetMaster
    | ExtendedTransportManagement | ExtendedTransportData | TerminalMessage | TerminalRequest
)  # fmt: skip

# Raised when robots with the frames before would misread ours: with another layout, meaning or PGN of a
# frame that robots send each other. `tests/protocol/test_frames_version.py` has the layouts of this one.
FRAMES_VERSION = 1
VERSION_STEP = 0x9E37_79 | 1  # odd, so that every version has another hash
HASH_BITS = 24


def configuration_hash(work: int, version: int = FRAMES_VERSION) -> int:
    """24 bits that robots compare before they work together: of their work, and of their frames.

    `work`: hash of the description of the work, 24 bits. Version 1 changes nothing, because robots of
    before compare the work alone."""
    return (work + (version - 1) * VERSION_STEP) & ((1 << HASH_BITS) - 1)


# By PGN family and priority; `docs/how/frames.md` is in this order.
GROUPS: tuple[FrameLayout[Any], ...] = (
    safety_frames.EMERGENCY_STOP,
    safety_frames.EMERGENCY_RESET,
    safety_frames.HELD_RESET,
    segment_frames.FLEET_STOP,
    segment_frames.FLEET_RESET,
    operator_frames.OPERATOR_GOAL,
    safety_frames.OPERATOR_COMMAND,
    safety_frames.CHALLENGE,
    safety_frames.FRESHNESS,
    trust_frames.OPERATOR_BADGE,
    key_frames.KEY_SWITCH,
    safety_frames.ALL_IMPLEMENTS_STOP,
    fleet_frames.LEADER_ELECTION_VOTE,
    operator_frames.OPERATOR_REPORT,
    safety_frames.STOPS_HELD,
    work_frames.TASK_CLAIM,
    fleet_frames.POSE,
    fleet_frames.HEARTBEAT,
    fleet_frames.MEMBER,
    key_frames.KEY_PART,
    key_frames.KEYS_HELD,
    fleet_frames.STANDSTILL,
    work_frames.STATE_SYNC_REQUEST,
    work_frames.WORK_PROGRESS,
    agreement_frames.ACCORD,
    agreement_frames.FALLEN,
    work_frames.STATE_SYNC_RESPONSE,
    work_frames.DIGESTS,
    fleet_frames.VECTOR_SLICE,
    map_frames.MAP_PATCH,
    map_frames.MAP_DIGESTS,
    delivery_frames.TASK_ORDER,
    delivery_frames.TASK_BOOK,
    delivery_frames.TASK_BID,
    delivery_frames.ITINERARY,
    delivery_frames.PLAN_OFFER,
    delivery_frames.PLAN_ROW,
    segment_frames.GATEWAY_BEAT,
    segment_frames.SEGMENT_SUMMARY,
    trust_frames.TIME_QUESTION,
    trust_frames.FLEET_TIME,
    trust_frames.PROOF,
    network_frames.ADDRESS_CLAIMED,
    network_frames.REQUEST,
    network_frames.REQUEST2,
    network_frames.REPETITION_RATE_REQUEST,
    network_frames.ACKNOWLEDGMENT,
    network_frames.TP_CM,
    network_frames.TP_DT,
    network_frames.ETP_CM,
    network_frames.ETP_DT,
    diagnostic_frames.DM1,
    diagnostic_frames.DM2,
    diagnostic_frames.DIAGNOSTIC_PROTOCOLS,
    diagnostic_frames.FUNCTIONALITIES,
    diagnostic_frames.DM13,
    diagnostic_frames.DM22,
    diagnostic_frames.STANDARD_HEARTBEAT,
    task_frames.PROCESS_DATA,
    task_frames.WORKING_SET_MASTER,
    terminal_frames.VT_TO_ECU,
    terminal_frames.ECU_TO_VT,
)
GROUP_OF: dict[type, FrameLayout[Any]] = {layout.kind: layout for layout in GROUPS}
assert len({layout.pgn for layout in GROUPS}) == len(GROUPS)
