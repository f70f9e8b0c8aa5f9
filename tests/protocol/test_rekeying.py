"""New keys for a fleet: only the robot that they are for can open them, and only they switch it."""

from hypothesis import given
from hypothesis import strategies as st

from protocol.authentication import KEY_SIZE
from protocol.frames.key_frames import PART_BYTES, KeyPart
from protocol.rekeying import (
    AHEAD_MAX,
    CONTENT,
    PARTS,
    TAG_SIZE,
    PartsOf,
    Rekeying,
    confirmed,
    own_key,
    seal,
)

ROOT = bytes(range(KEY_SIZE))
NEW = Rekeying(3, bytes(range(100, 100 + KEY_SIZE)), 2, 60)


def test_a_robot_opens_its_own_parts_in_any_order_and_no_others() -> None:
    parts = seal(NEW, own_key(ROOT, 1), 1)
    assert len(parts) == PARTS
    mine = PartsOf(1, own_key(ROOT, 1))
    assert [mine.hear(200, part) for part in reversed(parts)] == [None] * (PARTS - 1) + [NEW]
    thief = PartsOf(1, own_key(ROOT, 2))  # hears everything, and has another robot's key
    assert [thief.hear(200, part) for part in parts] == [None] * PARTS and thief.bad == 1
    assert [PartsOf(2, own_key(ROOT, 2)).hear(200, part) for part in parts] == [None] * PARTS


@given(st.integers(0, 8 * (CONTENT.size + TAG_SIZE) - 1))
def test_a_changed_part_opens_nothing(at: int) -> None:
    number, bit = divmod(at, 8 * PART_BYTES)
    mine = PartsOf(1, own_key(ROOT, 1))
    for part in seal(NEW, own_key(ROOT, 1), 1):
        if part.part == number:
            data = int.from_bytes(part.data, "little") ^ 1 << bit
            part = part._replace(data=data.to_bytes(len(part.data), "little"))
        assert mine.hear(200, part) is None


def test_a_forger_mixes_no_part_in_from_another_address() -> None:
    mine, parts = PartsOf(1, own_key(ROOT, 1)), seal(NEW, own_key(ROOT, 1), 1)
    found = []
    for part in parts:
        for address in (201, 202):
            mine.hear(address, KeyPart(1, 3, part.part, b"forged"))
        found.append(mine.hear(200, part))
    assert found[-1] == NEW


def test_all_keys_of_a_generation_differ_and_come_from_its_secret() -> None:
    other = NEW._replace(secret=ROOT)
    assert NEW.keys.master != NEW.keys.operator != other.keys.operator
    assert NEW.keys.generation == 3 and NEW.generation <= AHEAD_MAX
    assert NEW.switch() != other.switch() and NEW.switch() != NEW._replace(generation=4).switch()


def test_only_who_holds_the_secret_confirms_it() -> None:
    heard = [NEW.held(1, False), NEW.held(4, True), NEW.held(5, True)._replace(slot=6),
             NEW._replace(secret=ROOT).held(7, True)]  # fmt: skip
    assert confirmed(NEW, heard, switched=False) == {1, 4}
    assert confirmed(NEW, heard, switched=True) == {4}
