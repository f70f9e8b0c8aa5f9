"""`headland dbc fleet.arxml`: every frame as an AUTOSAR 4 system description.

cantools reads this format and does not write it, so the few classes that a CAN bus needs are written
here: cluster, frames, PDUs, signals, computation methods, units and ECUs. Element names and their
order are those of the AUTOSAR 4 schema. A system signal is shared by all frames of a group; AUTOSAR
wants the signals and the PDU of each frame apart.
"""

from collections.abc import Iterable, Sequence
from typing import Any, Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from protocol.frames.layout import FrameLayout, Signal
from tools.cli.defined_frames import (
    CYCLE_MS,
    Definition,
    comment_of,
    definitions,
    nodes_of,
    signals_of_groups,
)

NAMESPACE: Final = "http://autosar.org/schema/r4.0"  # of all releases of AUTOSAR 4
SCHEMA: Final = f"{NAMESPACE} AUTOSAR_4-2-2.xsd"
INSTANCE: Final = "http://www.w3.org/2001/XMLSchema-instance"
ROOT: Final = "headland"  # the package that holds all others
BAUDRATE: Final = 250_000
UNUSED_BITS: Final = 255  # SAE J1939-71: what a device does not use is sent as ones
SIZES: Final = (8, 16, 32, 64)  # bits of base types


def to_arxml(addresses: Sequence[int] = ()) -> str:
    """The text of the file. `addresses`: as `tools/cli/defined_frames.py` says."""
    defined, signals = list(definitions(addresses)), signals_of_groups()
    root = Element("AUTOSAR", {
        "xmlns": NAMESPACE, "xmlns:xsi": INSTANCE, "xsi:schemaLocation": SCHEMA,
    })  # fmt: skip
    packages = SubElement(_package(SubElement(root, "AR-PACKAGES"), ROOT), "AR-PACKAGES")
    _cluster(_elements(packages, "clusters"), defined)
    frames = _elements(packages, "frames")
    pdus = _elements(packages, "pdus")
    for each in defined:
        _frame(frames, each)
        _pdu(pdus, each, signals[each.group])
    of_frames = SubElement(_package(packages, "i_signals"), "AR-PACKAGES")
    for each in defined:
        _i_signals(_elements(of_frames, each.name), each, signals[each.group])
    of_groups = SubElement(_package(packages, "system_signals"), "AR-PACKAGES")
    methods = SubElement(_package(packages, "compu_methods"), "AR-PACKAGES")
    for group, own in signals.items():
        system, computed = _elements(of_groups, group.name), _elements(methods, group.name)
        for signal in own:
            _system_signal(system, group, signal)
            _compu_method(computed, signal)
    units = _elements(packages, "units")
    for unit in sorted({s.unit for own in signals.values() for s in own if s.unit}):
        _words(_named(units, "UNIT", _unit_name(unit)), {"DISPLAY-NAME": unit})
    _base_types(_elements(packages, "base_types"))
    _ecus(_elements(packages, "ecus"), nodes_of(addresses))
    _sent_groups(_elements(packages, "pdu_groups"), defined, nodes_of(addresses))
    ElementTree.indent(root, " ")  # deep: with two blanks a third of the file would be blanks
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'


def _cluster(place: Element, defined: Iterable[Definition]) -> None:
    """The bus, and which identifier carries which frame."""
    cluster = SubElement(_named(place, "CAN-CLUSTER", "bus"), "CAN-CLUSTER-VARIANTS")
    variant = SubElement(cluster, "CAN-CLUSTER-CONDITIONAL")
    _words(variant, {"BAUDRATE": f"{BAUDRATE}"})
    channels = SubElement(variant, "PHYSICAL-CHANNELS")
    channel = _named(channels, "CAN-PHYSICAL-CHANNEL", "channel")
    _words(variant, {"PROTOCOL-NAME": "CAN"})
    triggerings = SubElement(channel, "FRAME-TRIGGERINGS")
    for each in defined:
        triggering = _named(triggerings, "CAN-FRAME-TRIGGERING", f"{each.name}_triggering")
        _refer(triggering, "FRAME-REF", "CAN-FRAME", "frames", each.name)
        _words(triggering, {
            "CAN-ADDRESSING-MODE": "EXTENDED", "IDENTIFIER": f"{each.identifier}",
        })  # fmt: skip


def _frame(place: Element, each: Definition) -> None:
    frame = _named(place, "CAN-FRAME", each.name, comment_of(each.group))
    _words(frame, {"FRAME-LENGTH": f"{each.group.length}"})
    mappings = SubElement(frame, "PDU-TO-FRAME-MAPPINGS")
    mapping = _named(mappings, "PDU-TO-FRAME-MAPPING", "mapping")
    _words(mapping, {"PACKING-BYTE-ORDER": "MOST-SIGNIFICANT-BYTE-LAST"})
    _refer(mapping, "PDU-REF", "I-SIGNAL-I-PDU", "pdus", each.name)
    _words(mapping, {"START-POSITION": "0"})


def _pdu(place: Element, each: Definition, signals: Iterable[Signal]) -> None:
    pdu = _named(place, "I-SIGNAL-I-PDU", each.name)
    _words(pdu, {"LENGTH": f"{each.group.length}"})
    cycle_ms = CYCLE_MS.get(each.group)
    if cycle_ms is not None:
        _nested(pdu, "I-PDU-TIMING-SPECIFICATIONS", "I-PDU-TIMING", "TRANSMISSION-MODE-DECLARATION",
                "TRANSMISSION-MODE-TRUE-TIMING", "CYCLIC-TIMING", "TIME-PERIOD",
                "VALUE").text = f"{cycle_ms / 1000}"  # fmt: skip
    mappings = SubElement(pdu, "I-SIGNAL-TO-PDU-MAPPINGS")
    for signal in signals:
        mapping = _named(mappings, "I-SIGNAL-TO-I-PDU-MAPPING", f"{signal.name}_mapping")
        _refer(mapping, "I-SIGNAL-REF", "I-SIGNAL", "i_signals", each.name, signal.name)
        _words(mapping, {
            "PACKING-BYTE-ORDER": "MOST-SIGNIFICANT-BYTE-LAST", "START-POSITION": f"{signal.start}",
        })  # fmt: skip
    _words(pdu, {"UNUSED-BIT-PATTERN": f"{UNUSED_BITS}"})


def _i_signals(place: Element, each: Definition, signals: Iterable[Signal]) -> None:
    for signal in signals:
        i_signal = _named(place, "I-SIGNAL", signal.name)
        _words(i_signal, {"DATA-TYPE-POLICY": "OVERRIDE"})
        if signal.reserved is not None:
            _nested(i_signal, "INIT-VALUE", "NUMERICAL-VALUE-SPECIFICATION",
                    "VALUE").text = f"{signal.reserved}"  # fmt: skip
        _words(i_signal, {"LENGTH": f"{signal.length}"})
        props = _props(i_signal, "NETWORK-REPRESENTATION-PROPS")
        size = next(size for size in SIZES if size >= signal.length)
        _refer(props, "BASE-TYPE-REF", "SW-BASE-TYPE", "base_types", f"uint{size}")
        _refer(i_signal, "SYSTEM-SIGNAL-REF", "SYSTEM-SIGNAL",
               "system_signals", each.group.name, signal.name)  # fmt: skip


def _system_signal(place: Element, group: FrameLayout[Any], signal: Signal) -> None:
    system = _named(place, "SYSTEM-SIGNAL", signal.name, signal.meaning)
    props = _props(system, "PHYSICAL-PROPS")
    _refer(props, "COMPU-METHOD-REF", "COMPU-METHOD", "compu_methods", group.name, signal.name)
    if signal.unit:
        _refer(props, "UNIT-REF", "UNIT", "units", _unit_name(signal.unit))


def _compu_method(place: Element, signal: Signal) -> None:
    """How a raw value becomes a physical one or a name. `raw * scale + offset`, as everywhere."""
    kind = "SCALE_LINEAR_AND_TEXTTABLE" if signal.choices else "LINEAR"
    if not signal.choices and (signal.scale, signal.offset) == (1, 0):
        kind = "IDENTICAL"
    method = _named(place, "COMPU-METHOD", signal.name)
    _words(method, {"CATEGORY": kind})
    if signal.unit:
        _refer(method, "UNIT-REF", "UNIT", "units", _unit_name(signal.unit))
    if kind == "IDENTICAL":
        return
    scales = _nested(method, "COMPU-INTERNAL-TO-PHYS", "COMPU-SCALES")
    for value, name in signal.choices:
        scale = SubElement(scales, "COMPU-SCALE")
        _words(scale, {"LOWER-LIMIT": f"{value}", "UPPER-LIMIT": f"{value}"})
        _nested(scale, "COMPU-CONST", "VT").text = name
    scale = SubElement(scales, "COMPU-SCALE")
    _words(scale, {"LOWER-LIMIT": "0", "UPPER-LIMIT": f"{(1 << signal.length) - 1}"})
    coefficients = SubElement(scale, "COMPU-RATIONAL-COEFFS")
    numerator = SubElement(coefficients, "COMPU-NUMERATOR")
    for number in (signal.offset, signal.scale):
        SubElement(numerator, "V").text = f"{number!r}"
    _nested(coefficients, "COMPU-DENOMINATOR", "V").text = "1"


def _base_types(place: Element) -> None:
    for size in SIZES:
        _words(_named(place, "SW-BASE-TYPE", f"uint{size}"), {
            "CATEGORY": "FIXED_LENGTH", "BASE-TYPE-SIZE": f"{size}", "BASE-TYPE-ENCODING": "NONE",
        })  # fmt: skip


def _ecus(place: Element, nodes: Iterable[str]) -> None:
    for node in nodes:
        ecu = _named(place, "ECU-INSTANCE", node)
        groups = SubElement(ecu, "ASSOCIATED-COM-I-PDU-GROUP-REFS")
        _refer(groups, "ASSOCIATED-COM-I-PDU-GROUP-REF", "I-SIGNAL-I-PDU-GROUP", "pdu_groups",
               f"sent_by_{node}")  # fmt: skip


def _sent_groups(place: Element, defined: Sequence[Definition], nodes: Iterable[str]) -> None:
    """What each ECU sends."""
    for node in nodes:
        group = _named(place, "I-SIGNAL-I-PDU-GROUP", f"sent_by_{node}")
        _words(group, {"COMMUNICATION-DIRECTION": "OUT"})
        pdus = SubElement(group, "I-SIGNAL-I-PDUS")
        for each in defined:
            if each.sender == node:
                conditional = SubElement(pdus, "I-SIGNAL-I-PDU-REF-CONDITIONAL")
                _refer(conditional, "I-SIGNAL-I-PDU-REF", "I-SIGNAL-I-PDU", "pdus", each.name)


def _unit_name(unit: str) -> str:
    """A unit as a name of AUTOSAR: letters, digits and single underscores."""
    words = unit.replace("/", " per ").replace("%", "percent").replace("^", "").split()
    return "_".join(words)


def _package(place: Element, name: str) -> Element:
    return _named(place, "AR-PACKAGE", name)


def _elements(place: Element, name: str) -> Element:
    return SubElement(_package(place, name), "ELEMENTS")


def _named(place: Element, tag: str, name: str, description: str = "") -> Element:
    element = SubElement(place, tag)
    _words(element, {"SHORT-NAME": name})
    if description:
        text = SubElement(SubElement(element, "DESC"), "L-2", {"L": "EN"})
        text.text = description
    return element


def _words(place: Element, texts: dict[str, str]) -> None:
    for tag, text in texts.items():
        SubElement(place, tag).text = text


def _nested(place: Element, *tags: str) -> Element:
    for tag in tags:
        place = SubElement(place, tag)
    return place


def _props(place: Element, tag: str) -> Element:
    return _nested(place, tag, "SW-DATA-DEF-PROPS-VARIANTS", "SW-DATA-DEF-PROPS-CONDITIONAL")


def _refer(place: Element, tag: str, kind: str, *path: str) -> None:
    SubElement(place, tag, {"DEST": kind}).text = "/".join(("", ROOT, *path))
