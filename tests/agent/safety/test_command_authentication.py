"""Forged, replayed and held-back orders at a robot's safety, by the campaign of the benchmark."""

import pytest

from agent.interface.identity import SilencePolicy
from agent.safety.command_authentication import AGREE_US, CommandAuthority
from agent.safety.stop_controller import StopController
from crdt.stops import StopDot
from protocol.authentication import Keyring, Keys
from protocol.frames.safety_frames import (
    Command,
    EmergencyReset,
    EmergencyStop,
    OperatorCommand,
    Reason,
)
from tools.bench import forgery

KEYS = Keys(bytes(16), bytes(range(16)))
DEVICE, ROBOT = 249, 0


def proven() -> tuple[CommandAuthority, Keyring]:
    """A robot and an operator that has proven where its counter is, at time 0."""
    authority = CommandAuthority(ROBOT, Keyring(KEYS, ROBOT, b"boot"))
    device = Keyring(Keys(None, KEYS.operator), DEVICE, b"session")
    ring = authority.keyring
    assert ring is not None
    question = ring.ask(DEVICE, 0)
    assert question is not None
    proof = device.answer(question, 0)
    assert proof is not None and ring.prove(proof, 0)
    return authority, device


@pytest.mark.parametrize("every", [3, 50])
@pytest.mark.parametrize("spacing_us", [forgery.BUS_SPACING_US, forgery.SLOW_SPACING_US])
def test_an_attacker_releases_nobody(spacing_us: int, every: int) -> None:
    siege = forgery.ForgeryAttack(7, spacing_us, every)
    siege.run(5_000)
    assert sum(siege.accepted.values()) == 0, "seed 7"
    assert siege.safety.authority.refused > 3_000 and siege.safety.stops.latched


def test_the_campaign_finds_a_robot_that_does_not_look(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Keyring, "verify", lambda self, message, sender, now_us: True)
    siege = forgery.ForgeryAttack(7, forgery.SLOW_SPACING_US, 50)
    siege.run(300)
    assert sum(siege.accepted.values())


def test_an_order_needs_two_frames_that_agree() -> None:
    authority, device = proven()
    reset = EmergencyReset(1, 1, 1, DEVICE)
    for message, now_us, agreed in (
        (reset, 0, False),
        (reset._replace(counter=2), 1, False),
        (OperatorCommand(Command.START, 255, DEVICE), 2, False),
        (reset, 3, True),
        (reset._replace(counter=2), AGREE_US + 2, False),
    ):
        signed = device.sign(message)  # type: ignore[type-var]
        assert authority.believes(signed, DEVICE, now_us)
        assert authority.agreed(signed, now_us) == agreed, message


def test_a_robot_gives_no_orders() -> None:
    authority, _ = proven()
    peer = Keyring(KEYS, 5, b"")
    assert authority.believes(peer.sign(EmergencyStop(5, 1, 1, 0)), 5, 0)
    assert not authority.believes(peer.sign(EmergencyReset(5, 1, 1, 5)), 5, 0)
    assert not authority.believes(peer.sign(EmergencyStop(5, 1, 1, 0)), None, 0), "of nobody known"


def test_without_keys_everybody_is_believed() -> None:
    authority = CommandAuthority(ROBOT, None)
    reset = EmergencyReset(1, 1, 1, DEVICE)
    assert authority.believes(reset, DEVICE, 0) and authority.agreed(reset, 0)
    assert not authority.ask(DEVICE, 0) and authority.refused == 0


def test_questions_make_no_flood() -> None:
    authority, _ = proven()
    asked = sum(bool(authority.ask(n % 250 + 1, 1_000_000 + n * 640)) for n in range(1_562))
    assert asked <= 11, "ten a second, whomever they are about"


def test_forged_stops_in_a_robots_name_take_no_memory() -> None:
    """Each name that was said from a robot's address was kept for ever: up to 16 million of them."""
    safety = StopController(ROBOT, 1, SilencePolicy.STOP, Keyring(KEYS, ROBOT, b"boot"), {}, 0)
    kept = []
    for number in range(4_000):
        dot = 1, number >> 8, number & 0xFF
        safety.receive_stop(
            EmergencyStop(*dot, Reason.OPERATOR_INTERVENTION, number % 2 == 0), 1, number
        )
        kept.append(safety.echoed(StopDot(*dot)))
    assert not any(kept) and not safety.latched
    presser = Keyring(KEYS, 1, b"boot")
    true = presser.sign(EmergencyStop(1, 200, 1, Reason.OPERATOR_INTERVENTION))
    safety.receive_stop(true, 1, 60_000_000)
    assert safety.latched and safety.echoed(StopDot(1, 200, 1)) == {ROBOT, 1}
