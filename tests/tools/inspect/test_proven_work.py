"""What a program tells other systems of work: only what robots have proven, in a fleet with keys."""

from pathlib import Path

import pytest

from agent.interface.config import MS, S
from agent.runtime.files.key_file import fresh, operator_path, write
from crdt import Phase
from protocol.authentication import Keys
from protocol.frames.codec import encode
from protocol.frames.frame import Frame
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress
from protocol.name import tool_name
from sim.rigs.keyed_rig import UNITS, KeyedRig
from tools.common.bus_address import AttachError
from tools.inspect.inspector import Inspector
from tools.inspect.proven_work import ProvenWork, proven_work_of

TOOL, ALL_UNITS = 250, (1 << UNITS) - 1
LIES = (
    TaskClaim(3, 1, Phase.DONE, 0, 900, 1),
    StateSyncResponse(3, 1, Phase.DONE, 0, 900, 1),
    WorkProgress(3, 0, ALL_UNITS),
)


class HeardRig(KeyedRig):
    """A fleet, and a program on its bus that comes when the robots are at work."""

    def __init__(self, seed: int) -> None:
        self.inspector, self.heard = Inspector(), list[Frame]()
        super().__init__(seed)
        assert self.keys is not None
        self.proven = ProvenWork(Keys(self.keys.master, None), seed, self.now_us)
        self.inspector.proven = self.proven
        self.forge(AddressClaimed(tool_name(TOOL).pack()), TOOL)
        self.listen(3 * S)

    def _deliver(self, frame: Frame, sender: int | None) -> None:
        self.heard.append(frame)
        self.inspector.hear(self.now_us / 1e6, frame)
        super()._deliver(frame, sender)

    def listen(self, for_us: int) -> None:
        """Let time pass, and the program ask what it has to know."""
        end_at_us = self.now_us + for_us
        while self.now_us < end_at_us:
            for question in self.proven.questions(self.now_us):
                self.inject(encode(question, TOOL))
            self.run_for(200 * MS)


def believed(inspector: Inspector, section: int) -> tuple[Phase, int]:
    return inspector.allocation.phase_of(section), inspector.progress.covered(section)


def test_what_robots_have_proven_is_told() -> None:
    rig = HeardRig(1)
    rig.work(1, 2)
    assert rig.inspector.allocation.owner_of(2) == 1
    assert rig.inspector.progress.covered(2) == UNITS // 2


@pytest.mark.parametrize("lie", LIES, ids=lambda lie: type(lie).__name__)
def test_nobody_without_a_key_makes_work_look_done(
    lie: TaskClaim | StateSyncResponse | WorkProgress,
) -> None:
    """A transport that an outsider had called done was reported as delivered to other systems."""
    rig = HeardRig(2)
    rig.forge(lie, rig.address_of(1))
    rig.listen(3 * S)
    assert believed(rig.inspector, 3) == (Phase.FREE, 0)
    rig.inspector.proven = None  # as in a fleet without keys
    rig.forge(lie, rig.address_of(1))
    assert believed(rig.inspector, 3) != (Phase.FREE, 0), "else the test shows nothing"


def test_a_recording_tells_nothing() -> None:
    rig = HeardRig(3)
    rig.heard.clear()
    rig.work(1, 2)
    recorded = list(rig.heard)
    late = Inspector()
    assert rig.keys is not None
    late.proven = rig.inspector.proven = rig.proven
    rig.inspector = late  # it knows the time and the robots, and no work
    rig.listen(3 * S)
    for frame in recorded:
        rig.inject(frame)
    assert believed(late, 2) == (Phase.FREE, 0)


def test_the_key_of_a_panel_is_found_in_a_folder_and_beside_an_operators_file(
    tmp_path: Path,
) -> None:
    keys = tmp_path / "keys"
    keys.mkdir(mode=0o700)
    fleet, operator, panel = (keys / f"{name}.json" for name in ("fleet", "operator", "panel"))
    write(fleet, operator, fresh(), 249, range(1))
    for given in (keys, operator, panel, fleet):
        found = proven_work_of(given, 0)
        assert found is not None and found.proofs.keys.keys.operator is None, given
    panel.chmod(0o644)
    with pytest.raises(AttachError, match="others may read it"):
        proven_work_of(operator, 0)
    for path in (panel, fleet):
        path.unlink()
    assert proven_work_of(operator, 0) is None, "an operator's key alone verifies no robot"
    assert proven_work_of(None, 0) is None
    with pytest.raises(AttachError, match="cannot be read"):
        proven_work_of(operator_path(keys, 200), 0)
