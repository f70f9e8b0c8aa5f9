"""A log on the screen of `headland inspect`, at the speed that a person wants."""

import asyncio
from types import SimpleNamespace

import pytest

from protocol.frames.frame import Frame
from sim.fleet.virtual_clock import run_virtual
from tools.inspect.frame_feed import from_log
from tools.inspect.inspector import Inspector

FRAME = Frame(0x18FF0080, bytes(8))


@pytest.mark.parametrize(("gap_s", "shown_s"), [(4.0, 4.0), (3600.0, 10.0), (1e8, 10.0)])
def test_a_log_with_a_gap_goes_on(gap_s: float, shown_s: float) -> None:
    """Found: where a clock had been set by an hour, the screen stood for six minutes at `--speed 10`."""
    heard_s: list[float] = []

    async def story() -> float:
        running = asyncio.Event()
        running.set()
        inspector = Inspector()
        inspector.hear = lambda t_s, frame: heard_s.append(t_s)  # type: ignore[method-assign]
        rows = [(0, FRAME), (1_000_000, FRAME), (round((1 + gap_s) * 1e6), FRAME)]
        screen = SimpleNamespace(running=running, speed=10.0)
        await from_log(rows, inspector, False)(screen)  # type: ignore[arg-type]  # all that it uses
        return asyncio.get_running_loop().time()

    took_s = run_virtual(story())
    assert heard_s == [0.0, 1.0, 1.0 + gap_s]
    assert took_s == pytest.approx((1.0 + shown_s) / 10.0, abs=0.2)
