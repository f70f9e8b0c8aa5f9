"""Task data of several makers, worked and written again, as packages of others read it.

The models of the package `isoxml` carry what the V4.3 schemas demand of each attribute and element:
whether it must be there, its pattern, its lengths and its limits. They are checked one by one. The
package `isoxml` for node (isoxml-js) reads the whole and says its warnings.
"""

import dataclasses
import json
import re
import shutil
import subprocess
import warnings
import zipfile
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

from tools.bench.map_kinds import data_folder
from tools.common.child_process import module_command

LIMIT_S = 60.0  # simulated; a run that is cut short writes what it has done
QUICK_LIMIT_S = 10.0
READER = "isoxml@1.11.2"  # MIT, dev4Agriculture
READ = """
const { ISOXMLManager } = require('isoxml'), fs = require('fs')
const read = async file => {
  const manager = new ISOXMLManager()
  await manager.parseISOXMLFile(new Uint8Array(fs.readFileSync(file)), 'application/zip')
  const logs = (manager.rootElement.attributes.Task || []).flatMap(task =>
    (task.attributes.TimeLog || []).map(log => log.parseBinaryFile()))
  return { warnings: [...manager.getWarnings(), ...logs.flatMap(log => log.warnings || [])],
           fields: (manager.rootElement.attributes.Partfield || []).length,
           records: logs.reduce((sum, log) => sum + log.timeLogs.length, 0) }
}
Promise.all(process.argv.slice(2).map(read)).then(all => console.log(JSON.stringify(all)))
"""
Ring = list[tuple[float, float]]  # latitude and longitude, degrees, closed


class ReaderAbsent(Exception):
    """isoxml-js cannot be had here."""


class TaskDataKind(NamedTuple):
    """Task data that a farm may have."""

    name: str
    path: Path
    feature: str | None = None  # which field of it


class Exported(NamedTuple):
    """What other programs say of our task data of one kind."""

    kind: str
    schema_errors: tuple[str, ...]
    zipped: Path


def kinds(folder: Path) -> Iterator[TaskDataKind]:
    """Those of other makers where they are to be had, and what the package `isoxml` writes into
    `folder`."""
    yield TaskDataKind("version 3, one outline", _written(folder / "v3", 3, [[OUTLINE]]))
    yield TaskDataKind(
        "a hole in a part of its own", _written(folder / "hole", 4, [[OUTLINE], [HOLE]])
    )
    yield TaskDataKind(
        "several parts", _written(folder / "parts", 4, [[OUTLINE], [BESIDE]]), "meadow part 1"
    )
    for maker, place, feature in (
        ("CNH", "isoxml-py/v4_cnh_export", None),
        ("Deutz-Fahr, external files", "isoxml-py/v4_deutz_export", None),
        ("Josephinum, grid and logs", "isoxml-py/v4_full_task", None),
        ("dev4Agriculture, simple", "isoxml-dotnet/Partfields", "NO_Warschau_Simple"),
        ("dev4Agriculture, hole", "isoxml-dotnet/Partfields", "NM_Oxted_NullMeridian_Hole"),
    ):
        path = data_folder() / "fields" / place
        if path.is_dir():
            yield TaskDataKind(maker, path, feature)


# Degrees: about 100 m by 60 m, a pond in it, and a second part beside it.
OUTLINE: Ring = [(48.0, 11.0), (48.0, 11.0014), (48.0006, 11.0014), (48.0006, 11.0), (48.0, 11.0)]
HOLE: Ring = [(48.0002, 11.0006), (48.0002, 11.0008), (48.0003, 11.0008), (48.0003, 11.0006),
              (48.0002, 11.0006)]  # fmt: skip
BESIDE: Ring = [(lat, lon + 0.002) for lat, lon in OUTLINE]


def _written(folder: Path, version: int, polygons: list[list[Ring]]) -> Path:
    """Task data with one field of these polygons, by the package `isoxml`."""
    import isoxml.models.base.v3 as iso3
    import isoxml.models.base.v4 as iso4
    from isoxml.util.isoxml_io import isoxml_to_dir

    iso: Any = iso3 if version == 3 else iso4

    def polygon(rings: list[Ring]) -> Any:
        lines = [
            iso.LineString(
                type=iso.LineStringType(str(1 if k == 0 else 2)),
                points=[
                    iso.Point(
                        type=iso.PointType("2"), north=Decimal(str(lat)), east=Decimal(str(lon))
                    )
                    for lat, lon in ring
                ],
            )
            for k, ring in enumerate(rings)
        ]
        return iso.Polygon(type=iso.PolygonType("1"), line_strings=lines)

    data = iso.Iso11783TaskData(
        management_software_manufacturer="isoxml", management_software_version="0",
        data_transfer_origin=iso.Iso11783TaskDataDataTransferOrigin("1"),
        partfields=[iso.Partfield(id="PFD1", designator="meadow", area=6000,
                                  polygons=[polygon(rings) for rings in polygons])],
    )  # fmt: skip
    folder.mkdir(parents=True)
    isoxml_to_dir(folder, data, {})
    return folder


def exported(kind: TaskDataKind, folder: Path, limit_s: float = LIMIT_S) -> Exported:
    """Two robots work it for a while, and what they did is written and checked.

    Raises subprocess.CalledProcessError if it cannot be written.
    """
    command = module_command("tools.cli.headland")
    out, zipped = folder / "run", folder / "work.zip"
    feature = ["--feature", kind.feature] if kind.feature else []
    # A run that is cut short exits with 1.
    run = [*command, "run", str(kind.path), *feature, "--robots", "2", "--limit", f"{limit_s:g}"]
    subprocess.run([*run, "--out", str(out)], capture_output=True, check=False)
    subprocess.run(
        [*command, "export", str(out), "--isoxml", str(zipped)], capture_output=True, check=True
    )
    return Exported(kind.name, tuple(schema_errors(zipped)), zipped)


def schema_errors(zipped: Path) -> Iterator[str]:
    """What the models of version 4 do not allow in a zip of task data, and in its time logs."""
    import isoxml.models.base.v4 as iso4
    from xsdata.formats.dataclass.parsers import XmlParser
    from xsdata.formats.dataclass.parsers.config import ParserConfig

    def parser(values: bool) -> XmlParser:
        return XmlParser(config=ParserConfig(fail_on_unknown_properties=True,
                         fail_on_unknown_attributes=True, fail_on_converter_warnings=values))  # fmt: skip

    with zipfile.ZipFile(zipped) as files:
        for name in sorted(n for n in files.namelist() if n.upper().endswith(".XML")):
            # The header of a time log has no values where the log itself has them.
            header = name.startswith("TLG")
            root: Any = iso4.Time if header else iso4.Iso11783TaskData
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # of values that a header leaves out
                    read = parser(not header).from_bytes(files.read(name), root)
            except Exception as problem:  # the parser and its converters raise what they like
                yield f"{name}: {problem}"
                continue
            if not header:
                yield from _wrong(read, name)


def _wrong(element: Any, where: str) -> Iterator[str]:
    for item in dataclasses.fields(element):
        value, rule = getattr(element, item.name), item.metadata
        place = f"{where}/{rule.get('name', item.name)}"
        if rule.get("type") == "Element":
            inner = value if isinstance(value, list) else [] if value is None else [value]
            if len(inner) < rule.get("min_occurs", 0) or len(inner) > rule.get(
                "max_occurs", 1 << 31
            ):
                yield f"{place}: {len(inner)} of them"
            for one in inner:
                yield from _wrong(one, place)
        elif value is None:
            if rule.get("required"):
                yield f"{place}: absent"
        else:
            yield from (f"{place}: {value!r}: {why}" for why in _broken(value, rule))


def _broken(value: Any, rule: Any) -> Iterator[str]:
    value = getattr(value, "value", value)  # of an enumeration
    text = value.hex() if isinstance(value, bytes) else str(value)
    if "pattern" in rule and not re.fullmatch(rule["pattern"], text):
        yield f"does not match {rule['pattern']}"
    if len(text) < rule.get("min_length", 0) or len(text) > rule.get("max_length", 1 << 31):
        yield "its length"
    if isinstance(value, int | float | Decimal):
        low, high = rule.get("min_inclusive"), rule.get("max_inclusive")
        if (low is not None and value < low) or (high is not None and value > high):
            yield f"not in {low} .. {high}"


def warnings_of(zips: list[Path], folder: Path) -> list[dict[str, Any]]:
    """What isoxml-js says of each: `warnings`, and how many `fields` and `records` it found.

    Raises ReaderAbsent with the reason where that package cannot be had.
    """
    if shutil.which("npm") is None or shutil.which("node") is None:
        raise ReaderAbsent("node and npm are not installed")
    got = subprocess.run(
        ["npm", "install", "--no-audit", "--no-fund", "--prefix", str(folder), READER],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if got.returncode:
        raise ReaderAbsent(f"npm cannot install {READER}")
    (folder / "read.js").write_text(READ)
    said = subprocess.run(
        ["node", "read.js", *map(str, zips)], cwd=folder, capture_output=True, text=True, check=True
    ).stdout
    read: list[dict[str, Any]] = json.loads(said)
    return read
