"""Fault confinement of a CAN controller (ISO 11898-1), as far as its driver reports it."""

from enum import Enum

# Linux SocketCAN, include/uapi/linux/can/error.h: classes in the identifier, details in byte 1.
CONTROLLER, BUS_OFF, RESTARTED = 0x004, 0x040, 0x100
# Warning or passive, receiving or sending; active again.
WARNING_BITS, PASSIVE_BITS, ACTIVE_BIT = 0x0C, 0x30, 0x40


class Health(Enum):
    """The state of a controller's fault confinement. The numbers are not in the order of severity."""

    ACTIVE = 0
    PASSIVE = 1  # too many errors: it may no longer send active error flags
    OFF = 2  # it has left the bus
    WARNING = 3  # 96 errors or more; it still works as an active one


def told_by(error_class: int, data: bytes, was: Health) -> Health:
    """The health after an error frame of SocketCAN; most error frames do not change it.

    `error_class` is the frame's identifier, a set of bits; `data` its 8 bytes; `was` the health
    before.

    >>> told_by(CONTROLLER, bytes((0, 0x20)), Health.ACTIVE)
    <Health.PASSIVE: 1>
    """
    if error_class & BUS_OFF:
        return Health.OFF
    if error_class & RESTARTED:
        return Health.ACTIVE
    if error_class & CONTROLLER and len(data) > 1:
        if data[1] & PASSIVE_BITS:
            return Health.PASSIVE
        if data[1] & WARNING_BITS:
            return Health.WARNING
        if data[1] & ACTIVE_BIT:
            return Health.ACTIVE
    return was
