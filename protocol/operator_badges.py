"""Badges: what the key of an operator's device allows, and until when.

The secret of a device is derived from the operators' secret of the fleet and its *badge*: its number,
its roles, and the day on which it expires. So the roles cannot be changed without another secret, and
robots need no list of people. A device tells its badge before it proves its counter or an order; the tag
of what follows is right only if the badge is true. The owner's badge allows all and never expires.

A badge that somebody else tells in a device's name makes tags of that device wrong until it proves its
counter again, at the next challenge. That proof is tried under the badges that were told last, and under
the owner's, who tells none. A badge that was proven stays for `PROVEN_FOR_US`.
"""

from collections.abc import Sequence
from enum import IntFlag
from typing import Final, NamedTuple

from protocol.ciphers import derived_key
from protocol.frames.trust_frames import OperatorBadge
from protocol.units import S

SECRET_SIZE: Final = 16  # bytes
DAY_S: Final = 86_400
NEVER: Final = 0  # day of expiry of the owner's badge
PROVEN_FOR_US: Final = 10 * S  # as long as an operator's counter is believed


class Role(IntFlag):
    """What a person may do. A stop by a key without STOP brakes and latches nothing."""

    STOP = 1  # emergency stop, hold, stand until START
    RELEASE = 2  # clear stops, manual reset, start, continue without a silent member
    DIRECT = 4  # send robots to places, answer their questions, start
    TASK = 8  # transport orders


ALL_ROLES: Final = Role.STOP | Role.RELEASE | Role.DIRECT | Role.TASK


class Badge(NamedTuple):
    """Roles of one operator's device."""

    device: int
    roles: Role = ALL_ROLES
    expires_day: int = NEVER  # the first day, counted from 1970-01-01 UTC, on which it is void

    @property
    def owner(self) -> bool:
        """It allows all for ever: the key is the operators' secret itself."""
        return self.roles == ALL_ROLES and self.expires_day == NEVER

    def secret(self, operators: bytes) -> bytes:
        """The secret of this device. `operators`: that of the fleet."""
        if self.owner:
            return operators
        info = b"headland badge" + bytes((self.device, self.roles))
        info += self.expires_day.to_bytes(2, "little")
        return derived_key(operators, info, SECRET_SIZE)

    def told(self) -> OperatorBadge:
        """The frame that tells it."""
        return OperatorBadge(self.device, int(self.roles), self.expires_day)

    def valid(self, day: int | None) -> bool:
        """Whether it has not expired. `day`: today; None: unknown, so only a badge without an end is."""
        return self.expires_day == NEVER or (day is not None and day < self.expires_day)


class BadgeBook:
    """The badges that one robot has heard, and the day that its computer knows."""

    def __init__(self, clock_zero_at_s: int | None = None) -> None:
        """`clock_zero_at_s`: the time of day, seconds since 1970, when `now_us` was 0; None: unknown."""
        self._clock_zero_at_s = clock_zero_at_s
        self._of: dict[int, Badge] = {}
        self._before: dict[int, Badge] = {}  # told before that, and another one
        self._proven_at_us: dict[int, int] = {}

    def correct(self, clock_zero_at_s: int | None) -> None:
        """The computer has learnt the date since. A date never goes back, so that an expired badge
        stays so."""
        known = self._clock_zero_at_s
        if clock_zero_at_s is not None and (known is None or clock_zero_at_s > known):
            self._clock_zero_at_s = clock_zero_at_s

    def hear(self, told: OperatorBadge, now_us: int) -> None:
        """A badge that a device, or somebody in its name, tells."""
        proven_at_us = self._proven_at_us.get(told.device)
        if proven_at_us is not None and now_us - proven_at_us <= PROVEN_FOR_US:
            return
        self._proven_at_us.pop(told.device, None)
        new, last = Badge(told.device, Role(told.roles), told.expires_day), self.of(told.device)
        if new != last:
            self._before[told.device] = last
        self._of[told.device] = new

    def prove(self, device: int, now_us: int, badge: Badge | None = None) -> None:
        """A tag under this badge of the device was right. None: under the one that was told last."""
        if badge is not None:
            self._of[device] = badge
        self._proven_at_us[device] = now_us

    def candidates(self, device: int) -> Sequence[Badge]:
        """At most three badges that a device may have: told last, told before, and the owner's."""
        last = self.of(device)
        return tuple(dict.fromkeys((last, self._before.get(device, last), Badge(device))))

    def forget(self) -> None:
        """The fleet has other keys: what was proven under the old ones counts no more."""
        self._proven_at_us.clear()

    def of(self, device: int) -> Badge:
        """The badge of a device; one that tells none is the owner's."""
        return self._of.get(device, Badge(device))

    def allows(self, device: int, role: Role, now_us: int) -> bool:
        """Whether the badge of a device has one of these roles and has not expired."""
        badge = self.of(device)
        return bool(badge.roles & role) and badge.valid(self.day(now_us))

    def day(self, now_us: int) -> int | None:
        """Days since 1970-01-01 UTC; None: this computer does not know the date."""
        if self._clock_zero_at_s is None:
            return None
        return (self._clock_zero_at_s + now_us // S) // DAY_S
