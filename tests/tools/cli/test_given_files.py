"""Hostile and damaged files: one line, exit code 2, in two seconds of computing and 300 MB at most."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from random import Random

import pytest

from agent.runtime.files.field_error import POINTS_MAX, FieldFileError
from agent.runtime.files.field_file import read_boundary
from agent.runtime.files.given_file import GivenFileError, parse_json, parse_toml
from protocol.frames.frame import Frame
from protocol.frames.safety_frames import Reason
from sim.files.candump import CandumpWriter, read_candump
from sim.files.grid_map import FREE_CELLS_MAX
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import Estop, ScenarioError, load
from tests.tools.complaint import Complaints
from tests.tools.launching import ENVIRONMENT
from tools.common.child_process import ROOT, module_command

CPU_S, MEMORY_KB = 2.0, 300 * 1024  # to refuse, beyond what an absent file costs the same command
FIELD = 'name = "x"\n[field]\nfile = "small.geojson"\n'


def measured(folder: Path, *words: str) -> tuple[int, str, float, int]:
    """Exit code, what was said, seconds of computing, peak memory in kB."""
    read, write = os.pipe()
    pid = os.posix_spawn(
        sys.executable, [sys.executable, "-m", "tools.cli.headland", *words],
        {**ENVIRONMENT, "PWD": str(folder)},
        file_actions=[(os.POSIX_SPAWN_DUP2, write, 2), (os.POSIX_SPAWN_DUP2, write, 1)],
    )  # fmt: skip
    os.close(write)
    with os.fdopen(read, "r") as said:
        text = said.read()
    _, status, used = os.wait4(pid, 0)
    return os.waitstatus_to_exitcode(status), text, used.ru_utime + used.ru_stime, used.ru_maxrss


def ring(count: int) -> list[list[float]]:
    rng = Random(count)
    wave = [[0.01 * k / count, rng.random() * 1e-6] for k in range(count)]
    return [*wave, [0.005, 0.01], wave[0]]


def polygon(coordinates: object) -> str:
    return json.dumps({"type": "Polygon", "coordinates": coordinates})


def fault(rest: str) -> str:
    return f"{FIELD}[[fault]]\nat_s = 1\n{rest}\n"


BIG = 10**400


HOSTILE = {
    "f1 deep arrays": ("s.toml", "a = " + "[" * 50_000, "deep"),
    "f1 inline tables": ("s.toml", "a = " + "{a=" * 50_000, "deep"),
    "f1 dotted key": ("s.toml", ".".join("a" * 20_000) + " = 1", "parts"),
    "f1 dotted header": ("s.toml", "[" + ".".join("a" * 20_000) + "]", "parts"),
    "f1 quoted parts": ("s.toml", ".".join(['"?"'] * 9_000) + " = 1", "parts"),
    "f1 infinite time": ("s.toml", FIELD + '[[fault]]\nkind = "heal"\nat_s = inf\n', "at_s"),
    "f1 no number": ("s.toml", FIELD + "gate = [nan, 1]\n", "gate"),
    "f1 device": ("s.toml", FIELD.replace("small.geojson", "/dev/zero"), "regular"),
    "f1 long seed": ("s.toml", FIELD + "[run]\nseed = " + "9" * 5_000, "digits"),
    "f1 large seed": ("s.toml", FIELD + "[run]\nseed = " + "9" * 4_000, "seed"),
    "f1 nul": ("s.toml", FIELD.replace("small", "a\\u0000b"), "file name"),
    "f1 large": ("s.toml", "#" * 600_000, "larger"),
    "b6 reason": ("s.toml", fault('kind = "estop"\nrobot = 0\nreason = "PERSON"'), "reason"),
    "b6 islands": ("s.toml", fault('kind = "partition"\nislands = [[0, 9], [1]]'), "robot 9"),
    "b6 both": ("s.toml", fault('kind = "partition"\nislands = [[0, 1], [1]]'), "two islands"),
    "f2 points": ("f.geojson", polygon([ring(POINTS_MAX)]), "thin it out"),
    "f2 deep": ("f.json", "[" * 100_000, "deep"),
    "f2 no name": ("f.json", polygon(3), "rings"),
    "f2 huge number": ("f.json", polygon([[[BIG, 0], [0, 1], [1, 1], [0, 0]]]), "numbers"),
    "f2 not a number": ("f.json", polygon([[[float("nan"), 0], [0, 1], [1, 1]]]), "no number"),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_f1_f2_b6_a_hostile_scenario_or_field_is_one_line(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    name, text, why = HOSTILE[case]
    (tmp_path / name).write_text(text)
    said = Complaints(monkeypatch, capfd).of(f"run {name}", tmp_path)
    assert said.code == 2 and why in said.line and len(said.line) < 1200


def grid_map(height: str, *rows: str) -> str:
    head = f"type octile\nheight {height}\nwidth {len(rows[0])}\nmap\n"
    return head + "\n".join([*rows, ""])


GRIDS = {
    "f3 digits": ("m.map", grid_map("9" * 5_000, "..."), "not a Moving-AI map"),
    "f3 infinite root": ("i.mcpp", "map: m\nroot: [[Infinity, 1]]\n", "needs"),
    "f3 deep root": ("i.mcpp", "map: m\nroot: " + "[" * 100_000, "needs"),
    "f3 empty root": ("i.mcpp", "map: m\nroot: []\n", "no robot"),
    "f3 large free map": ("m.map", grid_map("600", *(600 * ["." * 600])), str(FREE_CELLS_MAX)),
}  # fmt: skip


@pytest.mark.parametrize("case", GRIDS)
def test_f3_a_hostile_grid_is_one_line(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    name, text, why = GRIDS[case]
    (tmp_path / name).write_text(text)
    said = Complaints(monkeypatch, capfd).of(f"coverage solve {name} --agents 1", tmp_path)
    assert said.code == 2 and why in said.line


@pytest.mark.slow
def test_f_what_is_large_is_refused_soon_and_in_little_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    free = "type octile\nheight 2048\nwidth 2048\nmap\n" + ("." * 2048 + "\n") * 2048
    (tmp_path / "m.map").write_text(free)
    million = {"type": "Polygon", "coordinates": [[[k / 1e6, 0] for k in range(1_000_000)]]}
    (tmp_path / "p.json").write_text(json.dumps(million))
    (tmp_path / "zero.toml").write_text(FIELD.replace("small.geojson", "/dev/zero"))
    points = '<PNT A="10" C="1" D="2"/>' * 1_000_000
    (tmp_path / "TASKDATA.XML").write_text(f'<ISO11783_TaskData VersionMajor="4">{points}')
    absent = ("coverage", "solve", "no.map"), ("run", "no.toml"), ("keys", "show", "no.json")
    starts = {words[0]: measured(tmp_path, *words)[2:] for words in absent}
    for words in (
        ("coverage", "solve", "m.map", "--agents", "2"), ("run", "p.json"), ("run", "zero.toml"),
        ("run", "TASKDATA.XML"), ("run", "/dev/zero"), ("keys", "show", "/dev/zero"),
    ):  # fmt: skip
        code, said, used_s, used_kb = measured(tmp_path, *words)
        assert code == 2 and said.startswith("headland: ") and said.count("\n") == 1, said[-500:]
        start_s, start_kb = starts[words[0]]
        more_s, more_kb = used_s - start_s, used_kb - start_kb
        assert more_s < CPU_S and more_kb < MEMORY_KB, (
            f"{words}: {more_s:.1f} s, {more_kb >> 10} MB"
        )


def test_l8_key_files_that_are_none_are_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    os.mkfifo(tmp_path / "fifo.json", 0o600)
    (tmp_path / "deep.json").write_text("[" * 60_000)
    (tmp_path / "deep.json").chmod(0o600)
    wrong = Complaints(monkeypatch, capfd)
    for name, why in (
        ("fifo.json", "regular"),
        ("/dev/zero", "regular"),
        ("deep.json", "not JSON"),
    ):
        said = wrong.of(f"keys show {name}", tmp_path)
        assert said.code == 2 and why in said.line
        assert wrong.of(f"run small --keys {name}", tmp_path).code == 2
        assert wrong.of(f"estop --keys {name} -i virtual -c x", tmp_path).code == 2
    before = os.umask(0)
    try:
        subprocess.run(
            [sys.executable, "-m", "tools.cli.headland", "keys", "new", "k"], cwd=tmp_path, check=True,
            env=ENVIRONMENT, stdout=subprocess.DEVNULL,
        )  # fmt: skip
    finally:
        os.umask(before)
    assert (tmp_path / "k").stat().st_mode & 0o077 == 0
    (tmp_path / "k" / "operator.json").chmod(0o644)
    assert "chmod 600" in wrong.of("keys show k/operator.json", tmp_path).line


def _log(path: Path, frames: int) -> None:
    log = CandumpWriter(path)
    for k in range(frames):
        log.write(k * 1000, Frame(0x0CFF1080, bytes(8)))
    log.close()


def test_f4_damaged_candump_lines_are_counted_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "can.log"
    _log(path, 5)
    with path.open("a") as file:
        file.write("(1.5) can0 123#00\n(1.5) can0 0CFF1080#R\n")  # not damaged, and not ours
        file.write("(1.5) can0 0CFF1080#0\nnonsense\n(x) can0 0CFF1080#00\n")
        file.write("(1.0) can0 0CFF10" + "0" * 9000)
    damaged: list[int] = []
    assert len(list(read_candump(path, lambda: damaged.append(1)))) == 5
    assert len(damaged) >= 4
    done = subprocess.run(
        [sys.executable, "-m", "tools.cli.headland", "inspect", "can.log"], cwd=tmp_path, check=False,
        env=ENVIRONMENT, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0 and f"{len(damaged)} damaged lines" in done.stderr


@pytest.mark.slow
def test_f4_a_damaged_mcap_is_no_traceback(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mcap", reason="the extra `operator` is not installed")
    from sim.record.mcap_log import McapLog, read_recording
    from sim.record.scene_builder import scene_of

    path = tmp_path / "run.mcap"
    log = McapLog(path, scene_of(FieldSetup(load("small"))))
    for k in range(20_000):
        log.write(k * 1000, Frame(0x0CFF1080, k.to_bytes(8, "little")))
    log.close()
    whole, rng = path.read_bytes(), Random(4)
    assert read_recording(path).count == 20_000
    for trial in range(60):
        cut = whole[: rng.randrange(9, len(whole))]
        path.write_bytes(cut)
        assert read_recording(path).count <= 20_000, f"cut, trial {trial}"
    refused = 0
    for _ in range(200):
        flipped = bytearray(whole)
        for _flip in range(rng.choice([1, 1, 8])):
            flipped[rng.randrange(len(whole))] ^= 1 << rng.randrange(8)
        path.write_bytes(flipped)
        try:
            read_recording(path)
        except ValueError:
            refused += 1
    assert refused > 50, "chunks have check sums"
    wrong = Complaints(monkeypatch, capfd)
    middle = whole.index(b"zstd") + 400  # of the first chunk
    path.write_bytes(whole[:middle] + b"\xff" * 400 + whole[middle + 400 :])
    for command in ("inspect", "report", "replay"):
        assert wrong.of(f"{command} run.mcap", tmp_path).code == 2


def test_b6_the_reasons_of_a_scenario_are_those_of_the_wire() -> None:
    said = Estop.model_json_schema()["properties"]["reason"]["enum"]
    assert said == [reason.name for reason in Reason]


@pytest.mark.parametrize(
    "text",
    ['a = "' + "x." * 500 + '"', "# " + "." * 90, "a = [" + "1.0, " * 500 + "]", "a.b.c = 1"],
)
def test_f1_honest_dots_are_read(text: str) -> None:
    parse_toml(text)
    with pytest.raises(GivenFileError):
        parse_json(text)


def test_m22_options_that_would_do_nothing_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    wrong = Complaints(monkeypatch, capfd)
    for words in (
        "run warehouse --drive ackermann", "run warehouse --seconds 5", "run rooms --live",
        "run rooms --seconds 5", "run small --port 29536", "run warehouse --map",
    ):  # fmt: skip
        said = wrong.of(words, tmp_path)
        assert said.code == 2 and words.split()[2] in said.line and "nothing" in said.line


@pytest.mark.slow
def test_m6_a_limit_may_be_said(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tools.cli.headland", "run", "small", "--limit", "20", "--json"],
        cwd=tmp_path, check=False, env=ENVIRONMENT, capture_output=True, text=True,
    )  # fmt: skip
    report = json.loads(done.stdout)
    assert done.returncode == 1 and not report["finished"] and report["simulated_s"] < 30


@pytest.mark.slow
def test_m20_a_disconnected_map_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "type octile\nheight 3\nwidth 9\nmap\n" + "...@.....\n" * 3
    (tmp_path / "m.map").write_text(text)
    (tmp_path / "i.mcpp").write_text("map: m\nroot: [[0, 0]]\n")
    monkeypatch.chdir(tmp_path)
    code, said, _, _ = measured(tmp_path, "coverage", "solve", "i.mcpp", "--json")
    assert code == 1 and "--reachable-only" in said
    assert '"unreached_cells": 15' in said and '"ok": false' in said
    code, said, _, _ = measured(
        tmp_path, "coverage", "solve", "i.mcpp", "--json", "--reachable-only"
    )
    assert code == 0 and '"unreached_cells": 15' in said and '"ok": true' in said


@pytest.mark.slow
def test_e15_a_launch_starts_in_a_folder_with_tools_of_its_own(tmp_path: Path) -> None:
    for name in ("tools", "agent"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise SystemExit('not ours')\n")
    done = subprocess.run(
        [*module_command("tools.cli.headland"), "launch", "small", "--robots", "1", "--seconds", "4"],
        cwd=tmp_path, check=False, capture_output=True, text=True, timeout=120,
        env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
    )  # fmt: skip
    assert "not ours" not in done.stdout + done.stderr
    log = (tmp_path / "runs/launch/robot0.log").read_text()
    assert done.returncode == 1 and "robot 0 is up" in log, (done.stderr, log)
    assert ROOT.name


PFD = '<PFD A="PFD{n}" C="{name}" D="100">{plns}</PFD>'
PNT = '<PNT A="{a}" C="{lat}" D="{lon}"/>'


def _pln(points: list[tuple[float, float]], kind: int) -> str:
    corners = "".join(PNT.format(a=2, lat=lat, lon=lon) for lon, lat in points)
    return f'<PLN A="1"><LSG A="{kind}">{corners}</LSG></PLN>'


def _square(side: float, at: float = 0.0) -> list[tuple[float, float]]:
    return [(at, at), (at + side, at), (at + side, at + side), (at, at + side), (at, at)]


def _task_data(folder: Path, *fields: tuple[str, str]) -> Path:
    pytest.importorskip("isoxml", reason="the extra `isoxml` is not installed")
    parts = "".join(
        PFD.format(n=k + 1, name=name, plns=plns) for k, (name, plns) in enumerate(fields)
    )
    head = '<ISO11783_TaskData VersionMajor="4" VersionMinor="3" DataTransferOrigin="1">'
    path = folder / "TASKDATA.XML"
    path.write_text(f'<?xml version="1.0" encoding="UTF-8"?>{head}{parts}</ISO11783_TaskData>')
    return path


def test_a9_one_odd_outline_spoils_no_other_field(tmp_path: Path) -> None:
    fine = _pln(_square(2e-3), 1)
    path = _task_data(tmp_path, ("good", fine), ("odd", _pln(_square(1e-3), 2)))
    assert read_boundary(path, "good").polygon.area > 1e4
    with pytest.raises(FieldFileError, match="without an outline"):
        read_boundary(path, "odd")
    with pytest.raises(FieldFileError, match="2 fields"):
        read_boundary(path)
    geo = tmp_path / "f.geojson"
    rings = [[list(point) for point in _square(2e-3)]]
    features = [
        {"type": "Feature", "properties": {"name": n}, "geometry": {"type": "Polygon", "coordinates": c}}
        for n, c in (("good", rings), ("odd", [[[0, "a"]]]))
    ]  # fmt: skip
    geo.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    assert read_boundary(geo, "good").polygon.area > 1e4
    with pytest.raises(FieldFileError, match="odd"):
        read_boundary(geo, "odd")


def test_a9_a_hole_that_is_a_boundary_of_its_own_is_taken_out(tmp_path: Path) -> None:
    outline, hole = _pln(_square(2e-3), 1), _pln(_square(5e-4, 5e-4), 2)
    whole = read_boundary(_task_data(tmp_path, ("f", outline))).polygon.area
    less = read_boundary(_task_data(tmp_path, ("f", outline + hole))).polygon
    assert less.area == pytest.approx(whole * (1 - 1 / 16), rel=1e-3) and len(less.interiors) == 1


def test_a21_every_field_of_a_file_can_be_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    fields = [(f"field {k:02d}", _pln(_square(2e-3, k * 1e-2), 1)) for k in range(13)]
    _task_data(tmp_path, *fields)
    said = Complaints(monkeypatch, capfd).of("run TASKDATA.XML", tmp_path).line
    assert "13 fields" in said and "headland fields" in said
    code, text, _, _ = measured(tmp_path, "fields", "TASKDATA.XML", "--json")
    rows = json.loads(text)
    assert code == 0 and [row["name"] for row in rows] == [name for name, _ in fields]


def test_a_field_that_no_run_takes_is_flagged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    flat = [[5, 52], [5.001, 52], [5.002, 52], [5, 52]]
    (tmp_path / "f.geojson").write_text(json.dumps({"type": "Polygon", "coordinates": [flat]}))
    refused = Complaints(monkeypatch, capfd).of("run f.geojson", tmp_path).line
    code, text, _, _ = measured(tmp_path, "fields", "f.geojson", "--json")
    assert code == 2
    for told in (refused, json.loads(text)[0]["wrong"]):
        assert "is nowhere as wide as the implement (4.0 m)" in told


def test_a9_the_published_sets_have_their_good_fields() -> None:
    shared = ROOT.parent / "shared" / "data" / "fields" / "isoxml-dotnet" / "partfields13.geojson"
    if not shared.is_file():
        pytest.skip("the field samples are not beside the project")
    with pytest.raises(FieldFileError, match="headland fields"):
        read_boundary(shared)


@pytest.mark.slow
def test_a10_a_field_of_three_kilometres_is_judged(tmp_path: Path) -> None:
    from sim.world.coverage_truth import coverage, sample_points

    side = 3.0 / 111.0
    geo = tmp_path / "f.geojson"
    geo.write_text(json.dumps({"type": "Polygon", "coordinates": [_square(side)]}))
    polygon = read_boundary(geo).polygon
    raster = sample_points(polygon, 6.0, 0.2)
    assert raster.cell_m == 1.0 and raster.area_m2 == pytest.approx(polygon.area, rel=0.01)
    assert coverage(raster, {0: [(0, 0.0, 0.0, True), (10, 100.0, 0.0, False)]}, 6.0).share > 0


def test_f2_a_field_with_as_many_points_as_are_supported_is_read(tmp_path: Path) -> None:
    geo = tmp_path / "f.geojson"
    geo.write_text(json.dumps({"type": "Polygon", "coordinates": [ring(POINTS_MAX - 2)]}))
    assert read_boundary(geo).polygon.area > 0


def test_f1_a_field_may_be_named_by_no_folder(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text(FIELD)
    assert FieldSetup(load(str(path))).field.sections  # B2: one that ships
    path.write_text(FIELD.replace("small", "nowhere"))
    with pytest.raises(ScenarioError, match="cannot be read"):
        FieldSetup(load(str(path)))


def test_a12_exported_files_are_named_and_labelled_as_others_do(tmp_path: Path) -> None:
    pytest.importorskip("isoxml", reason="the extra `isoxml` is not installed")
    from sim.runs.isoxml_writer import write_isoxml
    from sim.runs.work_geojson import read_work_geojson

    head = {
        "kind": "boundary",
        "name": "f",
        "started": "2026-01-01T00:00:00+00:00",
        "width_mm": 4000,
    }
    square = [[list(point) for point in _square(2e-3)]]
    log = {"kind": "log", "robot": 0, "t_ms": [0, 1000], "working": [1, 0]}
    features = [
        {"properties": {**head, "finished": True}, "geometry": {"coordinates": square}},
        {"properties": log, "geometry": {"coordinates": [[0, 0], [1e-4, 0]]}},
    ]
    (tmp_path / "work.geojson").write_text(json.dumps({"features": features}))
    write_isoxml(read_work_geojson(tmp_path / "work.geojson"), tmp_path / "T.zip")
    with zipfile.ZipFile(tmp_path / "T.zip") as archive:
        names = archive.namelist()
        text = archive.read(next(n for n in names if n.endswith("TASKDATA.XML"))).decode()
    assert any(name.endswith("TLG00001.bin") for name in names)
    assert any(name.endswith("TLG00001.xml") for name in names)
    assert 'G="FF000000006E65"' in text, "byte 7 first: en, as AgIsoStack and isoxml-dotnet have it"
