"""What a robot tells a task controller of itself: its device description (ISO 11783-10, annex A).

The object pool has a device, two device elements (the device itself and its implement as a function
with one section), what can be asked of them, and units for people.
"""

from collections.abc import Iterator
from struct import pack
from typing import Final, NamedTuple
from zlib import crc32

from protocol.name import Name

# Data dictionary (ISO 11783-11).
DEFAULT_SET: Final = 0xDFFF  # asks for the members of the default set
WIDTH: Final = 67  # actual working width, mm
TOTAL_AREA: Final = 116  # m^2
EFFECTIVE_DISTANCE: Final = 117  # mm
EFFECTIVE_TIME: Final = 119  # s
INEFFECTIVE_TIME: Final = 120  # s
OFFSET_X: Final = 134  # of a device element, mm
OFFSET_Y: Final = 135  # mm
WORK_STATE: Final = 141  # actual work state: 0 up, 1 down
SECTION_CONTROL_STATE: Final = 160  # 0 manual, 1 automatic
CONDENSED_WORK_STATE: Final = 161  # sections 1 to 16, two bits each
SETPOINT_WORK_STATE: Final = 289  # of the whole implement: 0 off, 1 on
SETPOINT_CONDENSED: Final = 290  # of sections 1 to 16, two bits each: 0 off, 1 on
SPEED: Final = 397  # actual, mm/s

DEVICE, FUNCTION, SECTION = ELEMENTS = 0, 1, 2  # element numbers
TYPE_DEVICE, TYPE_FUNCTION, TYPE_SECTION = 1, 2, 4
NONE: Final = 0xFFFF  # an object that is not there
# Ways by which a value may be asked for: bits of a process data object.
BY_TIME, BY_DISTANCE, ON_CHANGE, TOTAL = 1, 2, 8, 16
IN_DEFAULT_SET, SETTABLE = 1, 2  # properties of a process data object
NO_UNITS: Final = bytes((0x65, 0x6E, 0x00, 0x00, 0x00, 0x00, 0xFF))  # localization: "en", metric
VERSION_4: Final = 4
ROBOT_LABEL: Final = b"HL\x01"  # the structure label of every robot begins so


class ProcessValue(NamedTuple):
    """A value of an element that can be asked for, or is counted in a task's totals."""

    element: int
    ddi: int
    properties: int
    triggers: int
    designator: str


_STATE: Final = BY_TIME | BY_DISTANCE | ON_CHANGE
_TOTAL: Final = BY_TIME | BY_DISTANCE | TOTAL
VALUES: Final = (
    ProcessValue(DEVICE, DEFAULT_SET, 0, TOTAL, "default set"),
    ProcessValue(DEVICE, SPEED, 0, _STATE, "speed"),
    ProcessValue(FUNCTION, WORK_STATE, IN_DEFAULT_SET, _STATE, "work state"),
    ProcessValue(FUNCTION, CONDENSED_WORK_STATE, IN_DEFAULT_SET, _STATE, "sections"),
    ProcessValue(FUNCTION, SECTION_CONTROL_STATE, SETTABLE, BY_TIME | ON_CHANGE, "section control"),
    ProcessValue(FUNCTION, SETPOINT_WORK_STATE, SETTABLE, ON_CHANGE, "setpoint work state"),
    ProcessValue(FUNCTION, SETPOINT_CONDENSED, SETTABLE, ON_CHANGE, "setpoint sections"),
    ProcessValue(FUNCTION, TOTAL_AREA, IN_DEFAULT_SET, _TOTAL, "area"),
    ProcessValue(FUNCTION, EFFECTIVE_DISTANCE, 0, _TOTAL, "distance at work"),
    ProcessValue(FUNCTION, EFFECTIVE_TIME, IN_DEFAULT_SET, _TOTAL, "time at work"),
    ProcessValue(FUNCTION, INEFFECTIVE_TIME, 0, _TOTAL, "time not at work"),
)  # fmt: skip
TRIGGERS: Final = {(value.element, value.ddi): value.triggers for value in VALUES}
SET_BY_CONTROLLER: Final = frozenset(
    (value.element, value.ddi) for value in VALUES if value.properties & SETTABLE
)
UNITS: Final = {  # DDI -> factor, decimals, unit for people
    SPEED: (0.0036, 1, "km/h"),
    WIDTH: (0.001, 2, "m"),
    TOTAL_AREA: (0.0001, 2, "ha"),
    EFFECTIVE_DISTANCE: (0.001, 0, "m"),
    EFFECTIVE_TIME: (1 / 3600, 2, "h"),
    INEFFECTIVE_TIME: (1 / 3600, 2, "h"),
}


class DeviceDescription(NamedTuple):
    """One robot as a task controller sees it."""

    name: Name
    designator: str
    release: str  # of the software
    width_mm: int

    @property
    def label(self) -> bytes:
        """The structure label: seven bytes that change with the description."""
        sum32 = crc32(self._objects(VERSION_4, bytes(7)))
        return ROBOT_LABEL + sum32.to_bytes(4, "little")

    def pool(self, version: int) -> bytes:
        """The object pool for a task controller of this version, 3 or 4."""
        return self._objects(version, self.label)

    def _objects(self, version: int, label: bytes) -> bytes:
        return b"".join(self._each(version, label))

    def _each(self, version: int, label: bytes) -> Iterator[bytes]:
        name = self.name.pack().to_bytes(8, "little")
        serial = _text(f"{self.name.identity:07d}")
        device = _head(b"DVC", 0) + _text(self.designator) + _text(self.release or "0") + name
        device += serial + label + NO_UNITS
        yield device + (b"\0" if version >= VERSION_4 else b"")  # no extended label

        units = {ddi: 400 + k for k, ddi in enumerate(UNITS)}
        values = {k: 100 + k for k in range(len(VALUES))}
        fixed = (
            (FUNCTION, OFFSET_X, 0, "offset x"), (FUNCTION, OFFSET_Y, 0, "offset y"),
            (FUNCTION, WIDTH, self.width_mm, "width"), (SECTION, OFFSET_X, 0, "offset x"),
            (SECTION, OFFSET_Y, 0, "offset y"), (SECTION, WIDTH, self.width_mm, "width"),
        )  # fmt: skip
        for number, kind, parent, title in (
            (DEVICE, TYPE_DEVICE, 0, self.designator),
            (FUNCTION, TYPE_FUNCTION, 1 + DEVICE, "implement"),
            (SECTION, TYPE_SECTION, 1 + FUNCTION, "section 1"),
        ):
            children = [values[k] for k, value in enumerate(VALUES) if value.element == number]
            children += [200 + k for k, (element, *_) in enumerate(fixed) if element == number]
            element = _head(b"DET", 1 + number) + bytes((kind,)) + _text(title)
            element += pack("<HHH", number, parent, len(children))
            yield element + pack(f"<{len(children)}H", *children)
        for k, value in enumerate(VALUES):
            data = _head(b"DPD", values[k]) + pack(
                "<HBB", value.ddi, value.properties, value.triggers
            )
            yield data + _text(value.designator) + pack("<H", units.get(value.ddi, NONE))
        for k, (_, ddi, number, title) in enumerate(fixed):
            data = _head(b"DPT", 200 + k) + pack("<Hi", ddi, number) + _text(title)
            yield data + pack("<H", units.get(ddi, NONE))
        for ddi, (factor, decimals, unit) in UNITS.items():
            yield _head(b"DVP", units[ddi]) + pack("<ifB", 0, factor, decimals) + _text(unit)


def _head(kind: bytes, number: int) -> bytes:
    return kind + number.to_bytes(2, "little")


def _text(text: str) -> bytes:
    data = text.encode("utf-8")[:32]
    return bytes((len(data),)) + data
