"""The routing table: total, safety first, and the same as on the page that is printed from it."""

from pathlib import Path
from random import Random

import pytest

from agent.interface.identity import SilencePolicy
from agent.interface.lifecycle import State
from agent.peer.part import Part, Senders
from agent.peer.routing import NOT_FOR_ROBOTS, ROUTES
from agent.runtime.peer_factory import identity_of, make_peer
from agent.safety.stop_controller import StopController
from agent.segments.segment_area import Area
from agent.segments.segment_parts import SEGMENT_ROUTES
from protocol.frames.codec import Malformed
from protocol.frames.messages import GROUPS
from protocol.frames.safety_frames import EmergencyStop
from tests.agent.lone_peer import peer_in
from tools.cli.doc_pages import pages

PAGE = Path(__file__).parents[3] / "docs" / "how" / "routes.md"


def test_every_message_has_one_row() -> None:
    """What the codec can decode, and what it says of a frame that it cannot."""
    tables = (ROUTES, SEGMENT_ROUTES, NOT_FOR_ROBOTS)
    kinds = [kind for table in tables for kind in table]
    assert sorted(map(str, kinds)) == sorted(map(str, {*(g.kind for g in GROUPS), Malformed}))


def test_the_stop_is_first_and_nobody_else_is_urgent() -> None:
    assert next(iter(ROUTES)) is EmergencyStop
    urgent = [kind for kind, route in ROUTES.items() if route.senders is Senders.URGENT]
    assert urgent == [EmergencyStop]


@pytest.mark.parametrize("area", [None, Area(1, 4)], ids=["one segment", "several"])
def test_every_handler_has_a_row_and_every_row_a_handler(area: Area | None) -> None:
    """The peer compares them itself when it is made; here with the parts of both kinds of fleets."""
    identity = identity_of("routes", 0, 3, 1, SilencePolicy.STOP, first_boot=True)
    peer = make_peer(identity, Random(1), 0, area=area)
    handled = [kind for part in peer.parts for kind in (*part.handles, *part.direct)]
    table = ROUTES if area is None else {**ROUTES, **SEGMENT_ROUTES}
    assert len(handled) == len(set(handled)) and set(handled) == table.keys()


def test_no_part_holds_the_peer_and_deadlines_are_those_of_the_parts() -> None:
    peer = peer_in(State.IDLE, None)
    for part in peer.parts:
        assert isinstance(part, Part)
        assert peer not in vars(part).values() and peer.named not in vars(part).values()
    assert peer.due_at_us == min(part.due_at_us for part in peer.parts)
    assert isinstance(peer.safety, StopController)


def test_the_page_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == pages()["how/routes.md"]
