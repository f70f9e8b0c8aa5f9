"""The inspector's screen, driven by Textual's own pilot: a log, keys, a picture; and a live bus."""

import asyncio
from pathlib import Path

import pytest

pytest.importorskip("textual", reason="the extra `operator` is not installed")

from textual.pilot import Pilot
from textual.widgets import Static

from agent.interface.lifecycle import TABLE, State
from protocol.frames.frame import Frame
from protocol.links.bus import CanBus
from sim.can.simulated_bus import FieldBus, segment
from sim.fleet.simulated_fleet import Cluster
from sim.fleet.virtual_clock import elapse, run_virtual
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.cli.headland import main
from tools.inspect.frame_feed import from_bus, from_log
from tools.inspect.inspector import Inspector
from tools.inspect.lifecycle_picture import edges_from, picture
from tools.inspect.screen import InspectScreen, draw
from tools.inspect.table_widget import Rows

SIZE = (150, 42)
SHORT_S = 45.0
WAIT_S = 30.0


@pytest.fixture(scope="module")
def frames() -> list[tuple[int, Frame]]:
    """Of a small fleet that works, and one robot that dies."""
    found: list[tuple[int, Frame]] = []

    async def main() -> None:
        cluster = Cluster(FieldSetup(load("small")), "screen")
        cluster.segment.taps.append(lambda t_us, frame: found.append((t_us, frame)))
        cluster.boot_all()
        await elapse(SHORT_S - 10.0)
        cluster.kill(2)
        await elapse(10.0)
        await cluster.close()

    run_virtual(main())
    return found


def text_of(screen: InspectScreen, name: str) -> str:
    return str(screen.query_one(f"#{name}", Static).render())


def rows_of(screen: InspectScreen, name: str) -> list[tuple[str, ...]]:
    return screen.query_one(f"#{name}", Rows).rows


async def fed(screen: InspectScreen, pilot: Pilot[None]) -> None:
    while not screen.fed:
        await pilot.pause(0.01)
    await pilot.pause()


@pytest.mark.slow
def test_the_fleet_a_state_machine_sections_frames_and_load(
    frames: list[tuple[int, Frame]],
) -> None:
    async def main() -> None:
        inspector = Inspector()
        screen = InspectScreen(inspector, "a run", from_log(frames, inspector, at_once=True))
        async with screen.run_test(size=SIZE) as pilot:
            await fed(screen, pilot)
            fleet = rows_of(screen, "fleet")
            assert [(row[0], row[1]) for row in fleet] == [
                ("0", "WORKING"), ("1", "WORKING"), ("2", "silent"),
            ]  # fmt: skip
            assert "▶  WORKING" in text_of(screen, "machine")
            assert "IDLE → WORKING" in text_of(screen, "path")
            sections = rows_of(screen, "sections")
            numbers = [int(row[0][1:]) for row in sections]
            assert numbers == sorted(numbers) and "STARTED" in {row[1] for row in sections}
            counted = {row[0]: int(row[1]) for row in rows_of(screen, "frames")}
            assert counted == dict(inspector.kinds) and sum(counted.values()) == len(frames)
            assert "% now" in text_of(screen, "share") and max(inspector.load.shares) < 1.0
            assert screen.query_one("#fleet").has_focus
            await pilot.press("down")
            assert screen.chosen is not None and screen.chosen.slot == 1
            await pilot.press("w")
            assert "claims it" in text_of(screen, "path")
            await pilot.press("w")
            assert "IDLE → WORKING" in text_of(screen, "path")
            await pilot.press("q")

    asyncio.run(main())


def test_why_is_seen_in_a_terminal_of_80_by_24(frames: list[tuple[int, Frame]]) -> None:
    """The panel of the answer lay below its box, so that `w` did nothing that a person could see."""

    async def main() -> None:
        inspector = Inspector()
        screen = InspectScreen(inspector, "a run", from_log(frames, inspector, at_once=True))
        async with screen.run_test(size=(80, 24)) as pilot:
            await fed(screen, pilot)
            await pilot.press("w")
            await pilot.pause()
            box, answer = screen.query_one("#top").region, screen.query_one("#path").region
            assert box.contains_region(answer) and answer.height >= 8, (box, answer)
            assert "claims it" in text_of(screen, "path")
            await pilot.press("w")
            await pilot.pause()
            assert screen.query_one("#machine").display

    asyncio.run(main())


def test_the_screen_as_a_picture(frames: list[tuple[int, Frame]], tmp_path: Path) -> None:
    inspector, path = Inspector(), tmp_path / "inspect.svg"
    draw(InspectScreen(inspector, "a run", from_log(frames, inspector, at_once=True)), path)
    drawn = path.read_text()
    assert drawn.startswith("<svg") and "WORKING" in drawn and "TaskClaim" in drawn
    assert "@font-face" not in drawn and 'url("' not in drawn, "nothing is loaded from elsewhere"


def test_a_name_with_brackets_is_shown_as_it_is(
    frames: list[tuple[int, Frame]], tmp_path: Path
) -> None:
    """They were read as marks of a style: a folder `a[/b]` ended the screen, and `[old]` was left out."""
    path = tmp_path / "inspect.svg"
    for name in ("a[/b]", "runs[old]"):
        draw(InspectScreen(Inspector(), name, from_log(frames[:9], Inspector(), True)), path)
        assert name in path.read_text()


@pytest.mark.parametrize(
    ("name", "code"), [("nodir/x.svg", 2), (".", 2), ("file/x.svg", 2), ("/dev/full", 75)]
)
def test_a_picture_that_cannot_be_written_is_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    name: str, code: int,
) -> None:  # fmt: skip
    if name == "/dev/full" and not Path(name).exists():
        pytest.skip("no /dev/full on this system")
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    Path("some.log").write_text("(0.000000) can0 18FEF180#0000000000000000\n")
    with pytest.raises(SystemExit) as ended:
        monkeypatch.setattr("sys.argv", ["headland", "inspect", "some.log", "--picture", name])
        main()
    told = capfd.readouterr()
    assert ended.value.code == code and told.err.count("\n") == 1, told
    assert told.err.startswith(f"headland: --picture {name}: ") and "Traceback" not in told.out


def test_a_stop_is_large_and_a_paused_log_stands_still(frames: list[tuple[int, Frame]]) -> None:
    async def main() -> None:
        inspector = Inspector()
        screen = InspectScreen(inspector, "a run", from_log(frames, inspector, False), speed=4.0)
        async with screen.run_test(size=SIZE) as pilot:
            while not inspector.robots:
                await pilot.pause(0.01)
            await pilot.press("space")
            heard = sum(inspector.kinds.values())
            for _ in range(20):  # looks at the screen; frames would come with them
                await pilot.pause()
            assert sum(inspector.kinds.values()) == heard
            assert "PAUSED" in text_of(screen, "status")
            inspector.stops[7, 1, 1] = inspector.now_s
            screen.look()
            assert screen.query_one("#stops").display and "7.1.1" in text_of(screen, "stops")
            await pilot.press("plus", "plus", "minus")
            assert screen.speed == 8.0
            screen.speed = 1e4
            await pilot.press("space")
            await fed(screen, pilot)
            assert sum(inspector.kinds.values()) == len(frames)

    asyncio.run(main())


def test_a_live_bus_is_shown_while_it_is_heard(frames: list[tuple[int, Frame]]) -> None:
    async def main() -> None:
        inspector = Inspector()
        channel = "screen live"
        wire, sender = segment(channel), CanBus(FieldBus(channel))

        async def open_bus() -> CanBus:
            return CanBus(FieldBus(channel))

        feed = from_bus(open_bus, inspector)
        screen = InspectScreen(inspector, "live bus", feed)
        try:
            async with screen.run_test(size=SIZE) as pilot:
                await pilot.pause(0.1)
                for _, frame in frames[:40]:
                    sender.send(frame)
                while len(inspector.robots) < 3:
                    await pilot.pause(0.02)
                screen.look()
                assert [row[0] for row in rows_of(screen, "fleet")] == ["0", "1", "2"]
                assert not screen.fed and wire is not None
                # A bus that ended looked alive: its robots were shown as they had been.
                async with asyncio.timeout(WAIT_S):
                    while {row[1] for row in rows_of(screen, "fleet")} != {"silent"}:
                        await pilot.pause(0.05)
                        screen.look()
        finally:
            sender.close()

    asyncio.run(main())


def test_nobody_on_the_bus_is_an_empty_screen() -> None:
    async def main() -> None:
        inspector = Inspector()
        screen = InspectScreen(inspector, "nothing", from_log([], inspector, at_once=True))
        async with screen.run_test(size=(80, 24)) as pilot:
            await fed(screen, pilot)
            await pilot.press("w", "down", "space")
            assert "no robot" in text_of(screen, "machine")

    asyncio.run(main())


@pytest.mark.parametrize("state", State, ids=lambda state: state.name)
def test_the_picture_lights_the_state_and_has_the_edges_of_the_table(state: State) -> None:
    drawn = picture(state.name)
    assert f"▶  {state.name}" in drawn.plain and drawn.plain.count("▶  ") == 1
    targets = {target for (source, _), target in TABLE.items() if source is state} - {state}
    assert {target for target, _ in edges_from(state)} == targets
    for target, events in edges_from(state):
        assert all(TABLE[state, event] is target for event in events)
        assert all(event.name.lower() in drawn.plain for event in events)
