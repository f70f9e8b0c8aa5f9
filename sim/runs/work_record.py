"""Finished work for other programs: the field, the covered area, and the track of each robot.

Positions are longitude and latitude in degrees (WGS 84), rounded to what ISO 11783-10 can carry:
1e-9 degrees (0.1 mm) in outlines, 1e-7 (1 cm) and milliseconds in time logs. `work_geojson.py` and
`work_isoxml.py` write it and read it back equal.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime, timedelta
from typing import NamedTuple

import numpy as np
import shapely
from pyproj import Geod, Transformer
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from agent.field.field_map import Field
from agent.runtime.files.field_error import LonLat
from agent.runtime.files.field_file import plane
from agent.runtime.files.printable_text import printable
from sim.world.coverage_truth import BACK_COS, Floats, strokes_of
from sim.world.ground_truth import TrackPoint

OUTLINE_DIGITS, LOG_DIGITS = 9, 7
# A time log has a record a second, as task controllers write it, and one at each switch of the
# implement.
LOG_US = 1_000_000
DETAIL_M = 0.02  # tolerance of the outline of the covered area
STROKE_M = 0.005  # of a track: a place moved by more takes ground from the stripe at its end
SWING_RAD = 0.01  # the end of a bar of 4 m passes 2 cm in it, the detail of the outline
SWING_STEPS = 16  # of an arc; the chord of the longest step leaves 0.4 % of the half bar
NAME_MAX = 32  # characters, the limit of ISO 11783-10
GRID_M = 0.001  # its points are on millimetres, so that rounding cannot make it cross itself

Rings = tuple[tuple[LonLat, ...], ...]  # the exterior first; each ends at its start


class Swath(NamedTuple):
    """One swath of a section as a line of longitude and latitude."""

    section: int
    points: tuple[LonLat, ...]


class LogPoint(NamedTuple):
    """Where a robot was, and whether it worked from there on."""

    t_ms: int  # since the start of the record
    lon: float
    lat: float
    working: bool  # the implement is down from here on


class WorkRecord(NamedTuple):
    """Everything that farm software gets of a run: longitudes and latitudes in degrees."""

    name: str
    started: datetime  # UTC
    finished: bool  # every section was done
    width_mm: int  # of the implement
    boundary: Rings
    swaths: tuple[Swath, ...]
    covered: tuple[Rings, ...]
    logs: Mapping[int, tuple[LogPoint, ...]]  # robot -> its track, in order of time

    @property
    def duration_ms(self) -> int:
        """Until the last point of any robot; 0 without points."""
        return max((log[-1].t_ms for log in self.logs.values() if log), default=0)

    @property
    def stopped(self) -> datetime:
        """When the last point of any robot was, UTC. OverflowError after the year 9999."""
        return self.started + timedelta(milliseconds=self.duration_ms)


class ToDegrees:
    """Metres east and north of an origin, as longitudes and latitudes in degrees (WGS 84)."""

    def __init__(self, origin: tuple[float, float]) -> None:
        """`origin`: latitude and longitude in degrees."""
        back = Transformer.from_crs(plane(origin), "EPSG:4326", always_xy=True)
        self._back = back.transform

    def points(
        self, points: Iterable[Sequence[float]], digits: int = OUTLINE_DIGITS
    ) -> tuple[LonLat, ...]:
        """Points, rounded to so many decimal places."""
        rows = list(points)
        if not rows:
            return ()
        lon, lat = self._back([p[0] for p in rows], [p[1] for p in rows])
        return tuple((round(x, digits), round(y, digits)) for x, y in zip(lon, lat, strict=True))

    def rings(self, shape: Polygon) -> Rings:
        """The outlines of a polygon."""
        shape = orient(shape)  # RFC 7946 wants exteriors to turn left
        return tuple(self.points(ring.coords) for ring in (shape.exterior, *shape.interiors))


def record_of(
    field: Field, tracks: Mapping[int, Sequence[TrackPoint]], finished: bool, started: datetime
) -> WorkRecord:
    """Make a record from a field in metres and the tracks of its robots."""
    to_degrees = ToDegrees(field.origin)
    logs = {}
    for slot, track in sorted(tracks.items()):
        kept = list(_thinned(track))
        if not kept:
            continue
        places = to_degrees.points([(x, y) for _, x, y, _ in kept], LOG_DIGITS)
        logs[slot] = tuple(
            LogPoint(t_us // 1000, lon, lat, bool(tool))
            for (t_us, _, _, tool), (lon, lat) in zip(kept, places, strict=True)
        )
    return WorkRecord(
        name=printable(field.name)[:NAME_MAX],  # XML carries no control characters
        started=started.replace(microsecond=0),
        finished=finished,
        width_mm=round(field.implement_width_m * 1000),
        boundary=to_degrees.rings(field.polygon),
        swaths=tuple(
            Swath(section.id, to_degrees.points(line))
            for section in field.sections
            for line in section.swaths
        ),
        covered=tuple(to_degrees.rings(part) for part in covered_area(field, tracks)),
        logs=logs,
    )


def covered_area(field: Field, tracks: Mapping[int, Sequence[TrackPoint]]) -> list[Polygon]:
    """The area that the implement swept inside the fences, metres: the strokes that the judge counts
    (`sim/world/coverage_truth.py`), and the swing of the bar where one turns into the next."""
    half_m = field.implement_width_m / 2
    swept: list[BaseGeometry] = []
    for _, track in sorted(tracks.items()):
        strokes = strokes_of(track)
        swept += [
            LineString(line).simplify(STROKE_M).buffer(half_m, cap_style="flat", join_style="round")
            for line in _lines(strokes)
        ]
        swept += _swings(strokes, half_m)
    ground = shapely.unary_union(swept).intersection(field.polygon)
    ground = shapely.set_precision(ground.simplify(DETAIL_M), GRID_M)
    parts = ground.geoms if hasattr(ground, "geoms") else [ground]
    return [p for p in parts if isinstance(p, Polygon) and p.area > 0.0]


def _lines(strokes: Floats) -> Iterator[Floats]:
    """Strokes that follow each other as one line, (n, 2) metres each."""
    if not len(strokes):
        return
    begins = np.flatnonzero((strokes[:, 6:] == 0.0).all(axis=1))
    for run in np.split(strokes, begins[1:]):
        yield np.vstack([run[:1, :2], run[:, 2:4]])


def _swings(strokes: Floats, half_m: float) -> list[BaseGeometry]:
    """What both halves of the bar pass over where the course turns, by the shorter way."""
    was = strokes[:, 6:]
    course = strokes[:, 2:4] - strokes[:, :2]
    cos = (was * course).sum(axis=1)
    sin = was[:, 0] * course[:, 1] - was[:, 1] * course[:, 0]
    turned = was.any(axis=1) & (cos > BACK_COS * np.hypot(*course.T))
    turn_rad = np.arctan2(sin, cos)
    turned &= np.abs(turn_rad) > SWING_RAD
    ends_rad = np.arctan2(was[turned, 1], was[turned, 0])[:, None] - np.pi / 2
    arc_rad = ends_rad + turn_rad[turned, None] * np.linspace(0.0, 1.0, SWING_STEPS + 1)
    arcs = half_m * np.stack([np.cos(arc_rad), np.sin(arc_rad)], axis=-1)
    centres = strokes[turned, None, :2]
    return [
        sector
        for side in (arcs, -arcs)
        for sector in shapely.polygons(np.concatenate([centres, centres + side], axis=1))
    ]


def _thinned(track: Sequence[TrackPoint]) -> Iterator[TrackPoint]:
    last_at_us, tool = -LOG_US, None
    for k, point in enumerate(track):
        if point[0] - last_at_us >= LOG_US or point[3] != tool or k == len(track) - 1:
            last_at_us, tool = point[0], point[3]
            yield point


def area_m2(rings: Rings) -> int:
    """The area of a polygon in degrees, on the ellipsoid, in whole square metres."""
    polygon = orient(Polygon(rings[0], rings[1:]))
    return round(Geod(ellps="WGS84").geometry_area_perimeter(polygon)[0])
