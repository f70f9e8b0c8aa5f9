"""Reads ISO 11783-10 task data: a TASKDATA.XML, its folder, or a zip of it.

The package `isoxml` (an extra) turns the text into objects. By itself it accepts bad numbers,
unknown kinds of geometry and document types, and passes on any exception of its parser. Here every
invalid file is one `FieldFileError`. Nothing is ever unpacked to disk, and no entity is ever
expanded.
"""

import logging
import re
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import shapely
from shapely.errors import GEOSException
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry
from shapely.validation import explain_validity

from agent.runtime.files.field_error import FILE_BYTES_MAX, POINTS_MAX, FieldFileError, LonLat
from agent.runtime.files.given_file import GivenFileError, check_regular, read_bytes

# Errors are reported in one line instead.
logging.getLogger("xsdata").addHandler(logging.NullHandler())
NAME = "TASKDATA.XML"
EXTERNAL = re.compile(r"[A-Z]{3}[0-9]{5}")  # the standard's own pattern for names of further files
EXTERNAL_MAX = 100_000  # five digits
ELEMENTS_MAX = 200_000  # of one XML file: a farm of 200 fields of 1,000 points; 3 s of parsing
BOUNDARY, EXTERIOR, INTERIOR = "1", "1", "2"  # values of PLN A and LSG A
OBSTACLES = {"3", "4", "6"}  # PLN A: water, building, obstacle: no robot drives there
DECLARED = re.compile(r"""^\s*<\?xml[^>]*encoding\s*=\s*["']([^"']*)["']""")

Read = Callable[[str], bytes | None]


def read_isoxml(
    path: Path, broken: dict[str, FieldFileError] | None = None
) -> dict[str, list[list[LonLat]]]:
    """Partfield -> rings of (longitude, latitude) in degrees, the exterior first; several parts are
    numbered.

    Raises FieldFileError if the data cannot be read. An error of one field is raised as well, or
    put into `broken` by its name, so that one invalid outline does not affect the others.
    """
    outlines: dict[str, list[list[LonLat]]] = {}
    known: set[str] = set()  # what the next one may not be called
    for number, partfield in enumerate(load_task_data(path).partfields):
        name = str(partfield.designator or partfield.id or f"field {number}")
        if name in known:
            name = f"{name} ({partfield.id})"
        try:
            parts = list(_parts(path, name, partfield.polygons))
        except FieldFileError as problem:
            if broken is None:
                raise
            broken[name] = problem
            known.add(name)
            continue
        for k, part in enumerate(parts):
            label = name if len(parts) == 1 else f"{name} part {k}"
            known |= {label, label.rpartition(" part ")[0]}
            outlines[label] = [_open(ring.coords) for ring in (part.exterior, *part.interiors)]
    return outlines


def load_task_data(path: Path) -> Any:
    """The task data as objects of `isoxml`, with the elements of its external files.

    Raises FieldFileError if the data cannot be read, or if the package isoxml is not installed.
    """
    try:
        import isoxml.models.base.v3 as v3
        import isoxml.models.base.v4 as v4
    except ImportError:
        raise FieldFileError(
            f"{path}: task data needs the package isoxml: pip install 'headland[isoxml]'"
        ) from None
    archive, read = _reader(path)
    try:
        text = _text(path, NAME, read(NAME))
        version = re.search(
            r"""<ISO11783_TaskData\b[^>]*\bVersionMajor\s*=\s*["'](\d+)["']""", text
        )
        if version is None or version[1] not in ("3", "4"):
            said = f"version {version[1]}" if version else "no version"
            raise FieldFileError(f"{path}: ISO 11783 task data of {said}; 3 and 4 can be read")
        module: Any = v4 if version[1] == "4" else v3
        data = _parse(path, NAME, text, module.Iso11783TaskData)
        if len(data.external_file_references) > EXTERNAL_MAX:
            raise FieldFileError(f"{path}: more than {EXTERNAL_MAX} external files")
        # A file that is named twice is read once.
        for name in dict.fromkeys(str(each.filename) for each in data.external_file_references):
            if not EXTERNAL.fullmatch(name):
                raise FieldFileError(f"{path}: {name!r} is no name of an external file")
            further = _text(path, f"{name}.XML", read(f"{name}.XML"))
            contents = _parse(path, f"{name}.XML", further, module.ExternalFileContents)
            data.partfields.extend(contents.partfields)
            data.tasks.extend(contents.tasks)
            data.devices.extend(contents.devices)
        return data
    finally:
        if archive is not None:
            archive.close()


def _reader(path: Path) -> tuple[zipfile.ZipFile | None, Read]:
    """A function that reads a file by its name, ignoring case: from a folder or from a zip."""
    if path.suffix.lower() == ".zip":
        try:
            check_regular(path)
            archive = zipfile.ZipFile(path)
        except GivenFileError as problem:
            raise FieldFileError(f"{path}: {problem}") from None
        except OSError as problem:
            raise FieldFileError(f"{path}: cannot be read: {problem.strerror}") from None
        except (zipfile.BadZipFile, ValueError, NotImplementedError):
            raise FieldFileError(f"{path}: not a zip file") from None
        members: dict[str, zipfile.ZipInfo] = {}
        for member in archive.infolist():
            members.setdefault(Path(member.filename).name.upper(), member)
        return archive, lambda name: _from_zip(path, archive, members.get(name.upper()))
    folder = path if path.is_dir() else path.parent
    main = path.name.upper() if not path.is_dir() else NAME

    def read(name: str) -> bytes | None:
        wanted = main if name == NAME else name.upper()
        try:
            found = next((file for file in folder.iterdir() if file.name.upper() == wanted), None)
            if found is None:
                return None
            return read_bytes(found, FILE_BYTES_MAX)
        except OSError as problem:
            raise FieldFileError(f"{path}: cannot be read: {problem.strerror}") from None
        except GivenFileError as problem:
            raise FieldFileError(f"{path}: {found}: {problem}") from None

    return None, read


def _from_zip(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo | None) -> bytes | None:
    if member is None:
        return None
    try:
        with archive.open(member) as file:  # the size in the directory is not trusted
            return _within(path, file.read(FILE_BYTES_MAX + 1))
    except Exception as problem:  # zlib, lzma, bz2, a password: each has its own exceptions
        if isinstance(problem, FieldFileError):
            raise
        raise FieldFileError(f"{path}: {member.filename} cannot be unpacked: {problem}") from None


def _within(path: Path, content: bytes) -> bytes:
    if len(content) > FILE_BYTES_MAX:
        raise FieldFileError(f"{path}: larger than {FILE_BYTES_MAX >> 20} MiB")
    return content


def _text(path: Path, name: str, content: bytes | None) -> str:
    if content is None:
        raise FieldFileError(f"{path}: no {name} there")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise FieldFileError(f"{path}: {name} is not UTF-8 text") from None
    declared = DECLARED.match(text)
    if declared and declared[1].lower().replace("_", "-") not in ("utf-8", "utf8", "us-ascii"):
        raise FieldFileError(f"{path}: {name} is in {declared[1]}; task data is in UTF-8")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise FieldFileError(f"{path}: {name} declares a document type; task data never does")
    return text


def _parse(path: Path, name: str, text: str, kind: type) -> Any:
    if text.count("<") > 2 * ELEMENTS_MAX:
        raise FieldFileError(f"{path}: {name} has more than {ELEMENTS_MAX} elements; divide it")
    from xsdata.formats.dataclass.parsers import XmlParser
    from xsdata.formats.dataclass.parsers.config import ParserConfig

    lenient = ParserConfig(fail_on_unknown_properties=False, fail_on_unknown_attributes=False)
    try:
        with warnings.catch_warnings():
            # Values that it could not convert are checked where they are used.
            warnings.simplefilter("ignore")
            return XmlParser(lenient).from_string(text, kind)
    except Exception as problem:  # an external parser on any file: it may raise anything
        reason = " ".join(str(problem).split())[:120]
        raise FieldFileError(f"{path}: {name} is not task data: {reason}") from None


def _parts(path: Path, name: str, polygons: list[Any]) -> Iterator[Polygon]:
    """The parts of one field, less its obstacles."""
    boundaries = [p for p in polygons if code(p.type) == BOUNDARY]
    standing = [
        part
        for polygon in polygons
        if code(polygon.type) in OBSTACLES
        for part in _exteriors(path, name, polygon)
    ]
    # Some terminals write each hole as a separate boundary with only an interior ring.
    alone = [p for p in boundaries if p.line_strings and _only_holes(p)]
    outlined = [p for p in boundaries if not any(p is q for q in alone)]
    holes = [
        hole
        for polygon in alone
        for line in polygon.line_strings
        if (hole := _hole(path, name, _ring(path, name, line.points))) is not None
    ]
    if alone and not outlined:
        raise FieldFileError(f"{path}: {name}: a boundary without an outline")
    try:
        for part in _nested([p for b in outlined for p in _exteriors(path, name, b)]):
            rest = part
            for obstacle in (*standing, *holes):
                rest = rest.difference(obstacle)
            parts = getattr(rest, "geoms", [rest])
            yield from (p for p in parts if isinstance(p, Polygon) and not p.is_empty)
    except GEOSException as problem:
        raise FieldFileError(f"{path}: {name}: {problem}; repair the outline") from None


def _hole(path: Path, name: str, ring: list[LonLat]) -> Polygon | None:
    """What a ring takes out of a field; None if it has no area."""
    hole = Polygon(ring)
    if hole.is_valid:
        return hole
    if shapely.make_valid(hole).area > 0.0:
        raise FieldFileError(f"{path}: {name}: {explain_validity(hole)}; repair the outline")
    return None


def _nested(parts: list[Polygon]) -> list[BaseGeometry]:
    """The parts of a field. An outline inside another one is a hole, as some terminals write it, and
    one inside that hole is a part again. An outline that is there twice counts once.
    """
    order = sorted(range(len(parts)), key=lambda k: -parts[k].area)
    found: dict[int, BaseGeometry] = {}
    for k in order:
        part = parts[k]
        around = next((n for n, larger in found.items() if larger.covers(part)), None)
        if around is None:
            found[k] = part
        elif not parts[around].equals(part):
            found[around] = found[around].difference(part)
    return [found[k] for k in sorted(found)]


def _only_holes(polygon: Any) -> bool:
    return all(code(line.type) == INTERIOR for line in polygon.line_strings)


def _exteriors(path: Path, name: str, polygon: Any) -> Iterator[Polygon]:
    """The polygons of a PLN. Version 3 allows several outlines in one. Holes belong to the outline
    around them.
    """
    shells: list[list[LonLat]] = []
    holes: list[list[LonLat]] = []
    for line in polygon.line_strings:
        kind = code(line.type)
        if kind == INTERIOR:
            holes.append(_ring(path, name, line.points))
        elif kind == EXTERIOR or len(polygon.line_strings) == 1:
            # Some terminals write another kind.
            shells.append(_ring(path, name, line.points))
    if not shells:
        raise FieldFileError(f"{path}: {name}: a boundary without an outline")
    for shell in shells:
        outline = Polygon(shell)
        inside = holes
        if len(shells) > 1:
            inside = [h for h in holes if outline.is_valid and _cuts(Polygon(h), outline)]
        whole = Polygon(shell, inside)
        if not whole.is_valid:
            raise FieldFileError(f"{path}: {name}: {explain_validity(whole)}; repair the outline")
        yield whole


def _cuts(hole: Polygon, outline: Polygon) -> bool:
    """Whether a hole is one of this outline. One that crosses it is, too, and makes it invalid."""
    return not hole.is_valid or outline.covers(hole) or outline.overlaps(hole)


def _ring(path: Path, name: str, points: list[Any]) -> list[LonLat]:
    if len(points) > POINTS_MAX:
        raise FieldFileError(
            f"{path}: {name}: a ring of {len(points)} points; thin it out to {POINTS_MAX} at most"
        )
    ring = [position(path, name, point) for point in points]
    if ring and ring[0] != ring[-1]:
        ring.append(ring[0])
    if len(ring) < 4:
        raise FieldFileError(f"{path}: {name}: a ring of {len(points)} points; it needs 3")
    return ring


def position(path: Path, name: str, point: Any) -> LonLat:
    """Longitude and latitude of a PNT in degrees. `isoxml` leaves values that are not numbers
    unconverted.

    Raises FieldFileError if they are no numbers or out of range. `path` and `name` are for its
    message.
    """
    try:
        lon, lat = float(point.east), float(point.north)
    except (TypeError, ValueError):
        raise FieldFileError(
            f"{path}: {name}: a point at C={point.north!s:.20} D={point.east!s:.20}, not two numbers"
        ) from None
    if not (-180 <= lon <= 180 and -90 <= lat <= 90):  # also true for NaN
        raise FieldFileError(
            f"{path}: {name}: a point at {lat:g}, {lon:g}; latitude and longitude are in degrees"
        )
    return lon, lat


def code(value: Any) -> str:
    """The value of an attribute: that of an enumeration, or a text that matched none."""
    said = getattr(value, "value", value)
    return str(said[0] if isinstance(said, tuple) else said)


def _open(coordinates: Any) -> list[LonLat]:
    return [(float(p[0]), float(p[1])) for p in coordinates]
