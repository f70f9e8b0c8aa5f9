"""A work record as ISO 11783-10 task data (version 4.3).

    PFD  the field: its boundary with holes (PLN 1), and
         GGP > GPN, one guidance line a swath: AB where it is straight, else a curve; its name is
         that of its section
    TSK  the work: completed or paused, TIM with its times, TZN with what was covered (PLN 2),
         TLG with each robot's way and whether the implement was down
    DVC  each robot, with the width of its implement (DDI 67) and its work state (DDI 141)

Written as a folder, or as a zip if the name ends in .zip.
"""

import zipfile
import zlib
from collections.abc import Callable
from decimal import Decimal
from importlib.metadata import version
from pathlib import Path
from typing import Any

from agent.runtime.files.field_error import FieldFileError, LonLat
from agent.runtime.files.isoxml_reader import NAME
from protocol.device_description import WIDTH, WORK_STATE
from protocol.name import fleet_name
from sim.files.whole_file import whole_file, write_whole
from sim.runs.isoxml_time_log import END, EPOCH, header, pack
from sim.runs.work_record import OUTLINE_DIGITS, Rings, WorkRecord, area_m2

DEVICE, WIDTH_OBJECT, STATE_OBJECT = 0, 1, 2  # object numbers within a device
ON_CHANGE = 8  # DPD D: the value is logged when it changes
OURS = (b'ManagementSoftwareManufacturer="Headland"', b'TaskControllerManufacturer="Headland"')
HEAD_BYTES = 1024  # of a file of ours: both stand in its first 200
ZONE = 1  # code of the treatment zone that was worked


def write_isoxml(record: WorkRecord, out: Path) -> None:
    """Write task data into a folder (created if needed) or a zip. FieldFileError without
    `isoxml`, where task data of others is, and for work of a time that time logs do not know."""
    refuse_others(out)
    if record.started < EPOCH or record.stopped >= END:
        raise FieldFileError(
            f"{out}: by the clock of its computer the work began on {record.started:%Y-%m-%d}; task "
            f"data has times from {EPOCH.year} to {END.year}. Set the clock, and 'started' in "
            "work.geojson"
        )
    files = {NAME: task_file(out, lambda: _contents(record))}
    for number, (robot, log) in enumerate(sorted(record.logs.items()), 1):
        files[f"TLG{number:05d}.xml"] = header(f"DET-{robot + 1}").encode()
        files[f"TLG{number:05d}.bin"] = pack(log, record.started)
    if out.suffix.lower() == ".zip":
        with whole_file(out) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in files.items():
                # At the top level, the only place where `isoxml` looks.
                archive.writestr(name, content)
        return
    out.mkdir(parents=True, exist_ok=True)
    for name, content in reversed(files.items()):  # what names the others comes last
        write_whole(out / name, content)


def refuse_others(out: Path) -> None:
    """Raises FieldFileError where task data is that not Headland alone has written: what farm software
    made, or a terminal went on with, may be the only copy. OSError where it cannot be read."""
    heads = [_head_in_zip(out)] if out.is_file() else []
    if out.is_dir():
        for path in out.iterdir():
            if path.name.upper() == NAME:
                with path.open("rb") as file:
                    heads.append(file.read(HEAD_BYTES))
    if not all(mark in head for head in heads for mark in OURS):
        raise FieldFileError(
            f"{out}: there is task data that not Headland has written; choose another name"
        )


def _head_in_zip(path: Path) -> bytes:
    """The first bytes of its task file; none where it is no such zip."""
    try:
        with zipfile.ZipFile(path) as archive, archive.open(NAME) as file:
            return file.read(HEAD_BYTES)
    except (KeyError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error):
        return b""


def task_file(out: Path, contents: Callable[[], dict[str, Any]]) -> bytes:
    """A TASKDATA.XML with these devices, partfields and tasks. FieldFileError without `isoxml`.

    `out`: the name for the message.
    """
    try:
        import isoxml.models.base.v4 as iso
        from isoxml.util.isoxml_io import isoxml_to_text
    except ImportError:
        raise FieldFileError(
            f"{out}: task data needs the package isoxml: pip install 'headland[isoxml]'"
        ) from None
    headland = version("headland")
    document = iso.Iso11783TaskData(
        management_software_manufacturer="Headland",
        management_software_version=headland,
        task_controller_manufacturer="Headland",
        task_controller_version=headland,
        data_transfer_origin=iso.Iso11783TaskDataDataTransferOrigin.MICS,
        **contents(),
    )
    return bytes(isoxml_to_text(document).encode())


def _contents(record: WorkRecord) -> dict[str, Any]:
    import isoxml.models.base.v4 as iso

    robots = sorted(record.logs)
    return {
        "devices": [device(iso, record.name, record.width_mm, robot) for robot in robots],
        "partfields": [_partfield(iso, record)],
        "tasks": [_task(iso, record)],
    }


def _partfield(iso: Any, record: WorkRecord) -> Any:
    patterns = [
        guidance_pattern(iso, number, f"S{swath.section}", swath.points)
        for number, swath in enumerate(record.swaths, 1)
    ]
    return iso.Partfield(
        id="PFD-1",
        designator=record.name,
        area=area_m2(record.boundary),
        polygons=[polygon_of(iso, record.boundary, iso.PolygonType.PartfieldBoundary)],
        guidance_groups=[
            iso.GuidanceGroup(id="GGP-1", designator="swaths", guidance_patterns=patterns)
        ],
    )


def guidance_pattern(iso: Any, number: int, name: str, points: tuple[LonLat, ...]) -> Any:
    """The GPN of one swath: AB where it is straight, else a curve."""
    kinds = iso.GuidancePatternType
    return iso.GuidancePattern(
        id=f"GPN-{number}",
        designator=name,
        type=kinds.AB if len(points) == 2 else kinds.Curve,
        propagation_direction=iso.GuidancePatternPropagationDirection.NoPropagation,
        extension=iso.GuidancePatternExtension.NoExtensions,
        line_strings=[_guidance_line(iso, points)],
    )


def _guidance_line(iso: Any, points: tuple[LonLat, ...]) -> Any:
    kinds = iso.PointType
    last = len(points) - 1
    ends = {0: kinds.GuidanceReferenceA, last: kinds.GuidanceReferenceB}
    return iso.LineString(
        type=iso.LineStringType.GuidancePattern,
        points=[_point(iso, p, ends.get(k, kinds.GuidancePoint)) for k, p in enumerate(points)],
    )


def polygon_of(iso: Any, rings: Rings, kind: Any) -> Any:
    """The PLN of an outline with its holes."""
    kinds = iso.LineStringType
    lines = [
        iso.LineString(
            type=kinds.PolygonInterior if k else kinds.PolygonExterior,
            points=[_point(iso, p, iso.PointType.Other) for p in ring],
        )
        for k, ring in enumerate(rings)
    ]
    return iso.Polygon(type=kind, line_strings=lines)


def _point(iso: Any, at: LonLat, kind: Any) -> Any:
    east, north = (Decimal(f"{v:.{OUTLINE_DIGITS}f}") for v in at)
    return iso.Point(type=kind, north=north, east=east)


def device(iso: Any, name: str, width_mm: int, robot: int) -> Any:
    """The element of a robot of the field or fleet `name`."""
    element = iso.DeviceElement(
        id=f"DET-{robot + 1}", object_id=DEVICE + 10, type=iso.DeviceElementType.Device,
        designator=f"robot {robot}", number=0, parent_object_id=DEVICE,
        device_object_references=[
            iso.DeviceObjectReference(device_object_id=WIDTH_OBJECT),
            iso.DeviceObjectReference(device_object_id=STATE_OBJECT),
        ],
    )  # fmt: skip
    return iso.Device(
        id=f"DVC-{robot + 1}",
        designator=f"robot {robot}",
        client_name=fleet_name(name, robot).pack().to_bytes(8, "big"),
        structure_label="48454144000001",  # any seven bytes that change with the elements below
        localization_label=b"\xff\x00\x00\x00\x00\x6e\x65",  # byte 7 first: no units, "en"
        elements=[element],
        properties=[iso.DeviceProperty(object_id=WIDTH_OBJECT, ddi=_ddi(WIDTH), value=width_mm)],
        process_data=[
            iso.DeviceProcessData(
                object_id=STATE_OBJECT, ddi=_ddi(WORK_STATE), property=0, trigger_methods=ON_CHANGE
            )
        ],
    )


def _ddi(number: int) -> bytes:
    return number.to_bytes(2, "big")


def _task(iso: Any, record: WorkRecord) -> Any:
    from xsdata.models.datatype import XmlDateTime

    zone = iso.TreatmentZone(
        code=ZONE,
        designator="covered",
        polygons=[
            polygon_of(iso, rings, iso.PolygonType.TreatmentZone) for rings in record.covered
        ],
    )
    statuses = iso.TaskStatus
    return iso.Task(
        id="TSK-1",
        designator=record.name,
        partfield_id_ref="PFD-1",
        status=statuses.Completed if record.finished else statuses.Paused,
        treatment_zones=[zone] if record.covered else [],
        guidance_allocations=[iso.GuidanceAllocation(guidance_group_id_ref="GGP-1")],
        times=[
            iso.Time(
                start=XmlDateTime.from_datetime(record.started),
                stop=XmlDateTime.from_datetime(record.stopped),
                type=iso.TimeType.Effective,
            )
        ],
        device_allocations=[
            iso.DeviceAllocation(
                client_name_value=fleet_name(record.name, robot).pack().to_bytes(8, "big"),
                device_id_ref=f"DVC-{robot + 1}",
            )
            for robot in sorted(record.logs)
        ],
        time_logs=[
            iso.TimeLog(filename=f"TLG{k:05d}", type=iso.TimeLogType.BinaryTimelogFileType1)
            for k in range(1, len(record.logs) + 1)
        ],
    )
