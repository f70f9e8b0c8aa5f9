"""The report of a run: what it says is what happened, and its page needs nothing else."""

import csv
import json
import math
import os
import random
import re
import shutil
from base64 import b64encode
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.ticker import MaxNLocator
from PIL import Image

from agent.interface.lifecycle import State
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member, Pose
from protocol.frames.frame import Frame
from protocol.frames.safety_frames import EmergencyReset, EmergencyStop
from sim.files.candump import CandumpWriter
from sim.fleet.outcome import COVERAGE_MIN
from sim.record.recording import Recording
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import Crash, Estop, Fault, Heal, Partition, Reset, Restart, load
from tools.bench.browser import browser, complaints, missing
from tools.common.run_flaws import ALL_COVERED, flaws
from tools.inspect.inspector import NO_KEYS
from tools.livemap.command import recorded
from tools.report.chapter import chapters
from tools.report.command import report
from tools.report.figures import gantt, tracks
from tools.report.page import page
from tools.report.run_data import RunEvidence, gather
from tools.report.svg_chart import Axes, AxisSpan, PlotBox, ticks
from tools.report.timeline import BusAddress, History, TimelineEvent, TimelineSpan
from tools.report.tracking_error import SAME_M, followed
from tools.run.run_field import run as run_command
from tools.run.run_recorder import RunRecorder

STOP_S, RESET_S, CRASH_S, AGAIN_S, END_S = 12.0, 16.0, 22.0, 27.0, 32.0
HOSTILE = "<script>alert(1)</script>"
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four robots on a small field: a stop, a release, a split, a death and a return; reported."""
    out = tmp_path_factory.mktemp("run")
    scenario = load("small").changed(4, 3)
    faults: list[Fault] = [
        Partition(at_s=5.0, kind="partition", islands=[[0, 1], [2, 3]]),
        Heal(at_s=8.0, kind="heal"),
        Estop(at_s=STOP_S, kind="estop", robot=2, reason="PERSON_IN_FIELD"),
        Reset(at_s=RESET_S, kind="reset"),
        Crash(at_s=CRASH_S, kind="crash", robot=1),
        Restart(at_s=AGAIN_S, kind="restart", robot=1, disk="kept"),
    ]
    limit = scenario.run.model_copy(update={"time_limit_s": END_S})
    setting = FieldSetup(scenario.model_copy(update={"fault": faults, "run": limit}))
    keeping = RunRecorder(setting, out)
    expedition = FieldRun(setting, out, attach=keeping)
    outcome = expedition.run()
    keeping.close()
    figures = {**outcome.to_dict(), "scenario": HOSTILE, "faults": expedition.told_faults}
    (out / "report.json").write_text(json.dumps(figures))
    assert report(out, None, False) == 0
    return out


def values(run: Path, name: str) -> list[dict[str, str]]:
    with (run / "report" / f"{name}.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def traces(run: Path) -> list[dict[str, str]]:
    return [json.loads(line) for line in (run / "trace.jsonl").read_text().splitlines()]


class Reader(HTMLParser):
    """Tags that are open, and all that a page asks for."""

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[str] = []
        self.names: set[str] = set()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.names.add(tag)
        self.asked += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.slow
def test_the_page_is_whole_and_asks_for_nothing(run: Path) -> None:
    text = (run / "report.html").read_text()
    reader = Reader()
    reader.feed(text)
    assert not reader.open
    assert "script" not in reader.names, "names come from files that others wrote"
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text
    for address in reader.asked:
        assert address.startswith("#") or (run / address).is_file(), address
    files = sorted((run / "report").glob("*.svg"))
    assert text.count("<svg ") == len(files) == 7
    for file in files:
        assert file.read_text() in text
        root = ElementTree.fromstring(file.read_bytes())  # on its own it is a whole document
        assert root.tag.endswith("}svg") and root.get("aria-label")


def test_states_are_those_that_the_robots_wrote_down(run: Path) -> None:
    """The log's states against the robots' own trace, to the time of a beat."""
    spans = values(run, "states")
    for trace in traces(run):
        if trace["machine"] != "lifecycle" or trace["target"] == "DISCONNECTED":
            continue
        at_s = int(trace["t_us"]) / 1e6
        own = [s for s in spans if s["robot"] == str(trace["robot"])]
        near = [float(s["from_s"]) for s in own if s["state"] == trace["target"]]
        short = any(
            float(s["from_s"]) - 0.1 <= at_s <= float(s["until_s"]) for s in own
        )  # a state that was over before the next beat
        assert short or any(abs(t_s - at_s) <= 0.1 for t_s in near), trace
    silent = [s for s in spans if s["state"] == "SILENT"]
    assert [s["robot"] for s in silent] == ["1"]
    assert abs(float(silent[0]["from_s"]) - CRASH_S) < 0.2
    assert AGAIN_S <= float(silent[0]["until_s"]) < AGAIN_S + 1.5


def test_sections_are_those_that_the_robots_claimed(run: Path) -> None:
    rows = values(run, "sections")
    begun = {(r["section"], r["owner"]) for r in rows if r["phase"] == "STARTED"}
    told = {
        (t["source"], str(t["robot"])) for t in traces(run)
        if t["machine"] == "claim" and t["target"] == "STARTED"
    }  # fmt: skip
    assert told and begun == told
    for section in {r["section"] for r in rows}:
        own = [r for r in rows if r["section"] == section]
        for a, b in pairwise(own):
            assert float(a["until_s"]) <= float(b["from_s"]), "one phase at a time"


def test_a_stop_reached_every_robot(run: Path) -> None:
    rows = values(run, "stops")
    assert {r["robot"] for r in rows} == {"0", "1", "3"} and {r["by"] for r in rows} == {"robot 2"}
    for row in rows:
        echo_s, stopped_s, stands_s = (float(row[k]) for k in ("echo_s", "stopped_s", "stands_s"))
        assert 0.0 < echo_s < 0.05 and echo_s <= stopped_s <= stands_s < 2.5
    events = values(run, "events")
    kinds = [e["kind"] for e in events]
    assert [k for k in kinds if k.startswith("fault")] == [
        f"fault: {kind}" for kind in ("partition", "heal", "estop", "reset", "crash", "restart")
    ]
    assert {"stop", "reset", "silence"} <= set(kinds)
    assert [float(e["t_s"]) for e in events] == sorted(float(e["t_s"]) for e in events)


def test_the_load_is_that_of_the_wire(run: Path) -> None:
    figures = json.loads((run / "report.json").read_text())
    shares = [float(row["all"]) for row in values(run, "load")]
    mean = sum(shares) / figures["simulated_s"]
    assert mean == pytest.approx(figures["bus_load_worst_case"], rel=0.02)


# -------------------------------------------------------------------- planned against executed


def intents(
    points: list[tuple[float, float]], line: list[tuple[float, float]], passed: list[int]
) -> list[tuple[int, dict[str, object]]]:
    return [
        (k * 200_000, {"slot": 0, "x": x, "y": y, "vx": 1.0, "vy": 0.0, "tool": k % 2 == 0,
                       "path": [list(p) for p in line[gone:]]})
        for k, ((x, y), gone) in enumerate(zip(points, passed, strict=True))
    ]  # fmt: skip


def test_the_error_is_the_distance_to_the_line_followed() -> None:
    """Along an L with a known offset: that offset, and no other."""
    line = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)]
    points = [(0.0, 0.0), *((x, 0.3) for x in (1.0, 5.0, 9.0)), (10.4, 2.0), (10.4, 9.0)]
    robot = followed(intents(points, line, [1, 1, 1, 1, 2, 2]), 0)[0]
    assert [round(s.off_m, 6) for s in robot.samples] == [0.3, 0.3, 0.3, 0.4, 0.4]
    assert robot.rmse_m() == pytest.approx(math.sqrt((3 * 0.09 + 2 * 0.16) / 5))
    assert len(robot.lines) == 1 and robot.rmse_m(True) != robot.rmse_m(False)


@pytest.mark.parametrize("seed", range(5))
def test_another_way_is_another_line(seed: int) -> None:
    """Back over the way that was come, and to one point of it: a new plan, without an old error."""
    rng = random.Random(seed)
    length_m = rng.uniform(5.0, 50.0)
    for back in ([(length_m / 2, 0.0), (0.0, 0.0)], [(0.0, 0.0)], [(1.0, 0.0), (1.0, 9.0)]):
        out = intents([(0.0, 0.0), (length_m - 1.0, 0.0)], [(length_m, 0.0)], [0, 0])
        again = [(t + 400_000, told) for t, told in intents([(length_m - 0.1, 0.0)], back, [0])]
        robot = followed([*out, *again], 0)[0]
        assert len(robot.lines) == 2 and robot.worst_m < SAME_M, f"seed {seed}, {back}"


def test_a_short_cut_that_rejoins_the_old_line_is_another_line() -> None:
    """What is left lies on the line that was told before, and the robot never drives the bend."""
    line = [(0.0, 0.0), (0.0, 5.0), (5.0, 5.0), (5.0, 0.0), (9.0, 0.0)]
    points = [(0.0, 0.0), (0.0, 0.1), (1.0, 0.0), (4.0, 0.0), (6.0, 0.0)]
    robot = followed(intents(points, line, [1, 1, 4, 4, 4]), 0)[0]
    assert len(robot.lines) == 2 and robot.worst_m <= 0.1


def test_a_way_told_in_thinned_points_is_one_line() -> None:
    """Tractors tell a curve by other points each time (`agent.motion.tractor_tracker`), and only
    48 of them."""
    angle = np.linspace(0.0, math.pi, 1200)
    curve = 20.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    rows = []
    for k in range(0, 1190, 6):
        rest = curve[k + 1 :]
        thinned = [*rest[:-1:19], rest[-1]][:48]
        (x, y), path = 1.005 * curve[k], [[round(v, 2) for v in p] for p in np.array(thinned)]
        rows.append((k * 33_000, {"slot": 3, "x": x, "y": y, "vx": 1.0, "vy": 0.0, "path": path}))
    robot = followed(rows, 0)[0]
    assert len(robot.lines) == 1
    assert robot.rmse_m() == pytest.approx(0.1, abs=0.03)


@pytest.mark.slow
def test_errors_of_errands_are_those_that_the_world_measured(tmp_path: Path) -> None:
    """Two measurements of the same driving: by the world, and from what the robots told."""
    assert run_command("corridor", 4, 2, tmp_path, True) == 0
    assert report(tmp_path, tmp_path / "page.html", True) == 0
    legs = json.loads((tmp_path / "report.json").read_text())["legs"]
    with (tmp_path / "page" / "planned.csv").open(newline="") as file:
        rows = {int(row["robot"]): row for row in csv.DictReader(file)}
    for slot, row in rows.items():
        worst = max(leg["rmse_m"] for leg in legs if leg["slot"] == slot)
        assert abs(float(row["RMSE, m"]) - worst) < 0.03, (slot, row, legs)


# -------------------------------------------------------------------- runs that lack something


def test_a_log_alone(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(run / "can.log", tmp_path / "far.log")
    assert report(tmp_path / "far.log", None, True) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["without"] == ["planned"] and Path(told["page"]).is_file()
    text = Path(told["page"]).read_text()
    assert "run.mcap" in text and "is not known here" in text and "No report.json" in text


def test_a_second_report_at_one_place_keeps_nothing_of_the_first(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    assert report(run / "can.log", out, False) == 0
    assert (tmp_path / "page" / "stops.csv").is_file()
    quiet = CandumpWriter(tmp_path / "quiet.log")
    for number in range(20):
        quiet.write(number * 100_000, encode(Pose(0.0, 0.0, 0.0, 0.0, 1, False, 255), 0x80))
    quiet.close()
    (tmp_path / "page" / "notes.txt").write_text("of a person")
    assert report(tmp_path / "quiet.log", out, False) == 0
    left = {path.name for path in (tmp_path / "page").iterdir()}
    assert "notes.txt" in left and not left & {"stops.csv", "stops.svg"}, left


def test_a_log_in_which_nobody_is_a_robot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = CandumpWriter(tmp_path / "can.log")
    log.write(5_000_000, Frame(0x18FEF100, b"\1\2\3"))
    log.close()
    assert report(tmp_path, None, True) == 0
    assert json.loads(capsys.readouterr().out)["chapters"] == ["load"]


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "text", ["[1, 2]", "{", '{"rings": 3, "grid": {"rows": "x"}}', '{"rings": [[]]}']
)
def test_what_others_wrote_may_be_nonsense(run: Path, tmp_path: Path, text: str) -> None:
    shutil.copy(run / "can.log", tmp_path)
    for name in ("scene.json", "report.json"):
        (tmp_path / name).write_text(text)
    assert report(tmp_path, None, True) == 0


def test_a_campaign(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    broken = [{"seed": 7, "rule": "S1", "t_s": 1.5, "what": HOSTILE}]
    told = {"profile": "stop", "runs": 9, "robot_hours": 1.0, "hash": "ab", "faults": {"crash": 3},
            "broken": broken, "failed": [7], "reproduction": "stop-7-S1.toml"}  # fmt: skip
    (tmp_path / "chaos.json").write_text(json.dumps(told))
    assert report(tmp_path, None, True) == 0
    assert json.loads(capsys.readouterr().out)["chapters"] == ["chaos"]
    page = (tmp_path / "report.html").read_text()
    assert "3 crash" in page and HOSTILE not in page and "stop-7-S1.toml" in page


def test_what_cannot_be_done_is_one_line(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "empty.log").write_text("")
    for source, out in (
        (tmp_path / "none", None), (tmp_path, None), (tmp_path / "empty.log", None),
        (run, tmp_path / "page.pdf"), (run, tmp_path / "file" / "page.html"),
    ):  # fmt: skip
        assert report(source, out, False) == 2
        said = capsys.readouterr()
        assert said.err.startswith("headland: ") and said.err.count("\n") == 1 and not said.out


def test_times_of_a_real_bus_begin_at_its_first_frame(tmp_path: Path) -> None:
    """A computer's clock; a press by a panel; a robot that does not answer."""
    begin_at_us = 1_700_000_000_000_000
    log = CandumpWriter(tmp_path / "can.log")
    log.write(begin_at_us, encode(Member(4, 1, 7), 0x84))
    for k in range(40):
        log.write(begin_at_us + k * 100_000, encode(Pose(1.0, 2.0, 0.0, 0.0, 1, False, 255), 0x84))
        if k == 10:
            log.write(begin_at_us + 1_000_001, encode(EmergencyStop(200, 1, 1, 1), 0xF0))
        if k == 30:
            log.write(begin_at_us + 3_000_001, encode(EmergencyReset(200, 1, 1, 201), 0xF1))
    log.close()
    evidence = gather(tmp_path)
    assert isinstance(evidence.recording, Recording)
    history = History(evidence.zero_at_us)
    for k in range(evidence.recording.count):
        t_us, frame = evidence.recording[k]
        history.hear(t_us / 1e6, frame)
    history.close()
    (stop,) = history.pressed
    assert stop.by == "device 200" and stop.present == (4,) and not stop.echo_s
    assert stop.t_s == pytest.approx(1.000001, abs=1e-5) and stop.cleared_s is not None
    assert report(tmp_path, None, True) == 0
    assert "nobody of 1" in (tmp_path / "report.html").read_text()


@pytest.mark.slow
@pytest.mark.skipif(bool(missing()), reason=missing() or "there is one")
def test_a_browser_shows_every_picture(run: Path) -> None:
    from axe_selenium_python import Axe

    with browser() as page:
        page.get((run / "report.html").absolute().as_uri())
        asked = (
            "return [...document.querySelectorAll('svg')].map(i => i.getBoundingClientRect().width)"
        )
        widths = page.execute_script(asked)
        assert len(widths) == 7 and all(width > 450 for width in widths)
        assert not complaints(page)
        assert page.execute_script("return document.querySelectorAll('script').length") == 0
        judge = Axe(page)
        judge.inject()
        assert not judge.run()["violations"]


@pytest.mark.slow
@pytest.mark.skipif(bool(missing()), reason=missing() or "there is one")
def test_no_word_of_a_picture_is_cut_off_at_its_edge(run: Path) -> None:
    """Names of frames in the legend were: capitals are wider than other letters."""
    with browser() as page:
        page.get((run / "report.html").absolute().as_uri())
        cut = page.execute_script(
            "return [...document.querySelectorAll('svg text')].filter(each => {"
            " const word = each.getBoundingClientRect();"
            " const whole = each.closest('svg').getBoundingClientRect();"
            " return word.right > whole.right || word.left < whole.left; })"
            ".map(each => each.textContent);"
        )
        assert cut == []


@pytest.mark.slow
@pytest.mark.skipif(bool(missing()), reason=missing() or "there is one")
def test_pictures_are_dark_where_the_browser_is(run: Path, tmp_path: Path) -> None:
    shades = []
    for wish in ("light", "dark"):
        with browser() as page:
            media = {"features": [{"name": "prefers-color-scheme", "value": wish}]}
            page.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
            page.get((run / "report" / "tracks.svg").absolute().as_uri())
            assert not complaints(page)
            page.save_screenshot(str(tmp_path / "shown.png"))
        with Image.open(tmp_path / "shown.png") as shown:
            shades.append(sorted(shown.convert("L").resize((100, 60)).tobytes())[3000])
    assert shades[0] > 200 and shades[1] < 60, "the ground of the picture"


def test_events_stand_above_the_sections_on_the_same_axis(run: Path) -> None:
    text = (run / "report.html").read_text()
    order = [text.index(f'<h2 id="{name}"') for name in ("events", "sections", "stops", "tracks")]
    assert order == sorted(order)
    told = [TimelineEvent(1.0, "stop", "robot 1", "PERSON"), TimelineEvent(2.0, "silence", "", "")]
    held = [TimelineSpan(3, "DONE", 1, 0.0, 4.0)]
    picture = gantt(held, 9.0, told)
    assert picture == gantt(held, 9.0, told), "equal figures give equal bytes"
    root = ElementTree.fromstring(picture.svg)
    words = [element.text for element in root.iter(f"{SVG}text")]
    assert {"stop", "silence", "S3", "robot 1 PERSON"} <= set(words)
    bar = next(r for r in root.iter(f"{SVG}rect") if r.find(f"{SVG}title") is not None)
    assert bar.findtext(f"{SVG}title") == "S3 done, robot 1, 0.0 to 4.0 s"
    marks = [p for p in root.iter(f"{SVG}path") if p.get("class") == "hl-fault-line"]
    beside = [re.match(r"M([0-9.]+) ", p.get("d", ""))[1] for p in marks]  # type: ignore[index]
    assert len(beside) == 2 and len(set(beside)) == 1, (
        "the mark of the strip, and the line below it"
    )
    left, width = float(bar.get("x", "")), float(bar.get("width", ""))
    assert float(beside[0]) == pytest.approx(left + width / 4, abs=0.1), "1 s of the bar's 4 s"


@pytest.mark.parametrize("seed", range(20))
def test_a_thinned_line_is_nowhere_off_the_line(seed: int) -> None:
    """Each point that is left out lies within a pixel of one that is drawn, and both ends are drawn."""
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.normal(0.0, rng.choice([0.05, 0.5, 5.0]), (300, 2)), axis=0)
    axes = Axes(PlotBox(10.0, 20.0, 400.0, 300.0), AxisSpan(-30.0, 30.0), AxisSpan(-40.0, 40.0))
    drawn = np.array(
        re.findall(r"[ML](-?[0-9.]+) (-?[0-9.]+)", axes.path([points.tolist()])), float
    )
    pixels = np.array([axes.at(x, y) for x, y in points])
    apart_px = np.abs(pixels[:, None, :] - drawn[None, :, :]).max(axis=2)
    assert apart_px.min(axis=1).max() < 0.6, f"seed {seed}"
    assert apart_px[0, 0] < 0.06 and apart_px[-1, -1] < 0.06, f"seed {seed}"


@pytest.mark.parametrize("seed", range(20))
def test_ticks_are_round_and_cover_the_axis(seed: int) -> None:
    """Against matplotlib's own locator, whose steps are as round."""
    rng = random.Random(seed)
    begin = rng.uniform(-1e3, 1e3)
    end = begin + 10 ** rng.uniform(-1, 6)
    found = [value for value, _ in ticks(AxisSpan(begin, end), 10.0)]
    theirs = np.diff(MaxNLocator(10, steps=[1, 2, 5, 10]).tick_values(begin, end))[0]
    step = np.diff(found)[0]
    assert 4 <= len(found) <= 12 and 0.39 < step / theirs < 2.6, f"seed {seed}: {found}"
    assert begin <= found[0] < begin + step and end - step < found[-1] <= end, f"seed {seed}"
    assert np.allclose(np.array(found) / step % 1.0 % (1 - 1e-6), 0.0, atol=1e-6), f"seed {seed}"
    labels = [float(label) for _, label in ticks(AxisSpan(begin, end), 10.0)]
    assert labels == pytest.approx(found, abs=step / 10), f"seed {seed}"


@pytest.mark.parametrize("far", [float("nan"), float("inf"), 1e300, -1e300])
def test_what_is_no_place_is_not_drawn(far: float) -> None:
    axes = Axes(PlotBox(0.0, 0.0, 100.0, 100.0), AxisSpan(0.0, 10.0), AxisSpan(0.0, 10.0))
    assert axes.path([[(far, 1.0), (1.0, 1.0), (1.0, far), (5.0, 5.0)]]) == "M10.0 90.0L50.0 50.0"
    assert not axes.path([[(far, far)]])
    assert not axes.dot(far, 1.0, "red") and not axes.bar(far, 1.0, 0, "red")
    assert not list(ticks(AxisSpan(0.0, far), 5.0)) or abs(far) < float("inf")
    scene = {"rings": [[[0, 0], [9, 0], [9, 9], [far, 4]]]}
    told = tracks(scene, {1: [BusAddress(0.0, 1.0, 1.0, 0.0, False)]})
    assert b"nan" not in told.svg and b"inf" not in told.svg
    ElementTree.fromstring(told.svg)


def test_walls_of_a_grid_are_drawn_where_they_are() -> None:
    cells = np.zeros((4, 6), bool)
    cells[0, 1:3] = cells[3, 5] = True
    walls = b64encode(np.packbits(cells).tobytes()).decode()
    grid = {"rows": 4, "columns": 6, "cell_m": 2.0, "origin": [10.0, 20.0], "walls": walls}
    told = tracks({"grid": grid}, {0: [BusAddress(0.0, 11.0, 21.0, 0.0, False)]})
    found = ElementTree.fromstring(told.svg)
    data = next(p.get("d", "") for p in found.iter(f"{SVG}path") if p.get("fill") == "#8a8a8a")
    boxes = re.findall(r"M([0-9.]+) ([0-9.]+)H([0-9.]+)V([0-9.]+)", data)
    assert len(boxes) == 2
    (x, y, end_x, end_y), (other_x, other_y, *_) = (tuple(map(float, box)) for box in boxes)
    assert (end_x - x) == pytest.approx(2 * (end_y - y), abs=0.2), "two cells beside each other"
    assert other_x > end_x and other_y < y, "further east and north"


def test_the_page_begins_with_tiles_and_says_which_flaw_there_was() -> None:
    good = {"success": True, "coverage": 1.0, "makespan_s": 176.2, "contacts": 0, "bus_load": 0.038,
            "moved_after_stop": 0, "replicas_equal": True, "travel_m": 1009.0}  # fmt: skip
    text = page("t", good, [], "t")
    assert text.count("<li>") == 6 and "176 s" in text and "without a flaw" in text
    assert text.index('class="tiles"') < text.index("<details>"), (
        "the other figures are folded away"
    )
    left = [{"area_m2": 3.0, "why": "under a <wreck>"}]
    bad = good | {"success": False, "coverage": 0.9981, "unreached": left, "contacts": 2}
    told = page("t", bad, [], "t")
    assert "99.81% of the area is covered (under a &lt;wreck&gt;); 2 contacts of bodies" in told
    missed = {"missed": "39.1 m2 are left at 0.9,20.5, where robot 2 stands since 40.0 s"}
    assert f"covered ({missed['missed']}); 2 contacts" in page("t", bad | missed, [], "t")
    where = "at 61.2 s robot 1 touched robot 3 at 12.0,-3.5"
    assert flaws({"contacts": 2, "first_contact": where}) == [f"2 contacts of bodies ({where})"]
    assert flaws({"success": False}) == ["report.json has the figures"]


def test_what_is_told_of_the_ground_covered_is_the_same_everywhere_on_the_page() -> None:
    """A tile of 100.0% stood below a flaw of 99.96%, and 100.00% was named as a flaw beside a contact."""
    short = {"success": False, "coverage": 0.9996}
    assert "99.96% of the area is covered" in page("t", short, [], "t")
    assert "<span>covered</span> <b>99.96%</b>" in page("t", short, [], "t")
    touched = {"success": False, "coverage": 0.99997, "contacts": 1}
    assert flaws(touched) == ["1 contact of bodies"]
    assert ALL_COVERED == COVERAGE_MIN


def test_the_tile_of_the_time_of_an_unfinished_run_is_how_long_it_ran() -> None:
    """A fleet that was stopped from its first second on was shown with a time of 0 s."""
    stopped = {"success": False, "finished": False, "makespan_s": 0.0, "simulated_s": 60.0}
    assert "<span>time</span> <b>60 s</b>" in page("t", stopped, [], "t")
    done = {"success": True, "finished": True, "makespan_s": 176.2, "simulated_s": 178.0}
    assert "<span>time</span> <b>176 s</b>" in page("t", done, [], "t")
    errands = {"success": True, "finished": True, "simulated_s": 48.7}
    assert "<span>time</span> <b>49 s</b>" in page("t", errands, [], "t")


@pytest.mark.parametrize("keyed", [False, True])
def test_a_log_of_a_fleet_without_keys_says_so_in_red(keyed: bool, tmp_path: Path) -> None:
    """Without a report.json nobody said it: the heartbeats do."""
    log = tmp_path / "can.log"
    beat = Heartbeat(0, State.IDLE, False, False, True, False, 1.0, 0, 0, keyed)
    writer = CandumpWriter(log)
    for t_us, message in ((0, Member(1, 1, 7)), (1_000_000, beat)):
        writer.write(t_us, encode(message, 129))
    writer.close()
    evidence = gather(log)
    told = page("t", evidence.figures, list(chapters(evidence)), "t")
    assert (f'<p class="bad">{NO_KEYS}</p>' in told) is not keyed


@pytest.mark.parametrize("value", [10**400, float("inf"), "<b>", None, [1], {"a": 1}, float("nan")])
def test_a_figure_that_is_none_makes_no_tile(value: object) -> None:
    figures = {"success": False, "coverage": value, "contacts": value, "unreached": value}
    assert "<b>" not in page("t", figures, [], "t")


def test_the_title_is_the_scenario_s_and_the_line_below_tells_runs_apart(tmp_path: Path) -> None:
    """The title was alone: robots, length and day were nowhere at the top."""
    log = tmp_path / "can.log"
    log.write_text("(0.000000) can0 18EAFFFE#00EE00\n(125.000000) can0 18EAFFFE#00EE00\n")
    os.utime(log, (1e9, 1e9))
    figures = {"scenario": "yard", "robots": 3, "seed": 7}
    evidence = RunEvidence(log, recorded(log, None), figures, {}, 0)
    assert evidence.about == "3 robots, seed 7, 2:05 on the bus, 2001-09-09 01:46 UTC"
    text = page(evidence.name, figures, [], "t", evidence.about)
    assert "<title>yard · Headland</title>" in text
    assert f'<h1>yard</h1>\n<p class="about">{evidence.about}</p>' in text
    assert evidence._replace(source=tmp_path / "gone").about == "3 robots, seed 7, 2:05 on the bus"
