"""Tags that are valid in all segments: 24 bits for stops, 48 bits for resets.

A tag covers the whole dot (segment, slot, incarnation, counter), which identifies one press
forever. So it needs no counter of its own, and a gateway can forward it without holding a secret.
After a replay, a cleared stop stays cleared, and a reset clears only what it has already cleared. A
replay can only press again a dot that no robot remembers; this stops robots and releases none.

The 48 bits of a reset are in two frames and compared together, so guessing one half at a time gives
no information. At a bus full of guesses, 1,500 frames a second, that takes 6,000 years. A device
that holds the fleet's secrets can make both tags. Robots hold them; gateways and listeners on the
backbone do not.
"""

from typing import TYPE_CHECKING, Final

from crdt.stops import RemoteStopDot
from protocol.authentication import KEY_SIZE, Keys
from protocol.ciphers import derived_key, mac_of
from protocol.frames.safety_frames import STOPS_HELD, StopsHeld
from protocol.frames.segment_frames import FleetReset, FleetStop

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.cmac import CMAC

HELD_INFO = b"headland stops held"
QUESTION_BITS: Final = 48  # of the nonce in a question about held stops


def held_key(operators: bytes) -> bytes:
    """The key of `HeldTags`, for key files of devices that may release."""
    return derived_key(operators, HELD_INFO, KEY_SIZE)


class FleetTags:
    """Makes the tagged stops and resets that all segments accept, as far as its keys allow."""

    def __init__(self, keys: Keys) -> None:
        self._stop = _mac(keys.master, b"headland fleet stop")
        self._reset = _mac(keys.operator, b"headland fleet reset")

    def stop(self, dot: RemoteStopDot) -> FleetStop:
        """The tagged stop. Raises ValueError if the fleet's secret is not held here."""
        tag = int.from_bytes(_sum(self._stop, dot)[:3], "little")
        return FleetStop(dot.segment, *dot[:3], tag)

    def reset(self, dot: RemoteStopDot) -> tuple[FleetReset, FleetReset]:
        """Both halves of the tagged reset. Raises ValueError if the operator's secret is not held
        here."""
        tag = _sum(self._reset, dot)
        halves = [int.from_bytes(tag[3 * part : 3 * part + 3], "little") for part in (0, 1)]
        first, second = (
            FleetReset(dot.segment, part, *dot[:3], half) for part, half in enumerate(halves)
        )
        return first, second


class HeldTags:
    """Tags that prove to an operator, which has just asked, that a robot of this fleet holds these
    stops. Robots hold the operator's secret; an operator's device holds no other secret."""

    def __init__(self, keys: Keys) -> None:
        self._held = None if keys.held is None else mac_of(keys.held)
        if self._held is None:
            self._held = _mac(keys.operator, HELD_INFO)

    def sign(self, held: StopsHeld, question: int) -> StopsHeld:
        """The frame with its tag, which answers `question`: the nonce of the challenge.
        Raises ValueError if the operator's secret is not held here."""
        if self._held is None:
            raise ValueError("the secret for this tag is not held here")
        running = self._held.copy()
        running.update(question.to_bytes(QUESTION_BITS // 8, "little") + STOPS_HELD.pack(held)[:-3])
        return held._replace(tag=int.from_bytes(running.finalize()[:3], "little"))


def plain_stop(dot: RemoteStopDot) -> FleetStop:
    """The stop of a fleet without keys."""
    return FleetStop(dot.segment, *dot[:3])


def plain_reset(dot: RemoteStopDot) -> tuple[FleetReset, FleetReset]:
    """Both halves of the reset of a fleet without keys."""
    return FleetReset(dot.segment, 0, *dot[:3]), FleetReset(dot.segment, 1, *dot[:3])


def _mac(secret: bytes | None, info: bytes) -> "CMAC | None":
    if secret is None:
        return None
    return mac_of(derived_key(secret, info, KEY_SIZE))


def _sum(mac: "CMAC | None", dot: RemoteStopDot) -> bytes:
    if mac is None:
        raise ValueError("the secret for this tag is not held here")
    running = mac.copy()
    running.update(bytes(dot[:3]) + dot.segment.to_bytes(2, "little"))
    return running.finalize()
