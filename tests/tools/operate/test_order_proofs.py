"""A desk of transport orders whose keys are rotated, or whose key ends, while it works."""

from datetime import date, timedelta
from pathlib import Path

import pytest

from agent.runtime.files.key_file import (
    EPOCH,
    FLEET,
    NAMES,
    OPERATOR,
    KeyFileError,
    create,
    fresh,
    operator_path,
    operator_text,
    read,
    write,
)
from agent.runtime.files.key_folder import owned
from protocol.authentication import Keys
from protocol.frame_proofs import FIRST, FleetTime, ProofChecker, ProofKeys, TimeAnswers
from protocol.frames.delivery_frames import TaskOrder
from protocol.frames.trust_frames import OperatorBadge, Proof, TimeQuestion
from protocol.operator_badges import DAY_S, Badge, BadgeBook, Role
from protocol.rekeying import NOBODY
from tools.operate.order_proofs import FileProofs

DAY = (date(2026, 6, 1) - EPOCH) // timedelta(days=1)
DEVICE, ADDRESS = 205, 250
ORDER = TaskOrder(7, 1, 2)


class Robot:
    """What a robot with these keys believes of a desk."""

    def __init__(self, keys: Keys) -> None:
        self.keys, self.now_us = keys, 0
        self.book, self.time = BadgeBook(DAY * DAY_S), FleetTime(FIRST, 0)
        self.time.known = True
        self.proof_keys = ProofKeys(keys, self.book)
        self.checker = ProofChecker(self.proof_keys, self.time)

    def rekey(self, keys: Keys) -> None:
        self.keys = keys
        self.book.forget()
        self.checker.rekey(keys)
        self.time.begin(self.proof_keys, self.now_us)

    def believes(self, desk: FileProofs, tries: int = 4) -> bool:
        """Whether it takes an order that the desk repeats, as desks do."""
        for _ in range(tries):
            self.now_us += 500_000
            self.checker.hold(ADDRESS, ORDER, self.now_us)
            for message in desk.after(ORDER, ADDRESS, self.now_us):
                if isinstance(message, OperatorBadge):
                    self.book.hear(message, self.now_us)
                elif isinstance(message, TimeQuestion):
                    answers = TimeAnswers(self.proof_keys)
                    for half in answers.halves(message, self.time.at(self.now_us)):
                        desk.hear(1, half, self.now_us)
                elif isinstance(message, Proof):
                    found = self.checker.verify(ADDRESS, message, self.now_us)
                    if found is not None and found.messages == (ORDER,):
                        return True
        return False


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "keys"
    made.mkdir(mode=0o700)
    write(made / NAMES[FLEET], made / NAMES[OPERATOR], fresh(), 249, range(2))
    return made


def person(folder: Path, roles: Role, expires_day: int) -> Path:
    owner, path = read(folder, OPERATOR), operator_path(folder, DEVICE)
    create(path, operator_text(owner, Badge(DEVICE, roles, expires_day), "Anna"))
    return path


def robot_of(folder: Path) -> Robot:
    fleet = read(folder, FLEET).keys
    return Robot(fleet)


@pytest.mark.parametrize("kind", [FLEET, OPERATOR])
def test_a_desk_goes_on_with_the_new_keys_after_a_rotation(folder: Path, kind: str) -> None:
    robot, desk = robot_of(folder), FileProofs(folder, kind)
    assert robot.believes(desk)
    keys = owned(folder)
    rekeying = keys.begin(NOBODY, 0)
    robot.rekey(rekeying.keys)
    assert not robot.believes(desk), "the robots have switched, the files not yet"
    keys.finish(rekeying)
    assert robot.believes(desk)


def test_a_persons_desk_goes_on_after_a_rotation(folder: Path) -> None:
    robot, desk = robot_of(folder), FileProofs(person(folder, Role.TASK, DAY + 10), clock=at(DAY))
    assert robot.believes(desk)
    keys = owned(folder)
    rekeying = keys.begin(NOBODY, 0)
    robot.rekey(rekeying.keys)
    keys.finish(rekeying)
    assert robot.believes(desk)


def at(day: int) -> "Clock":
    return Clock(day * DAY_S)


class Clock:
    """The date of the desk."""

    def __init__(self, now_s: float) -> None:
        self.now_s = now_s

    def __call__(self) -> float:
        return self.now_s


def test_a_desk_proves_no_order_after_the_end_of_its_key_and_says_so_once(folder: Path) -> None:
    clock, lines = at(DAY), list[str]()
    path = person(folder, Role.TASK | Role.STOP, DAY + 1)
    desk, robot = FileProofs(path, told=lines.append, clock=clock), robot_of(folder)
    assert robot.believes(desk) and not lines
    clock.now_s += DAY_S
    assert desk.after(ORDER, ADDRESS, 0) == [] and desk.after(ORDER, ADDRESS, 1) == []
    assert not robot.believes(desk)
    (line,) = lines
    assert "no transport order is proven" in line and "expired" in line
    path.unlink()
    person(folder, Role.TASK, DAY + 9)  # the owner makes a new one
    assert robot.believes(desk)
    assert "proven again" in lines[1]


def test_a_desk_whose_new_file_allows_no_orders_proves_none(folder: Path) -> None:
    lines: list[str] = []
    path = person(folder, Role.TASK, DAY + 9)
    desk = FileProofs(path, told=lines.append, clock=at(DAY))
    path.unlink()
    person(folder, Role.STOP, DAY + 9)
    assert not robot_of(folder).believes(desk)
    assert "it is for stop, and this needs task" in lines[0]
    with pytest.raises(KeyFileError, match="needs task"):
        FileProofs(path, clock=at(DAY))


def test_a_desk_whose_file_others_may_read_proves_no_order(folder: Path) -> None:
    lines: list[str] = []
    path = person(folder, Role.TASK, DAY + 9)
    desk = FileProofs(path, told=lines.append, clock=at(DAY))
    path.unlink()
    person(folder, Role.TASK, DAY + 9)
    path.chmod(0o644)
    assert desk.after(ORDER, ADDRESS, 0) == []
    assert "others may read it" in lines[0]
