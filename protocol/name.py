"""The 64-bit NAME that identifies a device whatever its address is (ISO 11783-5, SAE J1939-81).

    bits   0..20   identity number        40..47  function
          21..31   manufacturer code      48      reserved, 0
          32..34   ECU instance           49..55  device class
          35..39   function instance      56..59  device class instance
                                          60..62  industry group
                                          63      arbitrary address capable

The numerically lower NAME wins a contended address.
"""

from typing import NamedTuple
from zlib import crc32

AGRICULTURE = 2  # industry group
MANUFACTURER = 1407  # open to non-commercial projects
FUNCTION = 128  # first function that depends on industry group and device class
DEVICE_CLASS = 1  # tractor: of robots in virtual time, whose recorded runs depend on each bit
UTILITY_VEHICLE = 24  # device class of ISO 11783-1: of robots on a real bus
OWN_FUNCTIONS = range(128, 255)  # that depend on industry group and device class
TOOL_FUNCTION = 129  # off-board diagnostic or service tool, of the non-specific device class
NON_SPECIFIC = 0  # device class
GATEWAY_FUNCTION = 66  # a device that joins networks: here, the segments of one fleet
OUR_FUNCTIONS = frozenset((FUNCTION, TOOL_FUNCTION, GATEWAY_FUNCTION))
SLOT_BITS = 7  # of the identity number of a robot; the other 14 bits are its fleet

FIELDS = (  # name, shift, bits
    ("identity", 0, 21), ("manufacturer", 21, 11), ("ecu_instance", 32, 3),
    ("function_instance", 35, 5), ("function", 40, 8), ("device_class", 49, 7),
    ("device_class_instance", 56, 4), ("industry_group", 60, 3), ("arbitrary_address", 63, 1),
)  # fmt: skip


class DeviceFields(NamedTuple):
    """Fields of a NAME that are equal for all robots of a fleet."""

    manufacturer: int = MANUFACTURER
    ecu_instance: int = 0
    function_instance: int = 0
    function: int = FUNCTION
    device_class: int = DEVICE_CLASS
    device_class_instance: int = 0


IN_VIRTUAL_TIME = DeviceFields()
ON_A_BUS = DeviceFields(device_class=UTILITY_VEHICLE)


class Name(NamedTuple):
    """The fields of a NAME; the defaults are those of a robot of this project."""

    identity: int
    manufacturer: int = MANUFACTURER
    ecu_instance: int = 0
    function_instance: int = 0
    function: int = FUNCTION
    device_class: int = DEVICE_CLASS
    device_class_instance: int = 0
    industry_group: int = AGRICULTURE
    arbitrary_address: int = 1

    def pack(self) -> int:
        """The NAME as a number; on the wire it is little-endian."""
        number = 0
        for value, (field, shift, bits) in zip(self, FIELDS, strict=True):
            assert 0 <= value < 1 << bits, f"{field} has {bits} bits"
            number |= value << shift
        return number

    @classmethod
    def unpack(cls, number: int) -> "Name":
        """The fields of a 64-bit number, which has none that is invalid."""
        return cls(*((number >> shift) & ((1 << bits) - 1) for _, shift, bits in FIELDS))

    @property
    def hash16(self) -> int:
        """16 bits of the NAME's CRC-32, to tell devices apart in frames without room for 64 bits."""
        return crc32(self.pack().to_bytes(8, "little")) & 0xFFFF


def tool_name(identity: int) -> Name:
    """The NAME of an operator's tool. The highest device class instance makes it lose every
    contended address to a robot."""
    return Name(
        identity, function=TOOL_FUNCTION, device_class=NON_SPECIFIC, device_class_instance=15
    )


def is_ours(name: Name, robot: Name | None = None) -> bool:
    """Whether manufacturer and industry group are ours and the function uses our proprietary
    groups. `robot`: a robot of our fleet, whose fields may be those of another maker."""
    if name.industry_group != AGRICULTURE:
        return False
    known = name.manufacturer == MANUFACTURER and name.function in OUR_FUNCTIONS
    return known or is_robot(name, robot)


def is_robot(name: Name, robot: Name | None = None) -> bool:
    """Whether the NAME is that of a robot of any fleet of ours, not of a tool or a gateway. `robot`: as
    for `is_ours`."""
    kinds = [(MANUFACTURER, FUNCTION)]
    if robot is not None:
        kinds.append((robot.manufacturer, robot.function))
    return name.industry_group == AGRICULTURE and (name.manufacturer, name.function) in kinds


def fleet_of(name: Name) -> int:
    """The 14 bits of a robot's NAME that identify its fleet.

    >>> fleet_of(fleet_name("north", 3)) == fleet_of(fleet_name("north", 4))
    True
    """
    return name.identity >> SLOT_BITS


def fleet_name(fleet: str, slot: int, device: DeviceFields = IN_VIRTUAL_TIME) -> Name:
    """The NAME of a slot of a fleet: the fleet in 14 bits of the identity number, the slot in 7."""
    assert 0 <= slot < 128
    return Name((crc32(fleet.encode()) & 0x3FFF) << SLOT_BITS | slot, *device)
