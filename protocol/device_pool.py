"""The device description of another maker's implement, as it uploads it (ISO 11783-10, annex A).

Nothing in it is trusted: a pool that cannot be read is None, and its maker gets an error code.
"""

from collections.abc import Mapping, Sequence
from struct import calcsize, unpack_from
from typing import Any, Final, NamedTuple

from protocol.device_description import OFFSET_X, OFFSET_Y, TYPE_SECTION, VERSION_4, WIDTH

CONNECTOR: Final = 6  # type of a device element
ELEMENT_MAX: Final = 0xFFF  # 12 bits in process data
OBJECTS_MAX: Final = 4096  # in one pool; large sprayers have about 500
LEVELS_MAX: Final = 16  # of elements above each other; ISO 11783-10 has four
LABEL_BYTES: Final = 7
# No boom is wider than about 60 m. Each 5 cm of ground under a section takes memory, so that a section
# of kilometres would take all of it.
SECTION_WIDTH_MAX_MM: Final = 100_000
SECTIONS_WIDTH_MAX_MM: Final = 1_000_000  # of all together, as some implements have several booms


class Element(NamedTuple):
    """A device element: a part of an implement with a number of its own."""

    number: int
    kind: int
    designator: str
    parent: int  # object number
    children: tuple[int, ...]  # object numbers
    object_number: int  # its own


class BoomSection(NamedTuple):
    """Where a section of a boom is, from the reference point of its device, millimetres."""

    element: int
    ahead_mm: int
    right_mm: int
    width_mm: int


class DevicePool(NamedTuple):
    """What an implement says of itself. Keys are (element, DDI)."""

    designator: str
    name: int
    label: bytes
    localization: bytes
    elements: Mapping[int, Element]
    properties: Mapping[tuple[int, int], int]  # of values that can be asked for or set
    triggers: Mapping[tuple[int, int], int]
    fixed: Mapping[tuple[int, int], int]

    def found(self, ddi: int) -> Sequence[int]:
        """The elements with a value that can be asked for or set. `ddi`: number of ISO 11783-11."""
        return sorted(element for element, each in self.properties if each == ddi)

    def owners(self, of: Sequence[int], ddi: int) -> Sequence[int | None]:
        """For each of these elements the one whose value is for it: itself, or the first above it that
        has this value; else the lowest of all that have it. None if there is none.

        `ddi`: number of ISO 11783-11."""
        by_object = {each.object_number: each for each in self.elements.values()}
        lowest = next(iter(self.found(ddi)), None)
        return [self._owner(element, ddi, by_object, lowest) for element in of]

    def _owner(
        self, number: int, ddi: int, by_object: Mapping[int, Element], lowest: int | None
    ) -> int | None:
        element = self.elements.get(number)
        for _ in range(LEVELS_MAX):  # parents may go round
            if element is None:
                break
            if (element.number, ddi) in self.properties:
                return element.number
            element = by_object.get(element.parent)
        return lowest

    def above(self, number: int) -> Sequence[int]:
        """The elements above the one with this number, the nearest first."""
        by_object = {each.object_number: each for each in self.elements.values()}
        element, found = self.elements.get(number), list[int]()
        while element is not None and len(found) < LEVELS_MAX:  # parents may go round
            element = by_object.get(element.parent)
            if element is not None:
                found.append(element.number)
        return found

    def describes(self, key: tuple[int, int]) -> bool:
        """Whether a value (element, DDI) stands in it."""
        return key in self.properties or key in self.triggers or key in self.fixed

    def sections(self, told: Mapping[tuple[int, int], int]) -> Sequence[BoomSection]:
        """Its sections by their numbers, where their places and widths are known.

        `told`: values that the implement has told since; they come before the fixed ones. There is none
        where a width is refused.
        """
        found = self._found_sections(told)
        return () if _refused(found) else found

    def section_order(self, told: Mapping[tuple[int, int], int]) -> Sequence[int]:
        """The elements of all its sections from left to right, as condensed states have them
        (ISO 11783-11): also of those without a width, as a section that is folded. By their numbers
        where a place is not known.

        `told`: as for `sections`."""
        known = {**self.fixed, **told}
        found = sorted(e.number for e in self.elements.values() if e.kind == TYPE_SECTION)
        right_mm = {number: known.get((number, OFFSET_Y)) for number in found}
        if None in right_mm.values():
            return found
        return sorted(found, key=lambda number: right_mm[number] or 0)

    def refused_sections(self, told: Mapping[tuple[int, int], int]) -> int:
        """How many sections are wider than `SECTION_WIDTH_MAX_MM`, or all if together they are too wide.

        `told`: as for `sections`."""
        return _refused(self._found_sections(told))

    def _found_sections(self, told: Mapping[tuple[int, int], int]) -> Sequence[BoomSection]:
        known = {**self.fixed, **told}
        connectors = [e.number for e in self.elements.values() if e.kind == CONNECTOR]
        hitch_mm = known.get((connectors[0], OFFSET_X), 0) if connectors else 0
        found = []
        for element in self.elements.values():
            width_mm = known.get((element.number, WIDTH), 0)
            if element.kind != TYPE_SECTION or width_mm <= 0:
                continue
            ahead_mm = known.get((element.number, OFFSET_X), 0) - hitch_mm
            right_mm = known.get((element.number, OFFSET_Y), 0)
            found.append(BoomSection(element.number, ahead_mm, right_mm, width_mm))
        return sorted(found)


def _refused(sections: Sequence[BoomSection]) -> int:
    if sum(section.width_mm for section in sections) > SECTIONS_WIDTH_MAX_MM:
        return len(sections)
    return sum(section.width_mm > SECTION_WIDTH_MAX_MM for section in sections)


class _Reader:
    """Reads fields one after the other. Raises ValueError at the end of the bytes."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, form: str) -> Any:
        """One little-endian number, as `struct` names it."""
        size = calcsize("<" + form)
        if self.at + size > len(self.data):
            raise ValueError("the pool ends within an object")
        (value,) = unpack_from("<" + form, self.data, self.at)
        self.at += size
        return value

    def octets(self, size: int) -> bytes:
        """So many bytes."""
        if self.at + size > len(self.data):
            raise ValueError("the pool ends within an object")
        self.at += size
        return self.data[self.at - size : self.at]

    def text(self) -> str:
        """A length and a text in UTF-8."""
        return self.octets(self.take("B")).decode("utf-8", "replace")


def read_pool(data: bytes, version: int) -> DevicePool | None:
    """The description in these bytes, of a client that speaks this version; None if it is none."""
    try:
        return _read(data, version)
    except ValueError:
        return None


def _read(data: bytes, version: int) -> DevicePool:
    reader, count = _Reader(data), 0
    device: tuple[str, int, bytes, bytes] | None = None
    elements: dict[int, Element] = {}
    values: dict[int, tuple[int, int, int]] = {}  # object -> DDI, properties, triggers
    fixed: dict[int, tuple[int, int]] = {}  # object -> DDI, value
    while reader.at < len(data):
        count += 1
        kind, number = reader.octets(3), reader.take("H")
        if count > OBJECTS_MAX:
            raise ValueError("too many objects")
        match kind:
            case b"DVC":
                designator, _, name = reader.text(), reader.text(), reader.take("Q")
                reader.text()  # serial number
                label, language = reader.octets(LABEL_BYTES), reader.octets(LABEL_BYTES)
                device = designator, name, label, language
                if version >= VERSION_4:
                    reader.octets(reader.take("B"))  # extended structure label
            case b"DET":
                element_kind, title = reader.take("B"), reader.text()
                element, parent = reader.take("H"), reader.take("H")
                if element > ELEMENT_MAX:
                    raise ValueError("a number that no command has room for")
                children = tuple(reader.take("H") for _ in range(reader.take("H")))
                elements[element] = Element(element, element_kind, title, parent, children, number)
            case b"DPD":
                values[number] = reader.take("H"), reader.take("B"), reader.take("B")
                reader.text()
                reader.take("H")
            case b"DPT":
                fixed[number] = reader.take("H"), reader.take("i")
                reader.text()
                reader.take("H")
            case b"DVP":
                reader.octets(9)  # offset, scale and decimals
                reader.text()
            case _:
                raise ValueError(f"no object {kind!r}")
    if device is None:
        raise ValueError("no device")
    owned = [(e.number, child) for e in elements.values() for child in e.children]
    return DevicePool(
        *device, elements,
        {(e, values[child][0]): values[child][1] for e, child in owned if child in values},
        {(e, values[child][0]): values[child][2] for e, child in owned if child in values},
        {(e, fixed[child][0]): fixed[child][1] for e, child in owned if child in fixed},
    )  # fmt: skip
