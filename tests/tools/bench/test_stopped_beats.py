"""When a fleet counts as started: every robot's places come at their rate, and not merely some."""

import asyncio

import pytest

from protocol.frames.codec import encode
from protocol.frames.fleet_frames import PLACE_UNKNOWN_M_S, Pose
from tools.bench import stopped_beats
from tools.bench.stopped_beats import Beats

WINDOW_S = 0.2


@pytest.mark.asyncio
@pytest.mark.parametrize("placed, settles", [(True, True), (False, False)])
async def test_a_fleet_has_settled_when_its_places_come_at_their_rate(
    placed: bool, settles: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The door to Foxglove was measured while its 20 robots were starting: 23 places until then."""
    monkeypatch.setattr(stopped_beats, "SETTLED_S", WINDOW_S)
    monkeypatch.setattr(stopped_beats, "READY_S", 3 * WINDOW_S)
    beats, loop = Beats(2), asyncio.get_running_loop()

    def beat() -> None:
        for source in (128, 129):
            pose = Pose(1.0, 2.0, 0.0, 0.0, 1, False, 0)
            beats.hear(
                encode(pose if placed else pose._replace(speed_m_s=PLACE_UNKNOWN_M_S), source)
            )
        loop.call_later(0.01, beat)

    beat()
    assert await beats.settled(20.0) is settles
