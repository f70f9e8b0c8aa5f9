"""Tags, freshness, proofs and lock-out: nothing forged, replayed or held back is believed."""

from random import Random
from typing import Any

import pytest
from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.cmac import CMAC
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol import authentication
from protocol.authentication import (
    BAD_MAX,
    BAD_WINDOW_US,
    NUMBER_LIFE_US,
    SESSION_US,
    WINDOW,
    Keyring,
    Keys,
)  # fmt: skip
from protocol.frames.safety_frames import (
    EMERGENCY_RESET,
    Command,
    EmergencyReset,
    EmergencyStop,
    OperatorCommand,
)
from tests.examples import examples

MASTER, SECRET = bytes(range(16)), bytes(range(16, 32))
FLEET, OPERATOR = Keys(MASTER, SECRET), Keys(None, SECRET)
DEVICE, ROBOT, PANEL = 249, 1, 140
S = 1_000_000


def robot(slot: int = 0, lot: bytes = b"boot") -> Keyring:
    return Keyring(FLEET, slot, lot)


def operator(sent: int = 0) -> Keyring:
    return Keyring(OPERATOR, DEVICE, b"session", sent)


def introduce(receiver: Keyring, sender: Keyring, now_us: int) -> bool:
    question = receiver.ask(sender.sender, now_us)
    assert question is not None
    proof = sender.answer(question, now_us)
    return proof is not None and receiver.prove(proof, now_us)


def reset(n: int = 1) -> EmergencyReset:
    return EmergencyReset(2, 1, n, DEVICE)


def test_the_cmac_is_that_of_rfc_4493() -> None:
    mac = CMAC(AES(bytes.fromhex("2b7e151628aed2a6abf7158809cf4f3c")))
    mac.update(bytes.fromhex("6bc1bee22e409f96e93d7e117393172a"))
    assert mac.finalize().hex() == "070a16b46b4d4144f79bdd9dd04a287c"


def test_a_signed_frame_is_believed_once() -> None:
    receiver, device = robot(), operator()
    assert introduce(receiver, device, 0)
    frame = device.sign(reset())
    assert frame.tag and receiver.verify(frame, DEVICE, 0)
    assert not receiver.verify(frame, DEVICE, 0) and receiver.stale == 1


def test_an_operator_proves_itself_first_and_again_after_silence() -> None:
    receiver, device = robot(), operator()
    assert not receiver.verify(device.sign(reset()), DEVICE, 0) and receiver.unproven == 1
    assert introduce(receiver, device, 0)
    held_back = device.sign(OperatorCommand(Command.START, 255, DEVICE))
    assert not receiver.verify(held_back, DEVICE, SESSION_US + 1)
    assert introduce(receiver, device, SESSION_US + 2)
    assert not receiver.verify(held_back, DEVICE, SESSION_US + 3), "older than the proof"
    assert receiver.verify(device.sign(reset()), DEVICE, SESSION_US + 4)


def test_a_robot_is_believed_without_a_word_before() -> None:
    """A stop must not wait for anything."""
    assert robot(0).verify(robot(ROBOT).sign(EmergencyStop(ROBOT, 1, 1, 0)), ROBOT, 0)


@pytest.mark.parametrize("ahead", [WINDOW, WINDOW + 1, 300, 5000])
def test_what_was_missed_is_made_up_for_by_a_proof(ahead: int) -> None:
    receiver, sender = robot(0), robot(ROBOT)
    assert receiver.verify(sender.sign(EmergencyStop(ROBOT, 1, 1, 0)), ROBOT, 0)
    for _ in range(ahead - 1):
        sender.sign(EmergencyStop(ROBOT, 1, 2, 0))
    late = sender.sign(EmergencyStop(ROBOT, 1, 2, 0))
    assert receiver.verify(late, ROBOT, S) == (ahead <= WINDOW)
    if ahead > WINDOW:
        assert introduce(receiver, sender, S)
        assert receiver.verify(sender.sign(late), ROBOT, S)


def test_a_robot_may_begin_again_and_an_operator_may_not() -> None:
    receiver = robot()
    for now_us, sender, again, may in (
        (0, robot(ROBOT), robot(ROBOT, b"next"), True),
        (2 * S, operator(500), operator(3), False),
    ):
        assert introduce(receiver, sender, now_us)
        assert introduce(receiver, again, now_us + S) == may


def test_a_panel_and_a_robot_release_nobody() -> None:
    receiver, panel = robot(), Keyring(Keys(MASTER, None), PANEL, b"")
    assert receiver.verify(panel.sign(EmergencyStop(PANEL, 1, 1, 0)), PANEL, 0)
    assert introduce(receiver, operator(), 0)
    posing = Keyring(Keys(MASTER, MASTER), DEVICE, b"")
    assert not receiver.verify(posing.sign(reset()), DEVICE, 0) and receiver.bad == 1


def test_lock_out_and_its_end() -> None:
    receiver, device = robot(), operator()
    assert introduce(receiver, device, 0)
    for n in range(BAD_MAX):
        assert not receiver.verify(reset()._replace(freshness=1, tag=n), DEVICE, n)
    assert receiver.bad == BAD_MAX
    assert not receiver.verify(device.sign(reset()), DEVICE, BAD_MAX) and receiver.ignored == 1
    assert not introduce(receiver, device, S), "a proof does not end an operator's lock-out"
    later_us = BAD_WINDOW_US + BAD_MAX
    assert introduce(receiver, device, later_us)
    assert receiver.verify(device.sign(reset()), DEVICE, later_us)


def test_nobody_silences_a_robots_stop_with_bad_tags_in_its_name() -> None:
    receiver, sender = robot(0), robot(ROBOT)
    for n in range(BAD_MAX + 1):
        receiver.verify(EmergencyStop(ROBOT, 1, 1, 0, freshness=1, tag=n), ROBOT, n)
    assert receiver.ignored
    assert introduce(receiver, sender, BAD_MAX + 2)
    assert receiver.verify(sender.sign(EmergencyStop(ROBOT, 1, 1, 0)), ROBOT, BAD_MAX + 3)


def test_a_proof_is_for_one_question_one_asker_and_a_short_time() -> None:
    receiver, other, device = robot(0), robot(2), operator()
    question = receiver.ask(DEVICE, 0)
    assert question is not None
    assert receiver.ask(DEVICE, 1) is None, "asked just now"
    proof = device.answer(question, 0)
    assert proof is not None and device.answer(question, 1) is None
    assert other.ask(DEVICE, 0) is not None and not other.prove(proof, 1)
    assert not receiver.prove(proof, NUMBER_LIFE_US), "held back"
    assert introduce(receiver, device, NUMBER_LIFE_US)
    assert not receiver.prove(proof, NUMBER_LIFE_US + 1), "played again"


def test_questions_differ_between_boots() -> None:
    numbers = set()
    for boot in range(20):
        keyring = robot(0, bytes((boot,)))
        for n in range(20):
            question = keyring.ask(DEVICE, n * NUMBER_LIFE_US)
            assert question is not None
            numbers.add(question.number)
    assert len(numbers) == 400


Act = tuple[str, int]
acts = st.lists(
    st.tuples(
        st.sampled_from(
            [
                "send",
                "send",
                "lose",
                "withhold",
                "replay",
                "flip",
                "guess",
                "wait",
                "prove",
                "reboot",
            ]
        ),
        st.integers(0, 1 << 16),
    ),
    max_size=80,
)


@settings(max_examples=examples(300))
@given(acts)
def test_in_any_history_each_frame_is_believed_at_most_once_and_only_if_it_was_sent(
    history: list[Act],
) -> None:
    """An operator, a robot, and an attacker who hears, holds back, replays and changes frames."""
    receiver, device = robot(), operator()
    sent: list[EmergencyReset] = []
    believed: list[EmergencyReset] = []
    now_us, boots = 0, 0
    for what, n in history:
        frame: EmergencyReset | None = None
        now_us += 1000
        if what in ("send", "lose", "withhold"):
            sent.append(device.sign(reset(n & 0xFF)))
            frame = sent[-1] if what == "send" else None
        elif what == "replay" and sent:
            frame = sent[n % len(sent)]
        elif what == "flip" and sent:
            data = bytearray(EMERGENCY_RESET.pack(sent[n % len(sent)]))
            data[n % 8] ^= 1 << (n >> 8) % 8
            frame = EMERGENCY_RESET.unpack(bytes(data))
        elif what == "guess":
            frame = reset()._replace(freshness=n & 0xFF, tag=n)
        elif what == "wait":
            now_us += n * 1000
        elif what == "prove" and (question := receiver.ask(DEVICE, now_us)) is not None:
            proof = device.answer(question, now_us)
            assert proof is None or receiver.prove(proof, now_us) or receiver.ignored
        elif what == "reboot":
            boots += 1
            receiver = robot(0, boots.to_bytes(4, "little"))
        if frame is not None and receiver.verify(frame, DEVICE, now_us):
            assert frame in sent, "nobody sent it"
            believed.append(frame)
    assert len(believed) == len({(f.freshness, f.tag) for f in believed}), "believed twice"


def test_limits_fit_the_wire() -> None:
    assert WINDOW < 128 and authentication.COUNTER_MAX < 1 << 32
    rng: Any = Random(1)
    for _ in range(100):
        counter = rng.randrange(authentication.COUNTER_MAX)
        device = operator(counter)
        receiver = robot()
        assert introduce(receiver, device, 0)
        assert receiver.verify(device.sign(reset()), DEVICE, 0), counter
