"""What a wheel controller is told: one sentence every 50 ms, in the form of NMEA 0183.

    $PHLW,<number>,<life>,<implement>,<steering>,<wheel>[,<wheel>...]*<checksum>

| field | content |
|---|---|
| number | counts the sentences, 0 to 999 |
| life | milliseconds; the wheels stand when no sentence has arrived for this long |
| implement | 1: lowered, 0: raised |
| steering | radians, left positive; 0 without steered wheels |
| wheel | rad/s, forward positive |

The wheels are front left, front right, rear left, rear right of a mecanum body, left and right of a
differential one, and the axle of an Ackermann one.

The checksum is that of NMEA 0183. A controller ignores a sentence whose checksum is wrong.

A controller that has stalled finds several sentences in its buffer. It takes the newest complete one and
discards the backlog: obeyed one after another, old commands would each live again. `LinePort` sends
nothing while older bytes are unacknowledged, but cannot call back what the controller's system took.
"""

from collections.abc import Iterable
from functools import reduce
from math import isfinite
from operator import xor
from typing import Final, NamedTuple

from agent.motion.wheel_kinematics import WheelSpeeds

ADDRESS: Final = b"PHLW"
NUMBERS: Final = 1000
WHEELS_MAX: Final = 4
LIFE_MAX_MS: Final = 1000


class WheelSentence(NamedTuple):
    """The fields of a line to the controller of the wheels."""

    number: int
    life_for_ms: int
    implement: bool
    speeds: WheelSpeeds


def checked(body: bytes) -> bytes:
    """A whole sentence: `body` between the dollar sign and its checksum."""
    return b"$%b*%02X\r\n" % (body, reduce(xor, body, 0))


def pack(sentence: WheelSentence) -> bytes:
    """The bytes of a sentence."""
    number, life_for_ms, implement, speeds = sentence
    fields: Iterable[str] = (f"{speed:.4f}" for speed in (speeds.steer_rad, *speeds.wheels_rad_s))
    text = f"{number},{life_for_ms},{int(implement)},{','.join(fields)}"
    return checked(ADDRESS + b"," + text.encode())


def unpack(line: bytes) -> WheelSentence | None:
    """The sentence in a line without its end; None if it is none."""
    body, star, checksum = line.removeprefix(b"$").partition(b"*")
    if not line.startswith(b"$") or not star or checksum != b"%02X" % reduce(xor, body, 0):
        return None
    address, *fields = body.split(b",")
    if address != ADDRESS or not 5 <= len(fields) <= 4 + WHEELS_MAX:
        return None
    try:
        number, life_for_ms, implement = (int(field) for field in fields[:3])
        steer_rad, *wheels = (float(field) for field in fields[3:])
    except ValueError:
        return None
    if not all(map(isfinite, (steer_rad, *wheels))) or not 0 <= life_for_ms <= LIFE_MAX_MS:
        return None
    return WheelSentence(number, life_for_ms, implement == 1, WheelSpeeds(tuple(wheels), steer_rad))
