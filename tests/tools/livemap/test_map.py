"""The map in a real browser: a launch stopped and released from its page, a recording looked through."""

import contextlib
import json
import os
import queue
import random
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest

pytest.importorskip("httpx", reason="the extra `operator` is not installed")

import httpx

from agent.runtime.files import key_file
from sim.record.recording import Recording
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import Estop, Heal, Partition, Reset, load
from tools.bench.browser import browser, complaints, missing, until
from tools.inspect.log_frames import SourceError
from tools.livemap.command import MapThread, _reading, recorded, show_map
from tools.livemap.page_updates import PageUpdates
from tools.livemap.playback import Index, Player, Reader
from tools.livemap.server import _obey
from tools.report.command import _read
from tools.run.run_recorder import RunRecorder

if TYPE_CHECKING:
    from selenium.webdriver import Chrome

ROOT = Path(__file__).parents[3]
PICTURES = ROOT / "runs" / "pictures"  # kept, so that people can look at what was tested
WAIT_S = 60
CONSOLE = "Failed to load resource"  # Chromium's remark on an answer that refuses
needs_browser = pytest.mark.skipif(bool(missing()), reason=missing() or "there is one")
SPLIT_S, HEAL_S, STOP_S, RESET_S, END_S = 8.0, 20.0, 26.0, 32.0, 40.0


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six robots on a small field: a split, a heal, a stop, a release."""
    out = tmp_path_factory.mktemp("run")
    scenario = load("small").changed(6, 3)
    faults = [
        Partition(at_s=SPLIT_S, kind="partition", islands=[[0, 1, 2], [3, 4, 5]]),
        Heal(at_s=HEAL_S, kind="heal"),
        Estop(at_s=STOP_S, kind="estop", robot=2, reason="PERSON_IN_FIELD"),
        Reset(at_s=RESET_S, kind="reset"),
    ]
    limit = scenario.run.model_copy(update={"time_limit_s": END_S})
    setting = FieldSetup(scenario.model_copy(update={"fault": faults, "run": limit}))
    keeping = RunRecorder(setting, out)
    FieldRun(setting, out, attach=keeping).run()
    keeping.close()
    return out


@pytest.fixture
def shown(run: Path) -> Iterator[str]:
    yield MapThread(recorded(run, None), "the test", 0).url


@pytest.mark.slow
def test_a_jump_shows_what_playing_would_have_shown(run: Path) -> None:
    recording = recorded(run, None)
    index = Index(recording)
    index.work(1e9)
    assert index.complete
    first: dict[str, float] = {}
    for event in index.events:
        first.setdefault(event.text, event.at_s)
    due = {
        "bus split: 0 1 2 | 3 4 5": SPLIT_S, "the bus is one again": HEAL_S,
        "stop pressed at robot 2": STOP_S, "stop released": RESET_S,
    }  # fmt: skip
    assert all(0.0 <= first[text] - at_s < 2.0 for text, at_s in due.items()), first
    player, seed = Player(index, False, 1.0), 5
    player.playing = False
    rng = random.Random(seed)
    for _ in range(25):
        t_us = rng.randrange(recording.begin_at_us, recording.end_at_us)
        player.seek(t_us)
        while not player.caught_up:
            player.advance(0.0, 1e-4)  # too little time for it: it goes on at the next
        assert player.head_us == t_us
        plain = Reader(recording)
        assert plain.read(t_us, 1e9)
        assert player.watcher.to_dict() == plain.watcher.to_dict(), f"seed {seed}, {t_us} us"
        assert player.watcher.recent == plain.watcher.recent


def test_what_is_told_is_the_split_and_the_stop(run: Path) -> None:
    player = Player(Index(recorded(run, None)), False, 1.0)
    teller = PageUpdates(player)

    def at(seconds: float) -> dict[str, object]:
        player.seek(round(seconds * 1e6))
        player.advance(0.0, 1e9)
        return json.loads(json.dumps(teller.tell()))  # type: ignore[no-any-return]

    assert at(SPLIT_S - 1)["islands"] == [[0, 1, 2, 3, 4, 5]]
    assert at(SPLIT_S + 2)["islands"] == [[0, 1, 2], [3, 4, 5]]
    assert at(HEAL_S + 2)["islands"] == [[0, 1, 2, 3, 4, 5]]
    stop = at(STOP_S + 1)["stop"]
    assert isinstance(stop, dict)
    assert stop["stopped"] == [0, 1, 2, 3, 4, 5] and stop["moving"] == []
    assert stop["latched"][0]["slot"] == 2 and stop["latched"][0]["reason"] == "PERSON_IN_FIELD"
    assert at(END_S)["stop"]["latched"] == []  # type: ignore[index]


def test_only_this_page_is_answered(shown: str) -> None:
    shown, token = parts(shown)
    page = httpx.get(shown)
    policy = page.headers["content-security-policy"]
    assert "default-src 'none'" in policy and "unsafe" not in policy and "http" not in policy
    assert httpx.get(shown, headers={"host": "elsewhere.example"}).status_code == 403
    assert httpx.post(shown + "stop", headers={"origin": "http://elsewhere"}).status_code == 403
    for trusted in ({"origin": shown.rstrip("/")}, bearer(token)):
        answer = httpx.post(shown + "stop", headers=trusted)
        assert answer.status_code == 409 and "recording" in answer.json()["problem"]
    for name in ("index.html", "map.js", "field.js", "side.js", "map.css"):
        text = (ROOT / "tools/livemap/page" / name).read_text()
        assert "https://" not in text and "innerHTML" not in text, name


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "7", '{"do": 3}', '{"do": "seek", "t": "x"}', '{"do": "seek", "t": 1e999}',
             '{"do": "speed", "value": null}', '{"do": "robot", "slot": 99}', '{"do": "seek", "t": NaN}'],
)  # fmt: skip
def test_requests_that_make_no_sense_are_passed_over(text: str) -> None:
    player = Player(Index(Recording()), False, 1.0)
    assert _obey(text, player, PageUpdates(player)) is None


def test_ctrl_c_ends_the_map_as_any_command(tmp_path: Path) -> None:
    """The web server takes the signal for itself, and has to pass it on."""
    log = tmp_path / "a.log"
    log.write_text("(0.000000) can0 18FF1080#0000000000000000\n")
    words = ("-m", "tools.cli.headland", "map", str(log), "--page-port", "0")
    with subprocess.Popen(
        [sys.executable, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT
    ) as shown:  # fmt: skip
        assert shown.stdout is not None
        url = shown.stdout.readline().split()[1]
        assert httpx.get(url, timeout=WAIT_S).status_code == 200, "it serves"
        shown.send_signal(signal.SIGINT)
        _, errors = shown.communicate(timeout=WAIT_S)
    assert (shown.returncode, errors) == (130, "")


def test_what_a_person_can_get_wrong_is_one_line(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "no.mcap").write_bytes(b"nothing of the kind")
    for source, port, words in (
        (tmp_path / "none.log", 0, "no such log"),
        (tmp_path / "no.mcap", 0, "not an MCAP file"),
    ):
        assert show_map(source, "socketcand", "can0", 250_000, "", 0, None, None, port, False) == 2
        assert words in capsys.readouterr().err
    taken = MapThread(recorded(run, None), "", 0)
    port = taken.listener.getsockname()[1]
    assert show_map(run, "socketcand", "can0", 250_000, "", 0, None, None, port, False) == 2
    assert "--page-port" in capsys.readouterr().err
    assert show_map(run, "socketcand", "can0", 250_000, "", 0, None, "nowhere", 0, False) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_folder_with_brackets_in_its_name_can_be_read() -> None:
    """They were read as marks of a style, and a folder `a[/b]` ended the command with a traceback."""
    with _reading(Path("a[/b]"), True):
        pass
    with pytest.raises(SourceError, match="nowhere"):
        _read(Path("nowhere[/b]"))


@pytest.mark.slow
@needs_browser
def test_a_recording_is_looked_through(shown: str) -> None:
    with browser() as page:
        page.get(shown)
        until(page, "document.querySelectorAll('#fleet tbody tr').length === 6")
        page.find_element("id", "play").click()
        until(page, "!headland.state().playing")
        scrub(page, SPLIT_S + 3)
        until(page, f"Math.abs(headland.state().t - {SPLIT_S + 3}) < 0.02")  # the slider's step
        until(page, "!document.getElementById('split').hidden")
        (stop,) = page.find_elements("css selector", '#events [data-kind="stop"]')
        assert "stop pressed at robot 2" in stop.text
        page.execute_script("arguments[0].focus()", stop)
        stop.send_keys("\ue007")  # Enter: by keyboard, as by a click
        until(page, f"Math.abs(headland.state().t - {STOP_S}) < 1")
        scrub(page, SPLIT_S + 3)
        until(page, "!document.getElementById('split').hidden")
        page.find_element("css selector", '[data-slot="4"]').click()
        assert "A: 0 1 2" in page.find_element("id", "split-who").text
        until(page, "!document.getElementById('one').hidden")
        assert page.find_element("css selector", "#machine .now").text == "working"
        picture(page, "recording")
        scrub(page, STOP_S + 2)
        until(page, "document.querySelector('main').classList.contains('stopped')")
        assert "person in field" in page.find_element("id", "stopped-why").text
        assert "all 6 robots stand" in page.find_element("id", "stopped-who").text
        picture(page, "stop")
        scrub(page, SPLIT_S - 2)
        until(page, "!document.querySelector('main').classList.contains('stopped')")
        assert page.execute_script("return document.getElementById('hand').hidden")
        page.execute_script(
            "[...document.querySelectorAll('#speeds button')].find(b => b.dataset.speed === '30').click()"
        )
        until(page, f"headland.state().speed === 30 && headland.state().t > {RESET_S}")
        until(page, "headland.field.workDone > 0.02")
        assert drawn_colours(page) > 8, "a field, sections and robots are more than that"
        assert complaints(page) == []


@pytest.mark.slow
@needs_browser
def test_a_launch_is_stopped_and_released_from_the_page(tmp_path: Path) -> None:
    fleet, operator = tmp_path / "fleet.json", tmp_path / "operator.json"
    key_file.write(fleet, operator, key_file.fresh(), key_file.DEVICE)
    words = ("--keys", str(fleet), "--operator-key", str(operator))
    with launched(tmp_path, *words) as live, browser() as page:
        page.get(live.url)
        until(page, robots_in("WORKING"), WAIT_S)
        until(page, "headland.state().robots.every(robot => robot.path && robot.near)")
        picture(page, "live")
        page.find_element("id", "stop").click()  # asks for nothing
        until(page, robots_in("EMERGENCY_STOP"))
        until(page, "document.getElementById('hand-says').textContent === 'all have confirmed'")
        until(page, "!document.getElementById('stopped').hidden")
        until(page, "!document.getElementById('reset').hidden")
        page.find_element("id", "reset").click()
        assert not page.find_element("id", "keyless-line").is_displayed()
        page.find_element("id", "also").click()
        picture(page, "release")
        page.find_element("id", "release-yes").click()
        until(page, robots_in("WORKING", "IDLE", "SYNCHRONIZING"))
        until(page, "!document.querySelector('main').classList.contains('stopped')")
        assert all(CONSOLE in line for line in complaints(page))
    out = tmp_path / "runs" / "launch"
    log_hash = json.loads((out / "report.json").read_text())["log_hash"]
    for name in (".", "run.mcap"):
        recording = recorded(out / name, None)
        assert recording.digest.hex == log_hash and recording.intents


# -------------------------------------------------------------------- hands


def parts(url: str) -> tuple[str, str]:
    """Address of the page, and its token."""
    address, token = url.split("#")
    return address, token


def bearer(token: str) -> dict[str, str]:
    return {"authorization": f"Bearer {token}"}


class Live(NamedTuple):
    """A launch with a map."""

    url: str
    process: "subprocess.Popen[str]"
    lines: "queue.Queue[str]"  # what it prints

    def says(self, words: str) -> str:
        """The next line with these words. Fails where there is none in time."""
        while words not in (line := self.lines.get(timeout=WAIT_S)):
            assert line, f"never said: {words}"
        return line

    def children(self, words: str) -> list[int]:
        """Processes of this launch that were started with these words, oldest first."""
        # The kernel's own list of children may leave some out while others start and end.
        found = []
        for process in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):  # it ended meanwhile
                parent = int((process / "stat").read_text().rsplit(")", 1)[1].split()[1])
                started_with = (process / "cmdline").read_text().replace("\0", " ")
                if parent == self.process.pid and words in started_with:
                    found.append(int(process.name))
        return sorted(found)


@contextlib.contextmanager
def launched(folder: Path, *words: str) -> Iterator[Live]:
    """A launch of three robots with a map. It must end without a traceback."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tools.cli.headland",
         "launch", "small", "--map", "--page-port", "0", *words],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    lines: queue.Queue[str] = queue.Queue()
    kept: list[str] = []

    def read() -> None:
        assert process.stdout is not None
        for line in process.stdout:
            kept.append(line)
            lines.put(line)
        lines.put("")

    reading = threading.Thread(target=read, daemon=True)
    reading.start()
    try:
        live = Live("", process, lines)
        yield live._replace(url=live.says("map: ").split()[1])
    finally:
        process.send_signal(signal.SIGCONT)
        process.send_signal(signal.SIGINT)
        process.wait(timeout=WAIT_S)
        reading.join(timeout=WAIT_S)
    assert "Traceback" not in "".join(kept), "".join(kept)


def robots_in(*states: str) -> str:
    """An expression: all three robots are there, heard, in one of these states."""
    return (
        "(() => { const r = headland.state()?.robots ?? []; return r.length === 3 && "
        f"r.every(each => !each.silent && {json.dumps(states)}.includes(each.state)); }})()"
    )


def scrub(page: "Chrome", seconds: float) -> None:
    page.execute_script(
        "const s = document.getElementById('scrub'); s.value = arguments[0];"
        "s.dispatchEvent(new Event('input')); s.dispatchEvent(new Event('change'));",
        seconds,
    )


def drawn_colours(page: "Chrome") -> int:
    """How many colours there are on the field's canvas, at every 16th pixel."""
    count: int = page.execute_script(
        "const c = document.getElementById('field'), pen = c.getContext('2d'), seen = new Set();"
        "const d = pen.getImageData(0, 0, c.width, c.height).data;"
        "for (let k = 0; k < d.length; k += 64) seen.add(d[k] << 16 | d[k + 1] << 8 | d[k + 2]);"
        "return seen.size;"
    )
    return count


def picture(page: "Chrome", name: str) -> None:
    PICTURES.mkdir(parents=True, exist_ok=True)
    assert page.save_screenshot(str(PICTURES / f"map-{name}.png"))
