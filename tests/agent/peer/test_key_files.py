"""Which keys a robot uses: those of its file, or those that it was given later."""

from random import Random
from types import SimpleNamespace
from typing import Any, cast

import pytest

from agent.interface.config import S
from agent.interface.effects import Persist, Send
from agent.interface.identity import Identity, SilencePolicy
from agent.peer.key_renewal import FLEET_KEYS, RECORD_BEFORE, record
from agent.peer.peer import Peer
from agent.runtime.peer_factory import keyring_of, make_peer
from protocol.authentication import Keys
from protocol.frames.key_frames import KeysHeld
from protocol.name import fleet_name
from protocol.rekeying import ALWAYS_S, NOBODY, Rekeying, own_key, seal

ROBOTS = 3
OLD_ROOT, NEW_ROOT = b"r" * 32, b"n" * 32
ONE = Rekeying(1, b"1" * 16, NOBODY)
TWO = Rekeying(2, b"2" * 16, 2, ALWAYS_S)
OWNER, STRANGER = 200, 99


def file_of(root: bytes, name: bytes = b"m") -> Keys:
    return Keys(name * 16, b"o" * 16, own_key(root, 0))


def robot(keys: Keys, recalled: dict[str, bytes] | None = None) -> Peer:
    identity = Identity(
        0, frozenset(range(ROBOTS)), fleet_name("keys", 0), 1, SilencePolicy.STOP, started=True,
        first_boot=not recalled,
    )  # fmt: skip
    return make_peer(identity, Random(1), 0, recalled or {}, keyring=keyring_of(keys, 0, b"l" * 16))


def master(peer: Peer) -> bytes | None:
    ring = peer.named.keys.authority.keyring
    assert ring is not None
    return ring.keys.master


class Owner:
    """Says to a robot what the tool of the owner says, or a recording of it."""

    def __init__(self, peer: Peer) -> None:
        self.keys, self.now_us = peer.named.keys, 10 * S

    def _ctx(self) -> tuple[Any, int]:
        self.now_us += S
        return cast(Any, SimpleNamespace(now_us=self.now_us)), self.now_us

    def give(self, rekeying: Rekeying, source: int = OWNER) -> list[int]:
        """The generations that the robot confirms."""
        said: list[Any] = []
        for part in seal(rekeying, own_key(OLD_ROOT, 0), 0):
            ctx, _ = self._ctx()
            said += self.keys._hear_part(ctx, cast(Any, SimpleNamespace(source=source)), part)
        return _held(said)

    def switch(self, rekeying: Rekeying) -> list[Any]:
        ctx, _ = self._ctx()
        header = cast(Any, SimpleNamespace(source=OWNER))
        return list(self.keys._hear_switch(ctx, header, rekeying.switch()))


def _held(said: list[Any]) -> list[int]:
    messages = [e.message for e in said if isinstance(e, Send)]
    return [m.generation for m in messages if isinstance(m, KeysHeld)]


def given_before(revoked: frozenset[int] = frozenset()) -> dict[str, bytes]:
    made = record(ONE, revoked, own_key(OLD_ROOT, 0))
    return {made.key: made.value}


def test_keys_that_were_given_later_are_used_after_a_restart() -> None:
    assert master(robot(file_of(OLD_ROOT), given_before())) == ONE.keys.master


def test_new_key_files_end_the_keys_that_were_given_before() -> None:
    """Found by a review: `headland keys new` was ignored by robots that had ever been given keys, so a
    stolen operator's key went on to command them."""
    new = file_of(NEW_ROOT, b"x")
    peer = robot(new, given_before(frozenset({1})))
    assert master(peer) == new.master
    assert peer.named.keys.generation == 0
    assert sorted(peer.membership.standing) == [1, 2], "what was revoked was another robot"


def test_a_record_of_an_earlier_version_still_counts() -> None:
    raw = RECORD_BEFORE.pack(ONE.generation, ONE.secret, bytes(16))
    assert master(robot(file_of(OLD_ROOT), {FLEET_KEYS: raw})) == ONE.keys.master


@pytest.mark.parametrize("source", [OWNER, STRANGER])
def test_recorded_parts_of_an_older_generation_replace_no_newer_ones(source: int) -> None:
    """Found by a review: the switch to the newer keys passed the robot by, and a recorded switch to the
    older ones brought back the keys of a thief."""
    owner = Owner(robot(file_of(OLD_ROOT)))
    assert owner.give(TWO) == [2]
    assert owner.give(ONE, source) == []
    assert _held(owner.switch(TWO)) == [2] and owner.keys.generation == 2
    assert owner.switch(ONE) == [] and owner.keys.generation == 2


def test_an_owner_that_begins_again_may_use_a_number_twice() -> None:
    owner = Owner(robot(file_of(OLD_ROOT)))
    assert owner.give(TWO) == [2]
    other = TWO._replace(secret=b"3" * 16)
    assert owner.give(other) == [2]
    assert _held(owner.switch(other)) == [2]


def test_a_robot_that_restarted_confirms_the_keys_that_it_uses() -> None:
    """Found by a review: not after a revocation, because it remembers only that, not in which keys."""
    owner = Owner(robot(file_of(OLD_ROOT)))
    owner.give(TWO)
    kept = [e for e in owner.switch(TWO) if isinstance(e, Persist)]
    again = Owner(robot(file_of(OLD_ROOT), {e.key: e.value for e in kept if e.value}))
    assert again.keys.generation == 2 and again.give(TWO) == [2]
