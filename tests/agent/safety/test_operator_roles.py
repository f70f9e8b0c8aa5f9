"""Roles and expiry of operators' keys, checked by a robot at each act."""

from collections.abc import Sequence
from random import Random

import pytest

from agent.interface.config import MS, S
from agent.interface.effects import Effect, Send
from agent.interface.identity import Identity, SilencePolicy
from agent.peer.inputs import DateTold
from agent.runtime import peer_factory
from agent.safety.command_authentication import NEEDS, CommandAuthority, role_for
from protocol.authentication import BAD_MAX, BAD_WINDOW_US, WINDOW, AnySigned, Keyring, Keys
from protocol.frame_proofs import FIRST, FleetTime, ProofChecker, ProofKeys, TimeAnswers, ToolProofs
from protocol.frames.delivery_frames import TaskOrder
from protocol.frames.operator_frames import OperatorGoal
from protocol.frames.safety_frames import (
    Challenge,
    Command,
    EmergencyReset,
    EmergencyStop,
    HeldReset,
    OperatorCommand,
)
from protocol.frames.trust_frames import OperatorBadge, Proof, TimeQuestion
from protocol.name import fleet_name
from protocol.operator_badges import (
    ALL_ROLES,
    DAY_S,
    NEVER,
    PROVEN_FOR_US,
    Badge,
    BadgeBook,
    Role,
)

FLEET = Keys(bytes(range(16)), bytes(range(16, 32)))
assert FLEET.operator is not None
ROBOT, DEVICE, TODAY = 3, 201, 20_000
SAID: dict[str, AnySigned] = {
    "stop": EmergencyStop(DEVICE, 1, 1, 0),
    "reset": EmergencyReset(1, 1, 1, DEVICE),
    "held reset": HeldReset(77, DEVICE),
    "goal": OperatorGoal(5, DEVICE, 300, False),
    **{each.name: OperatorCommand(each, 255, DEVICE) for each in Command},
}


def authority(day: int | None = TODAY) -> CommandAuthority:
    clock_zero_at_s = None if day is None else day * DAY_S
    return CommandAuthority(
        ROBOT, Keyring(FLEET, ROBOT, b"boot", badges=BadgeBook(clock_zero_at_s))
    )


def device(badge: Badge, sent: int = 0) -> Keyring:
    assert FLEET.operator is not None
    own = Keys(None, badge.secret(FLEET.operator))
    return Keyring(own, badge.device, b"session", sent, badge)


def introduce(robot: CommandAuthority, person: Keyring, now_us: int = 0) -> None:
    """The robot challenges, and the device tells its badge and proves its counter."""
    (question,) = sent(robot.ask(person.sender, now_us))
    assert isinstance(question, Challenge)
    proof = person.answer(question, now_us)
    assert proof is not None
    if person.badge is not None:  # the owner tells none
        robot.hear_badge(person.badge.told(), now_us)
    robot.prove(proof, now_us)


def sent(effects: Sequence[Effect]) -> list[object]:
    return [effect.message for effect in effects if isinstance(effect, Send)]


def signed(person: Keyring, message: AnySigned) -> AnySigned:
    return person.sign(message)  # type: ignore[type-var]


@pytest.mark.parametrize("what", SAID)
@pytest.mark.parametrize("role", Role)
def test_each_act_needs_its_role(what: str, role: Role) -> None:
    robot, person, message = authority(), device(Badge(DEVICE, role, TODAY + 1)), SAID[what]
    introduce(robot, person)
    may = bool(role_for(message) & role)
    assert robot.believes(signed(person, message), DEVICE, 1000) is may
    assert robot.forbidden == (not may)


def test_what_makes_a_fleet_move_again_is_not_for_those_who_may_only_stop_or_order() -> None:
    for command in (Command.MANUAL_RESET, Command.WAIVE):
        assert NEEDS[command] == Role.RELEASE
    assert not NEEDS[Command.START] & (Role.STOP | Role.TASK)


def test_more_roles_cannot_be_claimed() -> None:
    robot, person = authority(), device(Badge(DEVICE, Role.STOP, TODAY + 1))
    liar = person
    liar.badge = Badge(DEVICE, ALL_ROLES, NEVER)
    introduce(robot, liar)
    assert not robot.believes(signed(liar, SAID["reset"]), DEVICE, 1000)
    assert robot.keyring is not None and robot.keyring.bad


@pytest.mark.parametrize("day", [TODAY, TODAY + 1, None])
def test_a_key_that_expired_or_whose_day_is_unknown_releases_nothing(day: int | None) -> None:
    robot, person = authority(day), device(Badge(DEVICE, ALL_ROLES, TODAY))
    introduce(robot, person)
    assert not robot.believes(signed(person, SAID["reset"]), DEVICE, 1000)
    assert robot.keyring is not None and robot.keyring.expired


def test_a_key_expires_while_it_is_used() -> None:
    robot, person = authority(TODAY), device(Badge(DEVICE, ALL_ROLES, TODAY + 1))
    introduce(robot, person, DAY_S * S - 2 * S)
    assert robot.believes(signed(person, SAID["reset"]), DEVICE, DAY_S * S - S)
    assert not robot.believes(signed(person, SAID["reset"]), DEVICE, DAY_S * S)


def test_the_owner_needs_no_badge_and_no_date() -> None:
    robot, owner = authority(None), Keyring(Keys(None, FLEET.operator), 249, b"session")
    (question,) = sent(robot.ask(249, 0))
    assert isinstance(question, Challenge)
    proof = owner.answer(question, 0)
    assert proof is not None
    robot.prove(proof, 0)
    assert robot.believes(owner.sign(EmergencyReset(1, 1, 1, 249)), 249, 1000)


def test_a_badge_in_a_persons_name_ends_no_session_and_the_next_challenge_repairs_it() -> None:
    robot, person = authority(), device(Badge(DEVICE, Role.RELEASE, TODAY + 1))
    introduce(robot, person)
    robot.hear_badge(OperatorBadge(DEVICE, int(Role.TASK), 1), 1000)
    assert robot.believes(signed(person, SAID["reset"]), DEVICE, 2000)
    later_us = 3 * PROVEN_FOR_US
    robot.hear_badge(OperatorBadge(DEVICE, int(Role.TASK), 0), later_us)
    assert not robot.believes(signed(person, SAID["reset"]), DEVICE, later_us)
    introduce(robot, person, later_us + S)
    assert robot.believes(signed(person, SAID["reset"]), DEVICE, later_us + S)


def test_a_flood_of_badges_costs_little_memory() -> None:
    robot = authority()
    assert robot.keyring is not None
    for number in range(20_000):
        told = OperatorBadge(192 + number % 63, number % 16, number % 65_536)
        robot.hear_badge(told, number)
        signature = EmergencyReset(1, 1, 1, told.device, number & 0xFF, number)
        robot.believes(signature, told.device, number)
    assert len(vars(robot.keyring.badges)["_of"]) <= 63
    assert len(vars(robot.keyring)["_macs"]) <= 512


@pytest.mark.parametrize("roles", [Role.TASK, Role.STOP | Role.RELEASE])
def test_a_transport_order_is_proven_by_a_key_of_its_badge(roles: Role) -> None:
    badge = Badge(DEVICE, roles, TODAY + 1)
    assert FLEET.operator is not None
    tool = ToolProofs(Keys(None, badge.secret(FLEET.operator)), DEVICE, b"lot", badge)
    book, time = BadgeBook(TODAY * DAY_S), FleetTime(FIRST, 0)
    time.known = True
    keys = ProofKeys(FLEET, book)
    robot, order = ProofChecker(keys, time), TaskOrder(7, 1, 2)
    for message in tool.after(order, 250, 0):
        if isinstance(message, OperatorBadge):
            book.hear(message, 0)
        if isinstance(message, TimeQuestion):
            for half in TimeAnswers(keys).halves(message, time.at(0)):
                tool.hear(1, half, 0)
    robot.hold(250, order, 1000)
    proof = next(m for m in tool.after(order, 250, 1000) if isinstance(m, Proof))
    found = robot.verify(250, proof, 1000)
    assert found is not None and found.messages == (order,)
    assert book.allows(DEVICE, Role.TASK, 1000) is bool(roles & Role.TASK)


def owner(sent: int = 0) -> Keyring:
    return Keyring(Keys(None, FLEET.operator), DEVICE, b"session", sent)


@pytest.mark.parametrize("roles", [0, int(Role.STOP), int(ALL_ROLES)])
def test_a_badge_in_the_owners_name_does_not_lock_the_owner_out(roles: int) -> None:
    """One such frame, and no robot believed the owner until it was switched off: the owner tells no
    badge, so none repaired it."""
    robot, person = authority(), owner()
    for second in range(5):
        now_us = 20 * second * S
        robot.hear_badge(OperatorBadge(DEVICE, roles, 1 + second), now_us)
        assert not robot.believes(signed(person, SAID["reset"]), DEVICE, now_us)
        introduce(robot, person, now_us)
        assert robot.believes(signed(person, SAID["reset"]), DEVICE, now_us + 1)


def test_a_badge_between_a_persons_badge_and_its_proof_spoils_no_proof() -> None:
    robot, person = authority(), device(Badge(DEVICE, Role.RELEASE, TODAY + 1))
    (question,) = sent(robot.ask(DEVICE, 0))
    assert isinstance(question, Challenge)
    proof = person.answer(question, 0)
    assert person.badge is not None and proof is not None
    robot.hear_badge(person.badge.told(), 0)
    robot.hear_badge(OperatorBadge(DEVICE, int(ALL_ROLES), 1), 1)
    robot.prove(proof, 2)
    assert robot.believes(signed(person, SAID["reset"]), DEVICE, 3)
    assert not robot.believes(signed(person, SAID["GO_HOME"]), DEVICE, 5), "with its own roles"


def test_two_badges_in_the_owners_name_do_not_lock_the_owner_out() -> None:
    """The badge before the last one is then a forged one, too."""
    robot, person = authority(), owner()
    for expires_day in (1, 2):
        robot.hear_badge(OperatorBadge(DEVICE, int(ALL_ROLES), expires_day), 0)
    introduce(robot, person)
    assert robot.believes(signed(person, SAID["reset"]), DEVICE, 1)


def test_a_stop_with_a_bad_tag_is_not_believed_while_bad_tags_hold_back_a_release() -> None:
    robot, person = authority(), owner()
    introduce(robot, person)
    for tag in range(3 * BAD_MAX):
        bad = EmergencyReset(1, 1, 1, DEVICE, 1 + tag & 0xFF, tag)
        robot.believes(bad, DEVICE, S + tag)
    introduce(robot, person, 2 * S)
    stop = person.sign(EmergencyStop(DEVICE, 1, 1, 0))
    assert not robot.believes(stop._replace(tag=stop.tag ^ 1), DEVICE, 2 * S + 1)
    assert robot.believes(stop, DEVICE, 2 * S + 2)


@pytest.mark.parametrize("badge", [None, Badge(DEVICE, Role.STOP | Role.RELEASE, TODAY + 1)])
def test_bad_tags_in_an_operators_name_hold_back_a_release_and_no_stop(badge: Badge | None) -> None:
    """Eight bad tags in ten seconds, and a person's stop latched nothing: it braked while it was said."""
    robot, person = authority(), owner() if badge is None else device(badge)
    ring = robot.keyring
    assert ring is not None
    introduce(robot, person)
    now_us = S
    for tag in range(3 * BAD_MAX):
        now_us += 100 * MS
        bad = EmergencyReset(1, 1, 1, DEVICE, 1 + tag & 0xFF, tag)
        robot.believes(bad, DEVICE, now_us)
    assert ring.ignored
    assert not robot.believes(signed(person, SAID["stop"]), DEVICE, now_us)
    introduce(robot, person, now_us + 1)
    for press in range(2 * WINDOW):
        stop = signed(person, SAID["stop"])
        assert robot.believes(stop, DEVICE, now_us + 2 + press)
        assert not robot.believes(stop, DEVICE, now_us + 2 + press), "once"
        assert not robot.believes(signed(person, SAID["reset"]), DEVICE, now_us + 2 + press)
    later_us = now_us + 2 * BAD_WINDOW_US
    introduce(robot, person, later_us)
    assert robot.believes(signed(person, SAID["reset"]), DEVICE, later_us)


@pytest.mark.parametrize("day_at_start", [None, TODAY - 60])
def test_a_date_that_the_computer_learns_later_ends_badges(day_at_start: int | None) -> None:
    """Found by a review: a robot took the date once, at its start. On a computer without a battery, the
    keys of a person who had left were believed for as long as it ran."""
    robot = authority(day_at_start)
    assert robot.keyring is not None
    person = device(Badge(DEVICE, ALL_ROLES, TODAY - 30))
    robot.keyring.badges.correct(TODAY * DAY_S)
    introduce(robot, person, S)
    reset = signed(person, SAID["MANUAL_RESET"])
    assert not robot.believes(reset, DEVICE, S)
    robot.keyring.badges.correct((TODAY - 60) * DAY_S)
    robot.keyring.badges.correct(None)
    assert robot.keyring.badges.day(0) == TODAY, "it never goes back"


def test_a_robot_is_told_the_date_and_an_impossible_one_is_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    identity = Identity(
        0,
        frozenset({0, 1}),
        fleet_name("date", 0),
        1,
        SilencePolicy.STOP,
        started=True,
        first_boot=True,
    )
    monkeypatch.setattr(peer_factory, "time", lambda: 1000.0)
    assert peer_factory.clock_zero_at_s(5 * S) is None, "a clock that began with the computer"
    ring = peer_factory.keyring_of(FLEET, 0, b"lot", peer_factory.clock_zero_at_s(5 * S))
    peer = peer_factory.make_peer(identity, Random(1), 0, keyring=ring)
    assert ring is not None and ring.badges.day(0) is None
    today_s = float(peer_factory.KNOWN_FROM_S + DAY_S)
    monkeypatch.setattr(peer_factory, "time", lambda: today_s)
    peer.step(DateTold(peer_factory.clock_zero_at_s(5 * S)), 5 * S)
    assert ring.badges.day(5 * S) == today_s // DAY_S
