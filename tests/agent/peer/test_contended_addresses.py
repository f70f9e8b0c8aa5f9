"""A claim of another maker for the address of our device takes nobody's signed stop away."""

import pytest

from agent.interface.config import MS, S
from agent.interface.lifecycle import State
from agent.peer.inputs import Press
from protocol.authentication import Keyring
from protocol.frames.codec import decode
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import Challenge, EmergencyStop, Reason
from protocol.name import Name, tool_name
from sim.rigs.keyed_rig import KeyedRig

PANEL, AT = 140, 249
LAST_NAME = (1 << 64) - 1  # loses every contention, so that the device at the address never moves
OTHER_MAKER = Name(77, manufacturer=100, function=25).pack()


@pytest.fixture
def rig() -> KeyedRig:
    fleet = KeyedRig(1)
    fleet.work(1, 2)
    assert all(drive.vx_m_s > 0 for drive in fleet.drives.values())
    return fleet


def answer_questions(rig: KeyedRig, ring: Keyring) -> None:
    """The panel proves its counter to robots that ask for it, as every panel does."""
    for frame in list(rig.recorded):
        source, message = decode(frame)
        answer = ring.answer(message, rig.now_us) if isinstance(message, Challenge) else None
        if answer is not None:
            rig.forge(answer, AT, source)


@pytest.mark.parametrize("name", [LAST_NAME, OTHER_MAKER])
@pytest.mark.parametrize(
    "counter", [0, 5_000], ids=["new panel", "panel whose counter is asked for"]
)
def test_claims_for_the_address_of_a_panel_do_not_make_its_stop_unheard(
    rig: KeyedRig, name: int, counter: int
) -> None:
    """Before: three such claims, and 100 signed frames of the panel stopped nobody at 2 m/s."""
    assert rig.keys is not None
    ring = Keyring(rig.keys, PANEL, b"panel", counter)
    rig.forge(AddressClaimed(tool_name(5).pack()), AT)
    rig.run_for(2 * S)
    for _ in range(3):
        rig.forge(AddressClaimed(name), AT)
    for tick in range(100):
        rig.recorded.clear()
        rig.forge(ring.sign(EmergencyStop(PANEL, 1, 1, Reason.PERSON_IN_FIELD)), AT)
        answer_questions(rig, ring)
        rig.run_for(10 * MS)
        if tick == 3:
            assert not any(drive.vx_m_s for drive in rig.drives.values()), "the first frames brake"
    assert {peer.state for peer in rig.peers.values()} == {State.EMERGENCY_STOP}


def test_claims_for_the_address_of_a_robot_do_not_make_its_button_unheard(rig: KeyedRig) -> None:
    address = rig.address_of(1)
    for tick in range(40):
        rig.forge(AddressClaimed(LAST_NAME), address)
        if tick == 20:
            rig.tell(1, Press(Reason.PERSON_IN_FIELD))
            rig.forge(AddressClaimed(LAST_NAME), address)
        rig.run_for(5 * MS)
    assert {peer.state for peer in rig.peers.values()} == {State.EMERGENCY_STOP}


def test_another_maker_at_an_address_that_nobody_of_ours_had_commands_nothing(
    rig: KeyedRig,
) -> None:
    rig.forge(AddressClaimed(OTHER_MAKER), AT)
    for _ in range(100):
        rig.forge(EmergencyStop(PANEL, 1, 1, Reason.PERSON_IN_FIELD), AT)
        rig.run_for(10 * MS)
        assert all(drive.vx_m_s > 0 for drive in rig.drives.values())
