"""The key file of a gateway: it is read again when the owner has replaced it."""

import os
from pathlib import Path

import pytest

from agent.interface.config import S
from agent.peer.inputs import ClaimSection, Leave
from agent.runtime.files.key_file import FLEET, NAMES, OPERATOR, PANELS, fresh, write
from crdt import Phase
from protocol.authentication import Keys
from sim.rigs.segments_rig import SegmentFleet
from tools.common.bus_address import AttachError
from tools.common.panel_keys import PanelKeys


def keys_in(folder: Path) -> Path:
    folder.mkdir(mode=0o700)
    write(folder / NAMES[FLEET], folder / NAMES[OPERATOR], fresh(), 249)
    return folder


def test_a_gateway_reads_its_file_again_when_the_owner_has_replaced_it(tmp_path: Path) -> None:
    first, second = keys_in(tmp_path / "first"), keys_in(tmp_path / "second")
    keys = PanelKeys(first)
    before = keys.keys
    assert before.master is not None and before.operator is None, "it needs no more than this"
    assert keys.renewed() is None
    file = first / NAMES[PANELS]
    os.truncate(file, 10)  # half written
    os.utime(file, ns=(1, 1))
    assert keys.renewed() is None and keys.keys == before
    (second / NAMES[PANELS]).replace(file)
    renewed = keys.renewed()
    assert renewed is not None and renewed != before
    assert keys.renewed() is None


def test_a_file_that_is_replaced_within_a_tick_of_the_clock_is_read_again(tmp_path: Path) -> None:
    """Its time was compared alone, and file systems count it in steps of some milliseconds."""
    first, second = keys_in(tmp_path / "first"), keys_in(tmp_path / "second")
    files = [folder / NAMES[PANELS] for folder in (first, second)]
    for file in files:
        os.utime(file, ns=(7, 7))
    keys = PanelKeys(first)
    files[1].replace(files[0])
    assert files[0].stat().st_mtime_ns == 7 and keys.renewed() is not None


def test_a_gateways_file_that_others_may_read_is_refused(tmp_path: Path) -> None:
    folder = keys_in(tmp_path / "keys")
    (folder / NAMES[PANELS]).chmod(0o644)
    with pytest.raises(AttachError, match="others may read it"):
        PanelKeys(folder)
    with pytest.raises(AttachError, match="is needed"):
        PanelKeys(folder / NAMES[OPERATOR])


def test_a_gateway_with_new_keys_does_not_bring_back_what_a_revoked_robot_said() -> None:
    """It corrected the first honest claim of the section with the end that the thief had told it."""
    thief, section, keys = 2, 10, Keys(b"m" * 16, b"o" * 16)
    fleet = SegmentFleet(2, 3, 28, candidates=1, keys=keys, shared=2)
    assert fleet.run(10 * S, lambda: fleet.joined)
    fleet.run(2 * S)  # the gateways know the fleet's time
    fleet.finish(1, thief, section)
    fleet.run(6 * S)
    others = fleet.peers(1)[:thief]
    assert all(peer.allocation.phase_of(section) is Phase.DONE for peer in others)
    fleet.runners[1, thief].operate(Leave())
    fleet.run(S)
    for peer in others:  # what they do at the switch
        peer.named.state_sync.sync.void(thief, None, fleet.event_loop.now_us())
        peer.membership.revoke(thief, fleet.event_loop.now_us())
    for runner in fleet.gateways[1]:
        runner.gateway.rekey(Keys(keys.master, None), fleet.event_loop.now_us())
    fleet.run(2 * S)
    fleet.runners[1, 0].operate(ClaimSection(section, 3))
    fleet.run(3 * S)
    for peer in others:
        assert peer.allocation.phase_of(section) is not Phase.DONE
        assert peer.allocation.owner_of(section) == 0
    lent = 38
    fleet.finish(1, 1, lent)
    there = next(n for n, place in fleet.areas[2].borrowed.items() if place.section == lent)
    known = [peer.allocation for peer in fleet.peers(2)]
    assert fleet.run(15 * S, lambda: all(a.phase_of(there) is Phase.DONE for a in known))
    fleet.end()
