"""The map's page where it once failed people: keys, old pictures, phones, and who may release a fleet.

One launch of three robots without keys serves most tests; each leaves it released and at work.
"""

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

pytest.importorskip("httpx", reason="the extra `operator` is not installed")

import httpx
from websockets.exceptions import ConnectionClosed
from websockets.frames import Close
from websockets.sync.client import connect

from agent.interface.lifecycle import State
from agent.runtime.files import key_file
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member, Pose, StandsBy, Standstill
from protocol.frames.frame import Frame
from sim.record.recording import Recording
from tests.tools.livemap.test_map import (
    ROOT,
    WAIT_S,
    Live,
    bearer,
    launched,
    needs_browser,
    parts,
    picture,
    robots_in,
)
from tools.bench.browser import browser, complaints, until
from tools.common.bus_attach import attach
from tools.inspect.inspector import Inspector
from tools.livemap.command import MapThread
from tools.livemap.page_updates import PageUpdates
from tools.livemap.playback import Index, Player
from tools.livemap.server import PAGES_MAX
from tools.operate.operator_device import Operator

if TYPE_CHECKING:
    from selenium.webdriver import Chrome

ROBOTS = 3
TABS_MAX = 60  # more than the page has places for the focus
PALE = "rgb(227, 231, 233)"  # pills of what is not known now
PHONE, ACROSS = (390, 844), (844, 390)
LOW = (320, 480), (640, 320)  # of old phones, with the bars of their browsers
HEADLAND = (sys.executable, "-m", "tools.cli.headland")
DEEP = "[" * 3000


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("launch")


@pytest.fixture(scope="module")
def fleet(folder: Path) -> Iterator[Live]:
    with launched(folder, "--no-keys") as live:
        yield live


# -------------------------------------------------------------------- keys


@pytest.mark.slow
@needs_browser
def test_b1_space_on_the_focused_stop_latches_every_robot(fleet: Live, folder: Path) -> None:
    with browser() as page:
        page.get(fleet.url)
        until(page, robots_in("WORKING", "IDLE"), WAIT_S)
        tab_to(page, "stop")
        press(page, "SPACE")
        assert on_the_bus(folder, all_latched)
        until(page, "document.getElementById('hand-says').textContent === 'all have confirmed'")
        assert page.execute_script("return headland.state().playing"), "the picture goes on"
        # Release and start by keyboard alone.
        until(page, "!document.getElementById('reset').hidden")
        tab_to(page, "reset")
        press(page, "SPACE")
        until(page, "document.activeElement.id === 'keyless'")
        press(page, "SPACE")
        assert page.find_element("id", "keyless").is_selected()
        tab_to(page, "also")
        press(page, "SPACE")
        tab_to(page, "release-yes")
        press(page, "ENTER")
        assert on_the_bus(folder, all_at_work)


@needs_browser
def test_b1_space_acts_on_what_has_the_focus_and_escape_stops(fleet: Live, folder: Path) -> None:
    with browser() as page:
        page.get(fleet.url)
        until(page, robots_in("WORKING", "IDLE"), WAIT_S)
        orca = page.find_element("css selector", "[data-layer=orca]")
        page.execute_script("arguments[0].focus()", orca)
        press(page, "SPACE")
        assert orca.is_selected() and page.execute_script("return headland.field.layers.orca")
        assert page.execute_script("return headland.state().follow"), "and nothing else"
        page.execute_script("document.activeElement.blur()")
        press(page, "SPACE")  # on the bare page
        until(page, "!headland.state().playing")
        until(page, "!document.getElementById('paused').hidden")
        picture(page, "paused")
        page.find_element("id", "resume").click()
        until(page, "headland.state().follow")
        until(page, "document.getElementById('paused').hidden")
        row = "#fleet [data-slot='1'] button"  # the table by keyboard
        until(page, f'document.querySelector("{row}") !== null')  # it is drawn with the next state
        page.execute_script(f'document.querySelector("{row}").focus()')
        press(page, "ENTER")
        until(page, "document.getElementById('one-name').textContent === 'robot 1'")
        page.find_element("id", "help-open").click()
        picture(page, "help")
        press(page, "ESCAPE")
        assert on_the_bus(folder, all_latched)
    freed(fleet, folder)


# -------------------------------------------------------------------- start


@pytest.mark.slow
@needs_browser
def test_b5_a_fleet_released_without_a_start_is_started_from_the_page(
    fleet: Live, folder: Path
) -> None:
    address, token = parts(fleet.url)
    httpx.post(address + "stop", headers=bearer(token), timeout=WAIT_S)
    wish = {"keyless": True, "start": False}
    freed_only = httpx.post(address + "reset", headers=bearer(token), json=wish, timeout=WAIT_S)
    assert freed_only.json()["late"] == [] and not freed_only.json()["started"]
    with browser() as page:
        page.get(fleet.url)
        until(page, robots_in("IDLE"), WAIT_S)
        until(page, "!document.getElementById('start').hidden", WAIT_S)
        why = "[...document.querySelectorAll('#fleet .why')].map(each => each.textContent)"
        until(page, f"{why}.every(each => /start/.test(each))")
        picture(page, "not-started")
        page.find_element("id", "start").click()
        page.find_element("id", "release-yes").click()  # without a word about keys
        until(page, "document.getElementById('release-says').textContent.includes('no keys')")
        page.find_element("id", "keyless").click()
        page.find_element("id", "release-yes").click()
        assert on_the_bus(folder, all_at_work)
        until(page, "document.getElementById('start').hidden")


# -------------------------------------------------------------------- old pictures


@pytest.mark.slow
@needs_browser
def test_b4_an_old_picture_says_so(tmp_path: Path) -> None:
    with launched(tmp_path) as live, browser() as page:
        map_pid = live.children(" map ")[0]
        page.get(live.url)
        until(page, robots_in("WORKING", "IDLE"), WAIT_S)
        assert not shows(page, "old")
        os.kill(map_pid, signal.SIGSTOP)
        is_old(page, "server does not answer")
        picture(page, "old")
        os.kill(map_pid, signal.SIGCONT)
        until(page, "document.getElementById('old').hidden")
        live.process.send_signal(signal.SIGSTOP)  # the wire and the world
        is_old(page, "Nothing is heard on the bus")
        live.process.send_signal(signal.SIGCONT)
        until(page, "document.getElementById('old').hidden", WAIT_S)
        os.kill(map_pid, signal.SIGKILL)
        is_old(page, "server does not answer")
        live.says("the map has ended")
        page.find_element("id", "stop").click()
        until(
            page, "document.getElementById('hand-says').textContent.includes('stop on a machine')"
        )


@pytest.mark.slow
@needs_browser
def test_a_robot_that_fell_silent_has_no_speed(tmp_path: Path) -> None:
    with launched(tmp_path) as live, browser() as page:
        page.get(live.url)
        until(page, robots_in("WORKING"), WAIT_S)
        os.kill(live.children("tools.run.robot")[1], signal.SIGKILL)
        row = "document.querySelector('#fleet [data-slot=\"1\"]')"
        until(page, f"{row}?.cells[3].textContent === '–'", WAIT_S)
        assert page.execute_script(f"return {row}.querySelector('.pill').textContent") == "silent"
        page.execute_script(f"{row}.click()")
        until(page, "document.getElementById('one-name').textContent.includes('as last heard')")
        assert not page.execute_script("return document.querySelector('#machine .now')")
        assert live.says("robot 1 has ended")


@needs_browser
def test_one_robot_is_not_shown_as_of_now_when_the_server_hangs_nor_before_it_was_there() -> None:
    recording, answers = Recording(), threading.Event()
    for second in range(60):
        for slot in (0,) if second < 30 else (0, 1):
            recording.write(second * 1_000_000, encode(Member(slot, 1, 0), 0x80 + slot))
            pose = Pose(5.0, 5.0, 0.0, 1.2, State.WORKING, False, 255)
            recording.write(second * 1_000_000, encode(pose, 0x80 + slot))
    shown = MapThread(recording, "the test", 0)
    answers.set()
    work = shown.server.index.work

    def hung(budget_s: float) -> None:
        answers.wait()
        work(budget_s)

    shown.server.index.work = hung  # type: ignore[method-assign]
    name = "document.getElementById('one-name').textContent"
    with browser() as page:
        page.get(shown.url)
        until(page, "document.querySelector('#fleet [data-slot=\"1\"]')", WAIT_S)
        page.execute_script("document.querySelector('#fleet [data-slot=\"1\"]').click()")
        until(page, f"{name} === 'robot 1' && document.querySelector('#machine .now')")
        answers.clear()
        until(page, f"{name} === 'robot 1, as last heard'")
        assert not page.execute_script("return document.querySelector('#machine .now')")
        answers.set()
        until(page, f"{name} === 'robot 1'")
        page.execute_script(
            "const scrub = document.getElementById('scrub'); scrub.value = scrub.min;"
            "scrub.dispatchEvent(new Event('input')); scrub.dispatchEvent(new Event('change'));"
        )
        until(page, "headland.state().robots.length === 1")
        until(page, "document.getElementById('one').hidden")


@needs_browser
def test_a_robot_that_is_not_heard_is_not_said_to_stand_in_a_stop() -> None:
    recording = Recording()
    # From where it is sought the page plays on, so a slow one sees it only if the fleet stands for long.
    for tenth in range(1000):
        for slot in (0, 1, 2) if tenth < 900 else (0, 1):
            recording.write(tenth * 100_000, encode(Member(slot, 1, 0), 0x80 + slot))
            beat = Pose(5.0, 5.0, 0.0, 0.0, State.EMERGENCY_STOP, True, 255)
            recording.write(tenth * 100_000, encode(beat, 0x80 + slot))
    recording.close()
    shown = MapThread(recording, "the test", 0)
    who = "document.getElementById('stopped-who').textContent"
    with browser() as page:
        page.get(shown.url)
        until(page, f"{who} === 'NOT HEARD: 2'", WAIT_S)
        seek = "const s = document.getElementById('scrub'); s.value = 4;"
        page.execute_script(f"{seek} s.dispatchEvent(new Event('input'))")
        until(page, f"{who} === 'all 3 robots stand'", WAIT_S)


class Hand:
    """A panel that stops and releases nothing, and waits with its answers."""

    signed, releases = False, True

    def __init__(self) -> None:
        self.told: list[tuple[bool, bool]] = []  # reset and start, of each release
        self.answers = threading.Event()

    async def stop(self) -> dict[str, Any]:
        return {"stopped": [0], "late": [], "unnamed": [], "heard": True, "signed": False}

    async def release(self, keyless: bool, reset: bool, start: bool) -> dict[str, Any]:
        self.told.append((reset, start))
        await asyncio.to_thread(self.answers.wait, WAIT_S)
        told = {"cleared": [], "late": [], "silent": [], "heard": True, "signed": False}
        return {**told, "released": True, "started": start}


def with_hand() -> tuple[MapThread, Hand]:
    """A map of a live bus on which one robot stands stopped, and another one waits for a start."""
    recording, hand = Recording(), Hand()
    recording.follow(lambda: 1_000_000)
    for slot, state in enumerate((State.EMERGENCY_STOP, State.IDLE)):
        stopped = state is State.EMERGENCY_STOP
        beats = (
            Member(slot, 1, 0), Pose(5.0, 5.0 * slot, 0.0, 0.0, state, stopped, 255),
            Heartbeat(1, state, stopped, True, False, False, 1.0, 0, 0),
        )  # fmt: skip
        for beat in beats:
            recording.write(1_000_000, encode(beat, 0x80 + slot))
    shown = MapThread(recording, "the test", 0)
    shown.server.panel = hand  # type: ignore[assignment]
    return shown, hand


@needs_browser
def test_a_press_says_that_a_server_that_hangs_does_not_answer() -> None:
    """The page said "stopping" for as long as the server hung."""
    shown, _ = with_hand()
    answers, work = threading.Event(), shown.server.index.work
    answers.set()

    def hung(budget_s: float) -> None:
        answers.wait()
        work(budget_s)

    shown.server.index.work = hung  # type: ignore[method-assign]
    says = "document.getElementById('hand-says').textContent"
    with browser() as page:
        page.get(shown.url)
        until(page, "document.getElementById('stop').checkVisibility()", WAIT_S)
        answers.clear()
        page.find_element("id", "stop").click()
        until(page, f"{says}.includes('does not answer: use a stop on a machine')")
        answers.set()
        until(page, f"{says} === 'all have confirmed'")


@needs_browser
def test_a_release_does_not_start_because_the_one_before_did() -> None:
    shown, hand = with_hand()
    hand.answers.set()
    says = "document.getElementById('hand-says').textContent"
    with browser() as page:
        page.get(shown.url)
        until(page, "document.getElementById('reset').checkVisibility()", WAIT_S)
        for ticks, outcome in ((True, "released and started"), (False, "released, not started")):
            page.find_element("id", "reset").click()
            if ticks:
                page.find_element("id", "also").click()
            page.find_element("id", "release-yes").click()
            until(page, f"{says} === '{outcome}'")
    assert hand.told == [(True, True), (True, False)]


@needs_browser
def test_a_late_answer_to_a_release_is_none_to_a_start() -> None:
    """It closed the form of the start, and said that robots were started."""
    shown, hand = with_hand()
    says = "document.getElementById('hand-says').textContent"
    with browser() as page:
        page.get(shown.url)
        until(page, "document.getElementById('start').checkVisibility()", WAIT_S)
        page.find_element("id", "reset").click()
        page.find_element("id", "release-yes").click()
        page.find_element("id", "release-no").click()
        page.find_element("id", "start").click()
        hand.answers.set()
        until(page, f"{says} === 'released, not started'")
        assert page.execute_script("return document.getElementById('release').open")
    assert hand.told == [(True, False)]


# -------------------------------------------------------------------- places


@pytest.mark.slow
@needs_browser
def test_b8_nothing_moves_the_stop_and_it_covers_nothing(fleet: Live, folder: Path) -> None:
    with browser() as page:
        page.get(fleet.url)
        until(page, robots_in("WORKING", "IDLE"), WAIT_S)
        place = "JSON.stringify(document.getElementById('stop').getBoundingClientRect())"
        before = page.execute_script(f"return {place}")
        assert covered(page) == []
        says = "document.getElementById('hand-says').textContent"
        page.execute_script(
            f"{says} = 'the map does not answer: use a stop on a machine '.repeat(9)"
        )
        assert page.execute_script(f"return {place}") == before
        page.find_element("id", "stop").click()
        until(page, f"{says} === 'all have confirmed'")
        until(page, "document.querySelector('main').classList.contains('stopped')")
        until(page, "!document.getElementById('reset').hidden")
        picture(page, "stopped")
        assert page.execute_script(f"return {place}") == before
        until(page, "!headland.field.stale")
        assert covered(page) == []
    freed(fleet, folder)


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize("size", [PHONE, ACROSS], ids=["upright", "across"])
def test_b7_a_phone_shows_all_of_it(fleet: Live, folder: Path, size: tuple[int, int]) -> None:
    width, height = size
    with browser() as page:
        page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
            "width": width, "height": height, "deviceScaleFactor": 2, "mobile": True,
        })  # fmt: skip
        page.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
        page.get(fleet.url)
        until(page, robots_in("WORKING", "IDLE"), WAIT_S)
        assert page.execute_script("return [innerWidth, document.documentElement.scrollWidth]") == [
            width, width,
        ]  # fmt: skip
        slider = page.find_element("id", "scrub").rect
        assert slider["width"] >= 120 and 0 <= slider["x"] <= width - slider["width"]
        assert hidden_buttons(page) == [] and covered(page) == []
        if size == PHONE:
            page.find_element("id", "sheet").click()
        until(page, "document.getElementById('fleet').getBoundingClientRect().width > 150")
        until(page, "document.querySelector(\"#fleet [data-slot='2']\")?.checkVisibility()")
        assert "stop" not in hidden_buttons(page), "STOP is never under the sheet"
        picture(page, f"phone-{width}-sheet")
        if size == PHONE:
            page.find_element("id", "sheet").click()
        scale = page.execute_script("return headland.field.view.scale")
        pinch(page, 40, 160)
        until(page, f"headland.field.view.scale > {2 * scale}")
        page.find_element("id", "fit").click()
        page.find_element("id", "nearer").click()
        until(page, f"headland.field.view.scale > {1.2 * scale}")
        page.find_element("id", "fit").click()
        page.find_element("id", "stop").click()
        until(page, "document.getElementById('hand-says').textContent === 'all have confirmed'")
        until(page, "!document.getElementById('reset').hidden")
        until(page, "!headland.field.stale")
        assert hidden_buttons(page) == [] and covered(page) == []
        picture(page, f"phone-{width}")
    freed(fleet, folder)


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize("size", LOW, ids=["upright", "across"])
def test_a_low_window_full_of_banners_keeps_its_stop_and_its_pictures(
    fleet: Live, folder: Path, size: tuple[int, int]
) -> None:
    """An upright one got the columns of a phone held across: its map had no size, each picture failed
    before what is written beside it, the server sent no more, and STOP was cut off."""
    with browser() as page:
        page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
            "width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": True,
        })  # fmt: skip
        page.get(fleet.url)
        until(page, robots_in("WORKING", "IDLE"), WAIT_S)
        assert "stop" not in hidden_buttons(page)
        page.find_element("id", "stop").click()
        until(page, "!document.getElementById('stopped').hidden")
        until(page, "!document.getElementById('reset').hidden")
        assert "stop" not in hidden_buttons(page)
        words = "document.getElementById('keyless-fleet').lastChild.textContent"
        page.execute_script(f"{words} = 'as many words as several banners have '.repeat(40)")
        until(page, "document.getElementById('alerts').scrollHeight > innerHeight")
        picture(page, f"low-{size[0]}")
        assert "stop" not in hidden_buttons(page) and "reset" not in hidden_buttons(page)
        pictures = page.execute_script("return headland.pictures")
        until(page, f"headland.pictures > {pictures + 5}")
        assert complaints(page) == []
    freed(fleet, folder)


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize("light", ["dark", "light"])
def test_text_is_told_from_its_ground_and_controls_have_names(fleet: Live, light: str) -> None:
    with browser() as page:
        wanted = [{"name": "prefers-color-scheme", "value": light}]
        page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": wanted})
        page.get(fleet.url)
        until(page, robots_in("WORKING", "IDLE"), WAIT_S)
        until(page, "document.querySelector('#fleet [data-slot=\"0\"]')")
        page.execute_script("document.querySelector('#fleet [data-slot=\"0\"]').click()")
        until(page, "!document.getElementById('one').hidden")
        found = axe(page)
        page.find_element("id", "help-open").click()
        picture(page, f"{light}-room")
        assert page.execute_script(FAINT) == []
        assert page.execute_script(NAMELESS) == []
        # This axe-core is older than dialogs: what is in one is outside all regions to it.
        found += [line for line in axe(page) if not line.startswith("region:")]
        assert not found, "\n".join(found)
        value = page.find_element("id", "scrub").get_attribute("aria-valuetext")
        assert value is not None and " of " in value and ":" in value
        boxes = page.find_elements("css selector", "#layers input")
        assert min(box.rect["width"] for box in boxes if box.is_displayed()) >= 20
        assert complaints(page) == []


def axe(page: "Chrome") -> list[str]:
    """What axe-core, which others wrote, finds wrong with the page as it stands."""
    pytest.importorskip("axe_selenium_python", reason="axe-core is not installed")
    from axe_selenium_python import Axe

    checker = Axe(page)
    checker.inject()
    return [f"{v['id']}: {v['nodes'][0]['html']:.120}" for v in checker.run()["violations"]]


# -------------------------------------------------------------------- who may


def test_l1_nobody_releases_a_fleet_without_the_printed_token(fleet: Live, folder: Path) -> None:
    address, token = parts(fleet.url)
    own = {"origin": address.rstrip("/")}
    wish = {"keyless": True, "start": True, "key": str(folder / "operator.json")}
    for path in ("reset", "start"):
        for headers in ({}, own, {**own, **bearer("x" * len(token))}, {**own, **bearer("x")}):
            answer = httpx.post(address + path, headers=headers, json=wish)
            assert answer.status_code == 403, (path, headers)
            assert "operator" not in answer.text, "not which files there are"
    assert httpx.post(address + "stop", json={}).status_code == 403, "no Origin and no token"
    elsewhere = bearer(token) | {"origin": "http://elsewhere"}
    assert httpx.post(address + "reset", headers=elsewhere, json=wish).status_code == 403
    for host in ("127.0.0.1:8791.evil", "127.0.0.1:x", "127.0.0.1:8791:1", "localhost.evil", ""):
        assert httpx.get(address, headers={"host": host}).status_code in (400, 403), host
    assert closes(address, ["headland"]) == 4401
    assert closes(address, ["headland", "x" * len(token)]) == 4401
    with connect(address.replace("http", "ws") + "ws", subprotocols=["headland", token]) as told:  # type: ignore[list-item]
        assert json.loads(told.recv())["kind"] == "scene"


@pytest.mark.slow
def test_l1_a_keyed_fleet_is_released_by_the_key_that_the_map_was_started_with(
    tmp_path: Path,
) -> None:
    keys, operator = tmp_path / "fleet.json", tmp_path / "operator.json"
    key_file.write(keys, operator, key_file.fresh(), key_file.DEVICE)
    with launched(tmp_path, "--keys", str(keys)) as live:  # its map holds no operator's key
        address, token = parts(live.url)
        assert on_the_bus(tmp_path, all_at_work)
        httpx.post(address + "stop", headers=bearer(token), timeout=WAIT_S)
        assert on_the_bus(tmp_path, all_latched)
        wish = {"key": str(operator), "keyless": False, "start": True}
        answer = httpx.post(address + "reset", headers=bearer(token), json=wish, timeout=WAIT_S)
        assert answer.status_code == 400 and "--operator-key" in answer.json()["problem"]
        lied = httpx.post(
            address + "reset", headers=bearer(token), json={**wish, "keyless": True}, timeout=WAIT_S
        )
        assert lied.json()["late"] == [0, 1, 2] and not lied.json()["signed"]
        assert on_the_bus(tmp_path, all_latched)
        with own_map(tmp_path, "--operator-key", str(operator)) as url:
            address, token = parts(url)
            wish = {"keyless": False, "start": True}
            answer = httpx.post(address + "reset", headers=bearer(token), json=wish, timeout=WAIT_S)
            assert answer.json()["late"] == [] and answer.json()["signed"]
        assert on_the_bus(tmp_path, all_at_work)


@pytest.mark.slow
def test_l1_a_wrong_operator_key_is_said_when_the_map_starts(tmp_path: Path) -> None:
    keys, operator = tmp_path / "fleet.json", tmp_path / "operator.json"
    key_file.write(keys, operator, key_file.fresh(), key_file.DEVICE)
    for path, words in ((keys, "is needed"), (tmp_path / "none.json", "cannot be read")):
        done = subprocess.run(
            [*HEADLAND, "launch", "small", "--map", "--operator-key", str(path)],
            cwd=tmp_path, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)},
            timeout=WAIT_S, check=False,
        )  # fmt: skip
        assert done.returncode == 2 and words in done.stderr and done.stderr.count("\n") == 1


NO_REQUESTS = {
    "deep list": DEEP, "deep map": '{"a":' * 3000, "nothing": "", "list": "[]", "number": "7",
    "null": "null", "no bool": '{"keyless": 1}', "bytes": "\xff",
    "home": '{"key": "~nouser/x", "keyless": false, "start": true}',
}  # fmt: skip


@pytest.mark.parametrize("body", NO_REQUESTS.values(), ids=NO_REQUESTS)
def test_l7_what_is_no_request_is_one_line(fleet: Live, body: str) -> None:
    address, token = parts(fleet.url)
    for path in ("reset", "start"):
        sent = body.encode("latin-1")
        answer = httpx.post(address + path, headers=bearer(token), content=sent, timeout=WAIT_S)
        assert answer.status_code == 400 and "\n" not in answer.json()["problem"], answer.text


def test_l7_what_is_too_long_is_not_read(fleet: Live) -> None:
    address, token = parts(fleet.url)

    def endless() -> Iterator[bytes]:
        for _ in range(64):
            yield b" " * 65536

    host = address.removeprefix("http://").rstrip("/")
    with socket.create_connection(("127.0.0.1", int(host.split(":")[1])), WAIT_S) as raw:
        announced = f"POST /reset HTTP/1.1\r\nHost: {host}\r\nAuthorization: Bearer {token}\r\n"
        raw.sendall(announced.encode() + b"Content-Length: 700000000\r\n\r\n")
        assert raw.recv(100).startswith(b"HTTP/1.1 413")
    try:
        answer = httpx.post(address + "reset", headers=bearer(token), content=endless())
        assert answer.status_code == 413
    except httpx.TransportError:
        pass  # it was closed before all was sent
    with connect(address.replace("http", "ws") + "ws", subprotocols=["headland", token]) as told:  # type: ignore[list-item]
        for text in (DEEP, '{"do": ' + DEEP, "\0"):
            told.send(text)
        told.send(b"\0\1")
        told.recv()
        told.send(" " * 100_000)
        with pytest.raises(ConnectionClosed) as closed:
            while True:
                told.recv(timeout=WAIT_S)
        assert closed.value.rcvd is not None and closed.value.rcvd.code == 1009


def test_the_frames_of_a_robot_that_left_are_no_fault() -> None:
    """At the end of a launch the map was a traceback."""

    async def hear() -> list[int]:
        bus = attach("virtual", "left", 250_000, "", 0)
        try:
            operator = Operator(bus, None)
            for message in (member, pose, beat._replace(leaving=True), pose, beat, member, pose):
                operator.hear(1.0, encode(message, 0x80))
            return list(operator.robots)
        finally:
            bus.close()

    beat = Heartbeat(0, 1, False, False, True, False, 1.0, 0, 0)
    pose = Pose(0.0, 0.0, 0.0, 0.0, 1, False, 255)
    member = Member(0, 1, 0, 0)
    assert asyncio.run(hear()) == [0]


def test_why_a_robot_stands_is_told_from_the_bus() -> None:
    recording = Recording()
    for message in (Member(0, 1, 0), Heartbeat(0, 1, False, True, False, False, 1.0, 0, 0),
                    Standstill(0, StandsBy.NOT_STARTED, 0, 1)):  # fmt: skip
        recording.write(1_000_000, encode(message, 0x80))
    player = Player(Index(recording), True, 1.0)
    player.advance(0.0, 1.0)
    (robot,) = PageUpdates(player).tell()["robots"]
    assert "start" in robot["stands"][0]


def test_a_quiet_bus_is_told_with_its_age() -> None:
    now_us = 5_000_000
    recording = Recording()
    recording.follow(lambda: now_us)
    assert recording.quiet_for_us == 0
    recording.write(now_us, Frame(0x18FF1080, b"12345678"))
    now_us = 12_000_000
    assert recording.quiet_for_us == 7_000_000 and recording.end_at_us == now_us
    recording.close()
    assert recording.quiet_for_us == 0 and recording.end_at_us == 5_000_000


@pytest.mark.slow
def test_each_address_has_a_token_of_its_own() -> None:
    urls = {MapThread(Recording(), "", 0).url for _ in range(3)}
    assert len({parts(url)[1] for url in urls}) == 3 and all(len(parts(u)[1]) >= 22 for u in urls)


# -------------------------------------------------------------------- hands

FAINT = Path(__file__).with_name("faint.js").read_text()
# Controls and meters that a screen reader could not name.
NAMELESS = """
const named = (each) => each.textContent.trim() || each.labels?.length
  || ["aria-label", "aria-labelledby"].some((name) => each.getAttribute(name));
return [...document.querySelectorAll("button, input, [role=progressbar], canvas[tabindex]")]
  .filter((each) => each.checkVisibility() && !named(each)).map((each) => each.id);
"""


def press(page: "Chrome", key: str) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    ActionChains(page).send_keys(getattr(Keys, key)).perform()


def tab_to(page: "Chrome", identifier: str) -> None:
    for _ in range(TABS_MAX):
        if page.execute_script("return document.activeElement.id") == identifier:
            return
        press(page, "TAB")
    raise AssertionError(f"no way to {identifier} by Tab")


def pinch(page: "Chrome", near: int, far: int) -> None:
    """Two fingers on the middle of the map, from so many pixels apart to so many."""
    box = page.find_element("id", "field").rect
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def fingers(kind: str, apart: float) -> None:
        points = [{"x": x - apart / 2, "y": y, "id": 1}, {"x": x + apart / 2, "y": y, "id": 2}]
        page.execute_cdp_cmd(
            "Input.dispatchTouchEvent",
            {"type": kind, "touchPoints": [] if kind == "touchEnd" else points},
        )

    fingers("touchStart", near)
    for step in range(1, 9):
        fingers("touchMove", near + (far - near) * step / 8)
    fingers("touchEnd", far)


def shows(page: "Chrome", identifier: str) -> bool:
    return bool(page.find_element("id", identifier).is_displayed())


def is_old(page: "Chrome", why: str) -> None:
    """A banner as wide as the page, and nothing that looks like now."""
    until(page, "!document.getElementById('old').hidden", WAIT_S)
    until(page, f"document.getElementById('old-why').textContent.includes({json.dumps(why)})")
    until(page, "/PICTURE IS [0-9]+ s OLD/.test(document.getElementById('old-age').textContent)")
    width = "document.getElementById('old').getBoundingClientRect().width"
    assert page.execute_script(f"return {width} === innerWidth")
    until(
        page, "[...document.querySelectorAll('#fleet td.number')].every(n => n.textContent === '–')"
    )
    until(page, "document.getElementById('load').textContent === '–'")
    grey = "getComputedStyle(document.getElementById('field')).filter"
    assert "grayscale(1)" in page.execute_script(f"return {grey}")
    pills = "[...document.querySelectorAll('#states .pill')]"
    colours = f"{pills}.map(pill => getComputedStyle(pill).backgroundColor)"
    assert set(page.execute_script(f"return {colours}")) == {PALE}


def covered(page: "Chrome") -> list[Any]:
    """Points of the field's outline that are not to be seen on the map."""
    found: list[Any] = page.execute_script(
        "const f = headland.field, box = document.getElementById('field').getBoundingClientRect();"
        "return f.scene.rings[0].map(p => f.toScreen(...p)).filter(([x, y]) =>"
        " document.elementFromPoint(box.x + x, box.y + y)?.id !== 'field');"
    )
    return found


def test_a_page_beyond_the_limit_is_told_why() -> None:
    """It was refused before the handshake, which a browser cannot tell from a server that is gone."""
    address, token = parts(MapThread(Recording(), "the test", 0).url)
    where, words = address.replace("http", "ws") + "ws", ["headland", token]
    with ExitStack() as pages:
        for _ in range(PAGES_MAX):
            page = pages.enter_context(connect(where, subprotocols=words))  # type: ignore[arg-type]
            page.recv(timeout=WAIT_S)
        refused = closed(address, words)
        assert (refused.code, refused.reason) == (1013, "16 other pages of this map are open")
        assert closes(address, ["headland", "another"]) == 4401, (
            "a program without the token learns no more"
        )
    assert eventually(lambda: looks(where, words))


def looks(where: str, words: list[str]) -> bool:
    """Whether a page gets its picture."""
    with connect(where, subprotocols=words) as page, suppress(ConnectionClosed):  # type: ignore[arg-type]
        page.recv(timeout=WAIT_S)
        return True
    return False


def eventually(condition: Callable[[], bool]) -> bool:
    """The server notices a page that has gone when it next reads its socket."""
    return any(condition() for _ in range(100))


@needs_browser
def test_a_page_beyond_the_limit_says_so_and_goes_on_when_another_is_closed() -> None:
    shown = MapThread(Recording(), "the test", 0)
    shown.server.pages = PAGES_MAX
    with browser() as page:
        page.get(shown.url)
        why = "document.getElementById('old-why').textContent"
        until(page, f"{why} === '16 other pages of this map are open: close one of them. "
              "STOP works all the same.'", WAIT_S)  # fmt: skip
        assert page.find_element("id", "stop").is_displayed()
        shown.server.pages = 0
        until(page, "document.getElementById('link').textContent === 'connected'", WAIT_S)
        until(page, "document.getElementById('old').hidden", WAIT_S)


def hidden_buttons(page: "Chrome") -> list[str]:
    """Buttons that are shown, and that a finger on their middle would not press."""
    found: list[str] = page.execute_script(
        "return [...document.querySelectorAll('button, #scrub')].filter(each => each.checkVisibility()"
        " && !each.closest('aside')).filter(each => { const b = each.getBoundingClientRect();"
        " return document.elementFromPoint(b.x + b.width / 2, b.y + b.height / 2) !== each; })"
        ".map(each => each.id || each.textContent);"
    )
    return found


def closes(address: str, protocols: list[str]) -> int:
    """With which code the socket is closed."""
    return closed(address, protocols).code


def closed(address: str, protocols: list[str]) -> Close:
    """How the server closes the socket."""
    with connect(address.replace("http", "ws") + "ws", subprotocols=protocols) as told:  # type: ignore[arg-type]
        with pytest.raises(ConnectionClosed) as ended:
            told.recv(timeout=WAIT_S)
        assert ended.value.rcvd is not None
        return ended.value.rcvd


class own_map:
    """`headland map` of the launch in that folder, as a process of its own; its address."""

    def __init__(self, folder: Path, *words: str) -> None:
        self.process = subprocess.Popen(
            [*HEADLAND, "map", "runs/launch", "--page-port", "0", *words],
            cwd=folder, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)},
        )  # fmt: skip

    def __enter__(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().split()[1]

    def __exit__(self, *_: object) -> None:
        self.process.send_signal(signal.SIGINT)
        self.process.communicate(timeout=WAIT_S)


def all_latched(heard: Inspector) -> bool:
    robots = list(heard.robots.values())
    return len(robots) == ROBOTS and all(
        each.stopped and each.state == "EMERGENCY_STOP" for each in robots
    )


def all_at_work(heard: Inspector) -> bool:
    robots = list(heard.robots.values())
    return len(robots) == ROBOTS and all(
        each.started and not each.stopped and each.state in ("WORKING", "IDLE", "SYNCHRONIZING")
        and each.frames["Heartbeat"] > 1 for each in robots
    )  # fmt: skip


def on_the_bus(folder: Path, condition: Callable[[Inspector], bool]) -> bool:
    """True once it is so by frames alone; the page has no say."""
    return asyncio.run(_on_the_bus(folder, condition))


async def _on_the_bus(folder: Path, condition: Callable[[Inspector], bool]) -> bool:
    where = json.loads((folder / "runs" / "launch" / "bus.json").read_text())
    bus = attach("socketcand", where["channel"], 250_000, where["host"], where["port"])
    loop, heard, done = asyncio.get_running_loop(), Inspector(), asyncio.Event()
    operator = Operator(bus, None)

    def hear(frame: Frame) -> None:
        heard.hear(loop.time(), frame)
        operator.hear(loop.time(), frame)
        if condition(heard):
            done.set()

    bus.subscribe(hear)
    try:
        operator.ask_who()
        await asyncio.wait_for(done.wait(), WAIT_S)
    except TimeoutError:
        return False
    finally:
        bus.close()
    return True


def freed(live: Live, folder: Path) -> None:
    """Released and at work, for the next test."""
    address, token = parts(live.url)
    wish = {"keyless": True, "start": True}
    answer = httpx.post(address + "reset", headers=bearer(token), json=wish, timeout=WAIT_S)
    assert answer.json()["late"] == []
    assert on_the_bus(folder, all_at_work)
