"""Task data is read as farm software wrote it; what is wrong with it is one line, whatever it is."""

import io
import json
import zipfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from agent.runtime.files.field_error import FieldFileError
from agent.runtime.files.field_file import read_boundary
from agent.runtime.files.isoxml_reader import read_isoxml
from tests.examples import examples

DATA = Path(__file__).parents[5] / "shared/data/fields"
real = pytest.mark.skipif(not DATA.exists(), reason="../shared/data/fields is absent")
HEAD = '<?xml version="1.0" encoding="utf-8"?>\n'
SQUARE = ["52.0,5.0", "52.0,5.002", "52.002,5.002", "52.002,5.0"]
HOLE = ["52.0005,5.0005", "52.0005,5.001", "52.001,5.001", "52.001,5.0005"]


def line(points: list[str], kind: str = "1") -> str:
    pairs = (point.split(",") for point in points)
    return (
        f'<LSG A="{kind}">' + "".join(f'<PNT A="2" C="{n}" D="{e}"/>' for n, e in pairs) + "</LSG>"
    )


def polygon(*lines: str, kind: str = "1") -> str:
    return f'<PLN A="{kind}">{"".join(lines)}</PLN>'


def partfield(*polygons: str, name: str = "Acre", number: int = 1) -> str:
    return f'<PFD A="PFD{number}" C="{name}" D="100">{"".join(polygons)}</PFD>'


def task_data(*elements: str, version: str = "4") -> str:
    return (
        f'{HEAD}<ISO11783_TaskData VersionMajor="{version}" VersionMinor="0" '
        f'DataTransferOrigin="1">{"".join(elements)}</ISO11783_TaskData>'
    )


GOOD = task_data(partfield(polygon(line(SQUARE), line(HOLE, "2"))))


def write(folder: Path, text: str | bytes, name: str = "TASKDATA.XML") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    content = text.encode() if isinstance(text, str) else text
    (folder / name).write_bytes(content)
    return folder / name


@real
def test_thirteen_real_fields_as_in_their_geojson() -> None:
    expected = json.loads((DATA / "isoxml-dotnet/partfields13.geojson").read_text())["features"]
    got = read_isoxml(DATA / "isoxml-dotnet/Partfields/TASKDATA.XML")
    assert len(got) == 13
    for feature in expected:
        rings = feature["geometry"]["coordinates"]
        assert got[feature["properties"]["name"]] == [[tuple(p) for p in ring] for ring in rings]


@real
@pytest.mark.parametrize("name", ["v4_cnh_export", "v4_full_task"])
def test_whole_task_files(name: str) -> None:
    assert read_boundary(DATA / "isoxml-py" / name).polygon.area > 100.0


@pytest.mark.parametrize("version", ["3", "4"])
@pytest.mark.parametrize("kind", ["file", "folder", "lower case", "zip", "zip of a folder"])
def test_file_folder_and_zip(tmp_path: Path, kind: str, version: str) -> None:
    text = GOOD.replace('VersionMajor="4"', f'VersionMajor="{version}"')
    path = tmp_path / "TASKDATA"
    if kind.startswith("zip"):
        path = tmp_path / "field.zip"
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("TASKDATA.XML" if kind == "zip" else "TASKDATA/Taskdata.xml", text)
    else:
        file = write(path, text, "taskdata.xml" if kind == "lower case" else "TASKDATA.XML")
        path = file if kind == "file" else path
    boundary = read_boundary(path)
    assert boundary.name == "Acre" and len(boundary.polygon.interiors) == 1
    assert 25_000 < boundary.polygon.area < 30_500


def test_fields_in_further_files(tmp_path: Path) -> None:
    write(tmp_path, task_data('<XFR A="PFD00001" B="1"/>'))
    write(tmp_path, f"{HEAD}<XFC>{partfield(polygon(line(SQUARE)))}</XFC>", "PFD00001.XML")
    assert list(read_isoxml(tmp_path)) == ["Acre"]


def test_a_field_in_two_parts_with_a_pond(tmp_path: Path) -> None:
    """Version 3 may have two outlines in one polygon; obstacles are cut out."""
    other = [f"{float(p.split(',')[0]) + 0.01},{p.split(',')[1]}" for p in SQUARE]
    both = polygon(line(SQUARE), line(other), line(HOLE, "2"))
    pond = polygon(line(["52.0104,5.0004", "52.0104,5.0008", "52.0108,5.0008"]), kind="3")
    write(tmp_path, task_data(partfield(both, pond), version="3"))
    outlines = read_isoxml(tmp_path)
    assert [len(rings) for rings in outlines.values()] == [2, 2]
    with pytest.raises(FieldFileError, match="2 fields; say which"):
        read_boundary(tmp_path)
    assert read_boundary(tmp_path, "Acre part 1").polygon.area > 25_000


def test_an_outline_inside_another_is_a_hole_and_one_inside_that_a_part(tmp_path: Path) -> None:
    """Issue 26: holes given as parts of their own. A repeated outline does not double the field."""
    island = ["52.0006,5.0006", "52.0006,5.0009", "52.0009,5.0009", "52.0009,5.0006"]
    write(tmp_path, task_data(partfield(polygon(line(HOLE)), polygon(line(SQUARE)))))
    assert [len(rings) for rings in read_isoxml(tmp_path).values()] == [2]
    parts = [polygon(line(ring)) for ring in (SQUARE, HOLE, island, SQUARE)]
    write(tmp_path, task_data(partfield(*parts)))
    assert [len(rings) for rings in read_isoxml(tmp_path).values()] == [2, 1]


def test_the_encoding_mark_and_names_twice(tmp_path: Path) -> None:
    again = partfield(polygon(line(SQUARE)), number=2)
    write(tmp_path, b"\xef\xbb\xbf" + GOOD.replace("</ISO", f"{again}</ISO").encode())
    assert list(read_isoxml(tmp_path)) == ["Acre", "Acre (PFD2)"]


def test_a_broken_field_does_not_hide_another_one_of_its_name(tmp_path: Path) -> None:
    broken = partfield(polygon(line(SQUARE[:2])))
    path = write(tmp_path, task_data(broken, partfield(polygon(line(SQUARE)), number=2)))
    assert read_boundary(path, "Acre (PFD2)").polygon.area > 0
    with pytest.raises(FieldFileError, match="a ring of 2 points"):
        read_boundary(path, "Acre")


def test_a_hole_that_cannot_be_read_is_not_left_out(tmp_path: Path) -> None:
    """Robots drove across it: a hole of its own that crosses itself, and one that crosses the fence."""
    bow = [HOLE[k] for k in (0, 2, 1, 3)]
    alone = task_data(partfield(polygon(line(SQUARE)), polygon(line(bow, "2"))))
    with pytest.raises(FieldFileError, match="repair the outline"):
        read_isoxml(write(tmp_path, alone))
    across = ["52.0005,5.0005", "52.0005,5.0025", "52.001,5.0025", "52.001,5.0005"]
    far = [point.replace("5.00", "5.01") for point in SQUARE]
    several = polygon(line(SQUARE), line(far), line(across, "2"))
    with pytest.raises(FieldFileError, match="repair the outline"):
        read_isoxml(write(tmp_path, task_data(partfield(several), version="3")))
    flat = ["52.0005,5.0005", "52.0005,5.001", "52.0005,5.0007"]  # takes nothing out
    without = task_data(partfield(polygon(line(SQUARE)), polygon(line(flat, "2"))))
    assert [len(rings) for rings in read_isoxml(write(tmp_path, without)).values()] == [1]


def numbers(point: str) -> str:
    return task_data(partfield(polygon(line([point, *SQUARE[1:]]))))


BOW = [SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]]
DOCTYPE = '<!DOCTYPE x [<!ENTITY a "b">]>'
WIDE = ["52.0,5.0", "52.0,6.0", "52.5,6.0", "52.5,5.0"]
WRONG: dict[str, tuple[str | bytes, str]] = {
    "empty": ("", "no version"),
    "not XML": ("field", "no version"),
    "cut off": (GOOD[:-40], "not task data"),
    "binary": (bytes(range(256)), "not UTF-8"),
    "another encoding": (GOOD.replace("utf-8", "cp037"), "cp037"),
    "UTF-16": (GOOD.encode("utf-16"), "not UTF-8"),
    "version 5": (GOOD.replace('Major="4"', 'Major="5"'), "version 5"),
    "document type": (GOOD.replace("\n", DOCTYPE), "document type"),
    "entity": (GOOD.replace("\n", DOCTYPE).replace("Acre", "&a;"), "document type"),
    "unknown entity": (GOOD.replace("Acre", "&a;"), "not task data"),
    "no fields": (task_data(), "no polygon"),
    "no boundary": (task_data(partfield()), "no polygon"),
    "no outline": (task_data(partfield(polygon())), "without an outline"),
    "two points": (task_data(partfield(polygon(line(SQUARE[:2])))), "needs 3"),
    "no number": (numbers("north,5.0"), "not two numbers"),
    "nothing": (numbers(","), "not two numbers"),
    "not a number": (numbers("NaN,5.0"), "degrees"),
    "infinite": (numbers("52.0,Infinity"), "degrees"),
    "huge": (numbers("1e400,5.0"), "degrees"),
    "metres": (numbers("5760000,5.0"), "degrees"),
    "self-crossing": (task_data(partfield(polygon(line(BOW)))), "Self-intersection"),
    "hole outside": (task_data(partfield(polygon(line(HOLE), line(SQUARE, "2")))), "repair"),
    "a county": (task_data(partfield(polygon(line(WIDE)))), "divide it"),
    "a way out": (task_data('<XFR A="../../x" B="1"/>'), "no name of an external file"),
    "missing file": (task_data('<XFR A="PFD00009" B="1"/>'), "no PFD00009.XML"),
}  # fmt: skip


@pytest.mark.parametrize("kind", sorted(WRONG))
def test_what_is_wrong_is_one_line(tmp_path: Path, kind: str) -> None:
    text, reason = WRONG[kind]
    path = write(tmp_path, text)
    with pytest.raises(FieldFileError, match=reason) as caught:
        read_boundary(path)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)
    assert len(str(caught.value)) < 300 + len(str(path))


def test_no_such_file_and_folders_without_one(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "TASKDATA.XML", tmp_path / "a.zip"):
        with pytest.raises(FieldFileError, match=r"no TASKDATA.XML|cannot be read"):
            read_boundary(path)


def test_zips_that_are_none_and_that_blow_up(tmp_path: Path) -> None:
    bad = tmp_path / "bad.zip"
    bad.write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(FieldFileError, match="not a zip"):
        read_boundary(bad)
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("TASKDATA.XML", b" " * (65 << 20))
    bad.write_bytes(bomb.getvalue())
    assert len(bomb.getvalue()) < 100_000
    with pytest.raises(FieldFileError, match="larger than 64 MiB"):
        read_boundary(bad)


@given(st.data())
@settings(
    max_examples=examples(400),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_damaged_files_never_raise_anything_else(tmp_path: Path, data: st.DataObject) -> None:
    """Bytes of a good file or zip changed, cut or repeated anywhere."""
    zipped = data.draw(st.booleans())
    content = bytearray(GOOD.encode())
    if zipped:
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("TASKDATA.XML", GOOD)
        content = bytearray(packed.getvalue())
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(content) - 1))
        edit = data.draw(st.sampled_from(["change", "cut", "repeat"]))
        until = min(at + data.draw(st.integers(1, 40)), len(content))
        if edit == "change":
            content[at] = data.draw(st.integers(0, 255))
        elif edit == "cut" and until - at < len(content):
            del content[at:until]
        else:
            content[at:at] = content[at:until]
    path = write(tmp_path, bytes(content), "a.zip" if zipped else "TASKDATA.XML")
    try:
        assert read_boundary(path).polygon.is_valid
    except FieldFileError as problem:
        assert "\n" not in str(problem)


def test_a_name_that_parts_of_a_field_have_is_not_given_twice(tmp_path: Path) -> None:
    """The names that are taken were compared with each new one; 20,000 fields took 25 s."""
    far = [f"5{point[1:]}" if point[0] == "5" else point for point in SQUARE]
    moved = [",".join((n, f"{float(e) + 0.01:.3f}")) for n, e in (p.split(",") for p in far)]
    parts = partfield(polygon(line(SQUARE)), polygon(line(moved)))
    same, plain = (partfield(polygon(line(SQUARE)), number=k) for k in (2, 3))
    other = partfield(polygon(line(SQUARE)), name="Acre part 1", number=4)
    got = read_isoxml(write(tmp_path, task_data(parts, same, plain, other)))
    assert list(got) == [
        "Acre part 0", "Acre part 1", "Acre (PFD2)", "Acre (PFD3)", "Acre part 1 (PFD4)",
    ]  # fmt: skip


def test_an_external_file_that_is_named_often_is_read_once(tmp_path: Path) -> None:
    """It was read and joined at each mention: 20,000 of them took 25 s."""
    mention = '<XFR A="PFD00001" B="1"/>'
    inner = f"{HEAD}<XFC>{partfield(polygon(line(SQUARE)))}</XFC>"
    write(tmp_path, inner, "PFD00001.XML")
    assert list(read_isoxml(write(tmp_path, task_data(mention * 3)))) == ["Acre"]
