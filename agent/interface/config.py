"""Every number of a peer with its unit and its reason; relations between them are asserted.

Times are integer microseconds. Sources: design decisions, ISO 11783-5/-7, SAE J1939-21, and the
response-time analysis of Davis, Burns, Bril and Lukkien (2007) for 250 kbit/s.
"""

from typing import Final, NamedTuple

from protocol.units import FRAME_US as FRAME_US
from protocol.units import MS as MS
from protocol.units import S as S

PEERS_MAX: Final = 108  # self-configurable addresses of industry group 2: 128 to 235 (ISO 11783-5)
ADDRESS_FIRST, ADDRESS_LAST = 128, 235
assert ADDRESS_LAST - ADDRESS_FIRST + 1 == PEERS_MAX
OPERATOR_SLOT_FIRST: Final = 128  # slots below are robots; operator devices have 128 to 254
assert PEERS_MAX <= OPERATOR_SLOT_FIRST

ACTUATOR_TTL_US: Final = 100 * MS  # a drive command is void after two missed control periods
CONTROL_PERIOD_US: Final = 50 * MS  # sense, decide, drive
assert ACTUATOR_TTL_US >= 2 * CONTROL_PERIOD_US
# After a command a sound implement is down, and is sensed so.
IMPLEMENT_FOLLOWS_US: Final = 300 * MS
# Of a scan of range sensors: five missed ones of 10 Hz. The slowest common sensors make five a second.
# A robot at 2.5 m/s drives 1.25 m meanwhile, half of what it looks ahead.
SCAN_AGE_MAX_US: Final = 500 * MS

# The source repeats a stop until all live members have echoed it: 13 % of the bus.
STOP_REPEAT_US: Final = 5 * MS
STOP_SPACING_US: Final = 100 * MS  # new stop dots of one source are at least this far apart
# A claim is contested this long. ISO 11783-5 has the same time for addresses.
CONTENTION_US: Final = 250 * MS
# Sections claimed beyond the one being worked. The rest of a plan is not claimed.
CLAIM_AHEAD: Final = 1
MEMBERSHIP_STABLE_US: Final = 2 * S  # a protective stop ends only after this long without a change
# A silent owner keeps its sections this long. Others do their own work first.
LEASE_US: Final = 20 * S


class BeaconTiming(NamedTuple):
    """How often a peer sends, and how long silence is tolerated, for one size of fleet."""

    peers_max: int
    pose_period_us: int  # period of POSE, the beat
    heartbeat_period_us: int
    silence_for_us: int  # a member silent for longer, without leaving, causes a protective stop
    # In a fleet with keys: a member that proved nothing for longer counts as silent, though beacons
    # come in its name. A proof goes with each heartbeat.
    life_for_us: int


# Faster beats would not fit the bus. At these periods and worst-case stuffing, 20 peers take 28 %,
# 30 take 42 %, 50 take 35 % and 108 take 40 %. Claims, progress and identity frames take 1 or 2 %
# more. With one heartbeat a second, 108 peers would take 43 %.
BEATS: Final = (
    BeaconTiming(30, 50 * MS, 500 * MS, 300 * MS, 1_600 * MS),
    BeaconTiming(50, 100 * MS, 1 * S, 500 * MS, 2_200 * MS),
    BeaconTiming(PEERS_MAX, 200 * MS, 1_400 * MS, 1 * S, 3 * S),
)
MEMBER_EVERY: Final = 20  # heartbeats between two MEMBER announcements, for robots that missed one
STANDSTILL_US: Final = 1 * S  # between two reported causes: 7 % of the bus if 108 robots stand
FAULTS_PERIOD_US: Final = 1 * S  # of DM1 (SAE J1939-73)
STANDARD_HEARTBEAT_US: Final = 100 * MS  # the only rate of ISO 11783-7
# A pose is extrapolated until it is this old. By then a robot that fell silent has braked.
GONE_QUIET_US: Final = 1 * S
# The farewell of a member that moves faster is not believed. POSE has steps of 0.05 m/s; at this speed
# a body stands within 5 mm.
FAREWELL_SPEED_M_S: Final = 0.1
LEAVES_WITHIN_US: Final = 5 * S  # a robot that is told to leave brakes for at most this long
for _beat in BEATS:
    assert 5 <= _beat.silence_for_us / _beat.pose_period_us <= 6, (
        "five or six beats may be lost before a stop"
    )
    assert _beat.heartbeat_period_us % _beat.pose_period_us == 0, "a heartbeat rides on a beat"
    assert _beat.life_for_us >= 2 * _beat.heartbeat_period_us + 200 * MS, "one proof may be lost"
    _share = _beat.peers_max * FRAME_US * (1 / _beat.pose_period_us + 1 / _beat.heartbeat_period_us)
    assert _share <= 0.45, "the beats of a full fleet leave more than half of the bus for the rest"
    assert _beat.silence_for_us <= GONE_QUIET_US, "a member is silent before its pose is given up"
assert BEATS[0].silence_for_us <= 300 * MS, (
    "the only bus-native figure for silence: ISO 11783-7 heartbeat"
)


def beat_of(peers: int) -> BeaconTiming:
    """The beacon timing for a fleet of this many configured members, 1 to `PEERS_MAX`.

    Raises StopIteration for more than `PEERS_MAX`.

    >>> beat_of(6).pose_period_us
    50000
    """
    return next(beat for beat in BEATS if peers <= beat.peers_max)


SPEED_MAX_M_S: Final = 12.7  # range of POSE: 8 bits of 0.05 m/s
EXTENT_MAX_M: Final = 3_276.0  # range of POSE: 17 bits of 0.05 m around the origin
# ORCA half-planes of robots, nearest first (van den Berg et al. 2011, section 6).
NEIGHBOURS_MAX = 10
NEIGHBOUR_RANGE_M: Final = 5.0  # ORCA ignores robots that are further away
BRAKING_SHARE: Final = 0.7  # share of the acceleration used in plans; the rest is for corrections
