"""What the map says of work: why a section is whose, parcels and batteries; and a whole operator's
round, once by keyboard alone and once by touch on a phone, in a real browser."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("httpx", reason="the extra `operator` is not installed")

from agent.delivery.task_registry import WITHDRAWN
from crdt.claim_register import Phase
from protocol.frames.codec import encode
from protocol.frames.delivery_frames import NO_TASK, Itinerary, TaskOrder
from protocol.frames.fleet_frames import (
    NOWHERE_M,
    PLACE_UNKNOWN_M_S,
    Heartbeat,
    Member,
    Pose,
)
from protocol.frames.safety_frames import EmergencyReset, EmergencyStop
from protocol.frames.work_frames import TaskClaim, WorkProgress
from sim.record.recording import Recording
from tests.tools.livemap.test_map import WAIT_S, Live, launched, needs_browser, robots_in
from tests.tools.livemap.test_map_page import (
    all_at_work,
    all_latched,
    axe,
    hidden_buttons,
    on_the_bus,
    pinch,
    press,
    shows,
    tab_to,
)
from tools.bench.browser import browser, complaints, until
from tools.livemap.command import MapThread
from tools.livemap.page_updates import PageUpdates
from tools.livemap.playback import Index, Player

if TYPE_CHECKING:
    from selenium.webdriver import Chrome

PHONE = (390, 844)
HOUSE = {  # ten by six cells inside of walls, a charger, one order that was known before
    "name": "house", "kind": "warehouse", "robots": 2, "radius_m": 0.3, "rings": [], "sections": [],
    "width_m": 0.0, "gate": None, "cells": None, "goals": [], "front": False, "bays": [[0.5, 0.5]],
    "grid": {"origin": [-1.0, -1.0], "cell_m": 1.0, "rows": 8, "columns": 12, "walls": "A" * 16},
    "transports": [[0, 12, 17]],
}  # fmt: skip
STRIP = {
    "name": "strip", "kind": "field", "robots": 2, "radius_m": 0.8, "width_m": 4.0, "gate": [0.0, 0.0],
    "rings": [[[0, 0], [100, 0], [100, 40], [0, 40]]], "grid": None, "cells": None, "goals": [],
    "sections": [{"id": 7, "swaths": [[[10, 20], [90, 20]]], "units": [8]}], "front": True,
    "earth": [51.0, 0.0],
}  # fmt: skip
CLICK = """const field = headland.field, canvas = document.getElementById('field');
const [x, y] = field.toScreen(85, 20.5), box = canvas.getBoundingClientRect();
const at = { pointerId: 1, clientX: x + box.x, clientY: y + box.y, bubbles: true };
for (const kind of ['pointermove', 'pointerdown', 'pointerup'])
  canvas.dispatchEvent(new PointerEvent(kind, at));"""
MIDDLE = "headland.field.view.x.toFixed(1) === headland.state().robots[0].x.toFixed(1)"


def delivering(*later: TaskOrder) -> Recording:
    """Robot 0 delivers parcel 0 and has parcel 5 aboard, which was ordered on the bus. `later`: orders
    that a tool says then."""
    made = Recording(dict(HOUSE))
    made.write(0, encode(Member(0, 1, 0), 0x80))
    made.write(1_000, encode(Pose(3.5, 2.5, 0.0, 0.0, 1, False, 255), 0x80))
    made.write(2_000, encode(TaskClaim(0, 1, Phase.DONE, 9, 1, 0), 0x80))
    made.write(3_000, encode(TaskOrder(5, 3, 44), 0xF9))
    made.write(4_000, encode(TaskClaim(5, 1, Phase.STARTED, 9, 2, 0), 0x80))
    made.write(5_000, encode(WorkProgress(5, 0, 1), 0x80))
    made.write(6_000, encode(Itinerary(1, 0, 1, 128, 5, NO_TASK), 0x80))
    made.write(900_000, encode(Heartbeat(0, 1, False, False, True, False, 1.0, 0, 0), 0x80))
    for order in later:
        made.write(910_000, encode(order, 0xF9))
    made.close()
    return made


def working() -> Recording:
    made = Recording(dict(STRIP))
    made.write(0, encode(Member(0, 1, 0), 0x80))
    made.write(1_000, encode(TaskClaim(7, 1, Phase.CLAIMED, 9, 1, 0), 0x80))
    made.write(2_000, encode(TaskClaim(7, 1, Phase.STARTED, 9, 2, 0), 0x80))
    for step in range(100):
        now_us = step * 200_000 + 10_000
        made.write(now_us, encode(Pose(10.0 + step / 2, 20.0, 0.0, 2.5, 1, False, 255), 0x80))
        made.write(now_us + 1, encode(Heartbeat(0, 1, False, False, True, False, 1.0, 0, 0), 0x80))
        made.write(now_us + 2, encode(WorkProgress(7, 0, (1 << step // 20) - 1), 0x80))
    made.close()
    return made


@contextmanager
def shown(recording: Recording) -> Iterator["Chrome"]:
    """The page of a recording, in a browser."""
    served = MapThread(recording, "a recording", 0)
    with browser() as page:
        page.get(served.url)
        yield page


def player_of(recording: Recording) -> PageUpdates:
    index = Index(recording)
    index.work(1e9)
    player = Player(index, True, 1.0)
    player.advance(0.0, 10.0)
    return PageUpdates(player)


def test_parcels_queues_and_batteries_are_told() -> None:
    updates = player_of(delivering())
    told = updates.tell()
    assert told["transports"] == [[5, 3, 44]]
    (robot,) = told["robots"]
    assert robot["battery"] == 0.5 and robot["queue"] == ["D5"]
    assert "transports" not in updates.tell(), "once"


def test_an_order_that_is_taken_back_is_told() -> None:
    """The page was told of orders only when there were more of them."""
    updates = player_of(delivering())
    updates.tell()
    updates.player.watcher.hear(1.0, encode(TaskOrder(5, WITHDRAWN, 44), 0xF9))
    assert updates.tell()["transports"] == [[5, WITHDRAWN, 44]]


@pytest.mark.slow
@needs_browser
def test_a_parcel_whose_order_was_taken_back_in_time_is_not_waited_for() -> None:
    """It lay at its pickup for ever, or far off the map, and the work never was all done."""
    aboard, waits = TaskOrder(5, WITHDRAWN, 44), TaskOrder(6, WITHDRAWN, 40)
    with shown(delivering(TaskOrder(6, 4, 40), aboard, waits)) as page:
        until(page, "headland.field?.transports.size === 3", WAIT_S)
        until(page, "document.getElementById('work').textContent === '1 of 2'")
        assert page.execute_script("return headland.field.parcels.map(([task]) => task)") == [0, 5]
        assert complaints(page) == []


def test_why_a_section_is_whose_is_told_with_what_led_to_it() -> None:
    told = player_of(working()).why(7)
    assert (told["phase"], told["owner"]) == ("STARTED", 0)
    texts = [text for _, text, _ in told["steps"]]
    assert texts[0].startswith("robot 0 claims it") and texts[1] == "robot 0 starts it"
    assert player_of(working()).why(99) == {
        "kind": "why", "section": 99, "steps": [], "phase": "FREE", "owner": None,
    }  # fmt: skip


@pytest.mark.slow
@needs_browser
def test_a_warehouse_shows_its_parcels() -> None:
    with shown(delivering()) as page:
        until(page, "document.getElementById('work').textContent === '1 of 2'", WAIT_S)
        until(
            page,
            "document.querySelector('#fleet tr[data-slot]')?.cells[4].textContent.includes('D5')",
        )
        assert "50" in page.execute_script(
            "return document.querySelector('#fleet tr[data-slot]').cells[4].textContent"
        )
        assert page.execute_script("return headland.field.cellAt(12)") == [2.5, 1.5]
        assert page.execute_script("return headland.field.delivered") == [1, 2]
        assert page.find_element("id", "has").text == "tasks", (
            "robots of a warehouse have no sections"
        )
        assert complaints(page) == []


def in_light(page: "Chrome", scheme: str) -> None:
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})


CORNER = (
    "const f = headland.field.ground.getContext('2d').getImageData(2, 2, 1, 1).data;"
    "return f[0] + f[1] + f[2]"
)


@needs_browser
def test_an_event_that_has_the_focus_keeps_it_when_another_one_comes() -> None:
    """Each event took the focus away, and a person with a keyboard began again at the top of the page."""
    made = Recording(dict(STRIP))
    made.write(0, encode(Member(0, 1, 0), 0x80))
    made.write(1, encode(EmergencyStop(0, 1, 1, 1), 0x80))
    made.write(1_000_000, encode(Pose(10.0, 20.0, 0.0, 0.0, 4, True, 255), 0x80))
    with shown(made) as page:
        until(page, "document.querySelector('#events [data-kind=stop]')", WAIT_S)
        page.execute_script("document.querySelector('#events [data-kind=stop]').focus()")
        made.write(2_000_000, encode(EmergencyReset(0, 1, 1, 200, 0, 0), 0x80))
        made.write(3_000_000, encode(Pose(10.0, 20.0, 0.0, 0.0, 1, False, 255), 0x80))
        until(page, "document.querySelector('#events [data-kind=reset]')", WAIT_S)
        assert page.execute_script("return document.activeElement.dataset.kind") == "stop"


@needs_browser
def test_a_robot_that_has_told_no_place_is_in_the_table_and_not_on_the_map() -> None:
    """It was drawn at the origin of the field, and a look at its details ended in an error."""
    made = Recording(dict(STRIP))
    made.write(0, encode(Member(0, 1, 0), 0x80))
    made.write(1, encode(Member(1, 1, 0), 0x81))
    nowhere = Pose(NOWHERE_M, NOWHERE_M, 0.0, PLACE_UNKNOWN_M_S, 1, False, 255)
    for t_us in (2, 900_000):
        made.write(t_us, encode(Pose(10.0, 20.0, 0.0, 0.0, 1, False, 255), 0x80))
        made.write(t_us, encode(nowhere, 0x81))
    made.close()
    with shown(made) as page:
        until(page, "document.querySelector('#fleet [data-slot=\"1\"]')", WAIT_S)
        until(page, "headland.state().robots.length === 2")
        page.execute_script("document.querySelector('#fleet [data-slot=\"1\"] button').click()")
        until(page, "document.getElementById('facts').textContent.includes('not known')")
        assert page.execute_script("return [...headland.field.trails.keys()]") == [0]
        pressed = "const f = headland.field, [x, y] = f.toScreen(0, 0);"
        assert page.execute_script(f"{pressed} return f.at(x, y, headland.state().robots)") is None
        assert complaints(page) == []


SPOKEN = """window.spoken = [];
new MutationObserver((changes) => {
  for (const { target } of changes) {
    const near = target.nodeType === Node.TEXT_NODE ? target.parentElement : target;
    const live = near?.closest('[role=alert], [role=status], output, [aria-live]');
    if (live && live.getAttribute('aria-live') !== 'off') window.spoken.push(live.id);
  }
}).observe(document.body, { subtree: true, childList: true, characterData: true });
window.heard = headland.told;"""


@needs_browser
def test_a_screen_reader_is_told_only_what_is_new() -> None:
    """The same words were set again many times a second, and a screen reader says them each time."""
    stopped = Recording(dict(STRIP))
    stopped.write(0, encode(Member(0, 1, 0), 0x80))
    stopped.write(1, encode(EmergencyStop(0, 1, 1, 1), 0x80))
    stopped.write(2, encode(Pose(10.0, 20.0, 0.0, 0.0, 4, True, 255), 0x80))
    stopped.close()
    with shown(stopped) as page:
        until(page, "document.getElementById('link').textContent === 'connected'", WAIT_S)
        until(page, "document.getElementById('stopped-why').textContent !== ''")
        page.execute_script(SPOKEN)
        until(page, "headland.told > window.heard + 60")
        assert page.execute_script("return window.spoken") == []


@pytest.mark.slow
@needs_browser
def test_another_light_changes_colours_and_nothing_else() -> None:
    """The page was loaded again: the time, the chosen robot and an open dialog were lost, and on a live
    map STOP was away meanwhile."""
    served = MapThread(delivering(), "house", 0)
    with browser() as page:
        in_light(page, "light")
        page.get(served.url)
        until(page, "document.querySelector('#fleet tr[data-slot]')", WAIT_S)
        until(page, f"(() => {{ {CORNER}; }})() > 700")
        page.execute_script("window.same = true; document.getElementById('help-open').click()")
        in_light(page, "dark")
        until(page, f"(() => {{ {CORNER}; }})() < 150")
        assert page.execute_script("return window.same && document.getElementById('help').open")
        assert complaints(page) == []


@pytest.mark.slow
@needs_browser
def test_a_section_says_why_by_click_and_by_key_and_a_robot_is_followed() -> None:
    with shown(working()) as page:
        until(page, "document.querySelector('button.section')", WAIT_S)
        page.execute_script(CLICK)
        until(page, "document.getElementById('why-name').textContent === 'section 7'")
        steps = "document.getElementById('why-steps').textContent"
        until(
            page, f"{steps}.includes('robot 0 claims it') && {steps}.includes('robot 0 starts it')"
        )
        place = page.find_element("id", "place").text
        assert place.startswith("85.0 m east, 20.5 m north") and "51.0001" in place, place
        page.find_element("id", "why-no").click()
        assert not shows(page, "why")
        tab_to_section(page)
        press(page, "ENTER")
        until(page, "!document.getElementById('why').hidden")
        page.execute_script("document.querySelector('#fleet [data-slot] button').focus()")
        press(page, "ENTER")
        until(page, "!document.getElementById('one').hidden")
        tab_to(page, "with")
        press(page, "ENTER")
        until(page, MIDDLE)
        page.find_element("id", "nearer").click()
        until(page, MIDDLE)
        assert complaints(page) == [] and axe(page) == []


def tab_to_section(page: "Chrome") -> None:
    for _ in range(60):
        if page.execute_script("return document.activeElement.className") == "section":
            return
        press(page, "TAB")
    raise AssertionError("no way to a section by Tab")


# -------------------------------------------------------------------- an operator's round


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("round")


@pytest.fixture(scope="module")
def fleet(folder: Path) -> Iterator[Live]:
    with launched(folder, "--no-keys") as live:
        yield live


Act = Callable[["Chrome", str], None]  # acts on a control, by its CSS selector


TABS_MAX = 300  # each event of the list is a stop of its own


def by_key(page: "Chrome", selector: str) -> None:
    """Tab until it has the focus, then Enter, or Space for a box."""
    for _ in range(TABS_MAX):
        if page.execute_script(f"return document.activeElement?.matches({selector!r})"):
            kind = page.execute_script("return document.activeElement.type")
            press(page, "SPACE" if kind == "checkbox" else "ENTER")
            return
        press(page, "TAB")
    raise AssertionError(f"no way to {selector} by Tab")


def by_touch(page: "Chrome", selector: str) -> None:
    """One finger on its middle, once nothing lies over that and the page moves it no more."""
    page.execute_script("delete window.wasAt")
    until(page, f"""(() => {{
        const e = document.querySelector({selector!r});
        if (!e?.checkVisibility()) return false;
        e.scrollIntoView({{block: 'nearest'}});
        const b = e.getBoundingClientRect(), x = b.x + b.width / 2, y = b.y + b.height / 2;
        const stands = window.wasAt?.[0] === x && window.wasAt[1] === y;
        window.wasAt = [x, y];
        const top = document.elementFromPoint(x, y);
        return stands && top && (e.contains(top) || top.closest("label")?.control === e);
    }})()""")  # fmt: skip
    x, y = page.execute_script("return window.wasAt")
    point = [{"x": x, "y": y, "id": 1}]
    page.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": point})
    page.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize("hand", ["keyboard", "touch"])
def test_an_operator_s_round(fleet: Live, folder: Path, hand: str) -> None:
    act: Act = by_key if hand == "keyboard" else by_touch
    phone = hand == "touch"
    with browser() as page:
        if phone:
            page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
                "width": PHONE[0], "height": PHONE[1], "deviceScaleFactor": 2, "mobile": True,
            })  # fmt: skip
            page.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
        page.get(fleet.url)
        until(page, robots_in("WORKING", "IDLE"), WAIT_S)
        # This banner moves everything below it, also from under a finger.
        until(page, "!document.getElementById('keyless-fleet').hidden", WAIT_S)
        # What is shown: the legend, the layers, nearer and farther.
        act(page, "#help-open")
        until(page, "document.getElementById('help').open")
        act(page, "#help-no")
        until(page, "!document.getElementById('help').open")
        if phone:
            act(page, "#layers-open")
        act(page, "[data-layer=orca]")
        until(page, "headland.field.layers.orca")
        if phone:
            act(page, "#layers-open")
        act(page, "#nearer")
        # A new layout fits the map only while nobody has moved it.
        until(page, "headland.field.moved")
        if phone:
            pinch(page, 160, 60)
        act(page, "#fit")
        # A robot, why it has its section, and its way back.
        if phone:
            act(page, "#sheet")
        act(page, "#fleet [data-slot='1'] button")
        until(page, "document.getElementById('one-name').textContent === 'robot 1'")
        until(page, "document.querySelector('button.section')", WAIT_S)
        act(page, "button.section")
        until(page, "document.getElementById('why-steps').children.length > 0")
        act(page, "#why-no")
        assert "stop" not in hidden_buttons(page)
        if phone:
            act(page, "#sheet")
        # Back in time and to now.
        act(page, "#play")
        until(page, "!headland.state().playing")
        act(page, "#resume")
        until(page, "headland.state().follow")
        # Stop, release, start.
        act(page, "#stop")
        assert on_the_bus(folder, all_latched)
        until(page, "document.getElementById('hand-says').textContent === 'all have confirmed'")
        until(page, "!document.getElementById('stopped').hidden")
        until(page, "!document.getElementById('reset').hidden")
        if phone:
            act(page, "#sheet")
        act(page, "#events button[data-kind=stop]")  # when it was pressed
        until(page, "!headland.state().follow")
        if phone:
            act(page, "#sheet")
        act(page, "#live")
        until(page, "headland.state().follow")
        act(page, "#reset")
        until(page, "document.getElementById('release').open")
        act(page, "#keyless")
        act(page, "#also")
        act(page, "#release-yes")
        assert on_the_bus(folder, all_at_work)
        until(page, "!document.getElementById('release').open")
        assert complaints(page) == [] and axe(page) == []
