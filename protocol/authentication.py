"""Tags on the frames that stop and release a fleet: AES-CMAC, 24 bits, 8 bits of freshness.

After AUTOSAR SecOC profile 1. Each sender has its own key, derived from the fleet's master by HKDF;
operator devices share a key of their own, so that a robot's key releases nobody. The tag covers the
parameter group, the sender, the full 64-bit freshness counter and the payload; 8 bits of the counter
travel. A receiver accepts a counter 1 to 127 ahead of the last it accepted: no replay, and no stale
frame. Guessing a tag succeeds with odds of 2^-24 a try; after `BAD_MAX` bad tags in `BAD_WINDOW_US`
a sender is not listened to for as long.

What this is not: every holder of the master can speak for every robot. It defends against devices
on the bus that do not hold it.
"""

from collections import deque
from typing import NamedTuple, TypeVar

from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.cmac import CMAC
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from protocol.safety_frames import EmergencyReset, EmergencyStop, OperatorCommand

Signed = TypeVar("Signed", EmergencyStop, EmergencyReset, OperatorCommand)

OPERATOR_FIRST = 128  # sender ids from here are operator devices
WINDOW = 127  # a counter this far ahead is fresh; more frames than that are never lost in a row
BAD_MAX = 8
BAD_WINDOW_US = 10_000_000
RESERVE = 256  # counters reserved at a time: one durable write for as many frames
_GROUPS = {EmergencyStop: 0xFF00, EmergencyReset: 0xFF01, OperatorCommand: 0xFF02}


class Keys(NamedTuple):
    """The secrets of a fleet, 16 bytes each."""

    master: bytes
    operator: bytes


class Keyring:
    """Signs for one sender and verifies for all. Counters of others start at what was recalled."""

    def __init__(
        self, keys: Keys, sender: int, sent: int = 0, heard: dict[int, int] | None = None
    ) -> None:
        self.sender, self.sent = sender, sent
        self.heard = dict(heard or {})
        self.accepted = self.bad = self.stale = self.ignored = 0
        self._keys = keys
        self._macs: dict[int, CMAC] = {}
        self._bad_us: dict[int, deque[int]] = {}

    def sign(self, message: Signed) -> Signed:
        """The message with the next freshness and its tag."""
        self.sent += 1
        fresh = message._replace(freshness=self.sent & 0xFF, tag=0)
        return fresh._replace(tag=self._tag(self.sender, self.sent, fresh))

    def verify(self, message: Signed, sender: int, now_us: int) -> bool:
        """Whether `sender` wrote this and we have not accepted it before."""
        bad = self._bad_us.get(sender)
        if bad is not None and len(bad) == BAD_MAX and now_us - bad[0] < BAD_WINDOW_US:
            self.ignored += 1
            return False
        last = self.heard.get(sender, 0)
        ahead = (message.freshness - last) & 0xFF
        if not 1 <= ahead <= WINDOW:
            self.stale += 1
            return False
        counter = last + ahead
        if self._tag(sender, counter, message._replace(tag=0)) != message.tag:
            self.bad += 1
            self._bad_us.setdefault(sender, deque(maxlen=BAD_MAX)).append(now_us)
            return False
        self.heard[sender] = counter
        self.accepted += 1
        return True

    def _tag(
        self, sender: int, counter: int, message: EmergencyStop | EmergencyReset | OperatorCommand
    ) -> int:
        mac = self._mac(sender).copy()
        head = _GROUPS[type(message)].to_bytes(3, "little") + bytes((sender,))
        mac.update(head + counter.to_bytes(8, "little") + message.pack()[:-3])
        return int.from_bytes(mac.finalize()[:3], "little")

    def _mac(self, sender: int) -> CMAC:
        mac = self._macs.get(sender)
        if mac is None:
            secret = self._keys.operator if sender >= OPERATOR_FIRST else self._keys.master
            info = b"headland sender" + bytes((sender,))
            key = HKDF(algorithm=SHA256(), length=16, salt=None, info=info).derive(secret)
            mac = self._macs[sender] = CMAC(AES(key))
        return mac
