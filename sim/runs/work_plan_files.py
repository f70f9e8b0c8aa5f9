"""Plans of fleets for other programs: GeoJSON, KML, and ISO 11783-10 task data (version 4.3).

    plan.geojson   boundary, section, swath, way and start as `kind`; robot, order and times
    plan.kml       a folder for each field, and in it one for each robot
    TASKDATA       PFD  each field: its boundary and, for each robot, a GGP with a GPN a swath, in order
                   TSK  one a robot and field, planned, with the guidance group of its robot
                   DVC  each robot, as in the task data of finished work (`isoxml_writer.py`)

Times count from the start of the fleet, seconds.
"""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from agent.runtime.files.isoxml_reader import NAME
from agent.runtime.files.printable_text import printable
from protocol.name import fleet_name
from sim.files.palette import colour_of
from sim.files.whole_file import whole_file, write_whole
from sim.runs.isoxml_writer import device, guidance_pattern, polygon_of, refuse_others, task_file
from sim.runs.work_geojson import feature
from sim.runs.work_plan import PlannedSection, RobotPlan, WorkPlan
from sim.runs.work_record import NAME_MAX, Rings, area_m2

KML = "http://www.opengis.net/kml/2.2"
DIGITS_S = 3


def write_plan_geojson(plans: Sequence[WorkPlan], path: Path) -> None:
    """Write the plans of all fields as one FeatureCollection (RFC 7946)."""
    features = [each for plan in plans for each in _features(plan)]
    document = {"type": "FeatureCollection", "features": features}
    write_whole(path, json.dumps(document, ensure_ascii=False) + "\n")


def _features(plan: WorkPlan) -> Iterator[dict[str, Any]]:
    yield feature(
        "Polygon", plan.boundary, kind="boundary", name=plan.name, width_mm=plan.width_mm,
        sections=plan.sections, done=plan.done, ends_at_s=round(plan.ends_at_s, DIGITS_S),
        method=plan.method,
    )  # fmt: skip
    for robot in plan.robots:
        said: dict[str, Any] = {"field": plan.name, "robot": robot.robot}
        yield feature("Point", robot.start, kind="start", **said)
        for order, section in enumerate(robot.sections, 1):
            said = {**said, "section": section.section, "order": order}
            times = _times(section.starts_at_s, section.ends_at_s)
            yield feature("MultiPolygon", section.ground, kind="section", **said, **times)
            way = _times(section.leaves_at_s, section.starts_at_s)
            if section.way:
                yield feature("LineString", section.way, kind="way", **said, **way)
            for number, swath in enumerate(section.swaths, 1):
                times = _times(swath.starts_at_s, swath.ends_at_s)
                yield feature(
                    "LineString", swath.points, kind="swath", **said, swath=number, **times
                )


def _times(starts_at_s: float, ends_at_s: float) -> dict[str, float]:
    return {"starts_at_s": round(starts_at_s, DIGITS_S), "ends_at_s": round(ends_at_s, DIGITS_S)}


def write_plan_kml(plans: Sequence[WorkPlan], path: Path) -> None:
    """Write the plans of all fields as one KML 2.2 document."""
    ElementTree.register_namespace("", KML)
    root = ElementTree.Element(f"{{{KML}}}kml")
    document = _child(root, "Document")
    _child(document, "name", "Headland plan")
    for robot in range(max((len(plan.robots) for plan in plans), default=0)):
        red, green, blue = (colour_of(robot)[k : k + 2] for k in (1, 3, 5))
        style = _child(document, "Style", id=f"robot{robot}")
        line = _child(style, "LineStyle")
        _child(line, "color", "ff" + blue + green + red)  # with alpha
        _child(line, "width", "2")
    for plan in plans:
        _field_folder(document, plan)
    tree = ElementTree.ElementTree(root)
    ElementTree.indent(tree)
    with whole_file(path) as part:
        tree.write(part, encoding="utf-8", xml_declaration=True)


def _field_folder(document: ElementTree.Element, plan: WorkPlan) -> None:
    folder = _child(document, "Folder")
    _child(folder, "name", printable(plan.name))
    outline = _child(folder, "Placemark")
    _child(outline, "name", "boundary")
    polygon = _child(outline, "Polygon")
    for number, ring in enumerate(plan.boundary):
        edge = _child(polygon, "innerBoundaryIs" if number else "outerBoundaryIs")
        _child(_child(edge, "LinearRing"), "coordinates", _coordinates(ring))
    for robot in plan.robots:
        rows = _child(folder, "Folder")
        _child(rows, "name", f"robot {robot.robot}")
        for order, section in enumerate(robot.sections, 1):
            _section_lines(rows, robot, order, section)


def _section_lines(
    folder: ElementTree.Element, robot: RobotPlan, order: int, section: PlannedSection
) -> None:
    lines = []
    if section.way:
        lines.append(("way", section.way, section.leaves_at_s, section.starts_at_s))
    for number, swath in enumerate(section.swaths, 1):
        lines.append((f"swath {number}", swath.points, swath.starts_at_s, swath.ends_at_s))
    for name, points, starts_at_s, ends_at_s in lines:
        mark = _child(folder, "Placemark")
        _child(mark, "name", f"S{section.section} {name}")
        _child(mark, "styleUrl", f"#robot{robot.robot}")
        data = _child(mark, "ExtendedData")
        for key, value in (
            ("section", section.section),
            ("order", order),
            *_times(starts_at_s, ends_at_s).items(),
        ):
            _child(_child(data, "Data", name=key), "value", str(value))
        line = _child(mark, "LineString")
        _child(line, "tessellate", "1")  # lines follow the ground
        _child(line, "coordinates", _coordinates(points))


def _child(
    parent: ElementTree.Element, tag: str, text: str | None = None, **attributes: str
) -> ElementTree.Element:
    child = ElementTree.SubElement(parent, f"{{{KML}}}{tag}", attributes)
    child.text = text
    return child


def _coordinates(points: Sequence[tuple[float, float]]) -> str:
    return " ".join(f"{lon:.9f},{lat:.9f}" for lon, lat in points)


def write_plan_isoxml(plans: Sequence[WorkPlan], folder: Path) -> None:
    """Write the plans of all fields as one task file into a folder, made if needed.

    FieldFileError without the package `isoxml`, and where task data of others is.
    """
    refuse_others(folder)
    content = task_file(folder, lambda: _contents(plans))
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / NAME, content)


def _contents(plans: Sequence[WorkPlan]) -> dict[str, Any]:
    import isoxml.models.base.v4 as iso

    fleet, width_mm = plans[0].name, plans[0].width_mm
    robots = max(len(plan.robots) for plan in plans)
    partfields: list[Any] = []
    tasks: list[Any] = []
    patterns = 0
    for number, plan in enumerate(plans, 1):
        groups = []
        for robot in plan.robots:
            lines = []
            for order, section in enumerate(robot.sections, 1):
                for swath in section.swaths:
                    patterns += 1
                    name = f"{order} S{section.section}"
                    lines.append(guidance_pattern(iso, patterns, name, swath.points))
            if not lines:
                continue
            group = f"GGP-{len(tasks) + 1}"
            groups.append(
                iso.GuidanceGroup(
                    id=group, designator=f"robot {robot.robot}", guidance_patterns=lines
                )
            )
            tasks.append(_task(iso, plan, f"PFD-{number}", fleet, robot.robot, group, len(tasks)))
        partfields.append(_partfield(iso, plan, number, groups))
    devices = [device(iso, fleet, width_mm, robot) for robot in range(robots)]
    return {"devices": devices, "partfields": partfields, "tasks": tasks}


def _partfield(iso: Any, plan: WorkPlan, number: int, groups: list[Any]) -> Any:
    boundary: Rings = plan.boundary
    return iso.Partfield(
        id=f"PFD-{number}",
        designator=printable(plan.name)[:NAME_MAX],
        area=area_m2(boundary),
        polygons=[polygon_of(iso, boundary, iso.PolygonType.PartfieldBoundary)],
        guidance_groups=groups,
    )


def _task(
    iso: Any, plan: WorkPlan, partfield: str, fleet: str, robot: int, group: str, number: int
) -> Any:
    return iso.Task(
        id=f"TSK-{number + 1}",
        designator=f"{printable(plan.name)[: NAME_MAX - 10]} robot {robot}",
        partfield_id_ref=partfield,
        status=iso.TaskStatus.Planned,
        guidance_allocations=[iso.GuidanceAllocation(guidance_group_id_ref=group)],
        device_allocations=[
            iso.DeviceAllocation(
                client_name_value=fleet_name(fleet, robot).pack().to_bytes(8, "big"),
                device_id_ref=f"DVC-{robot + 1}",
            )
        ],
    )
