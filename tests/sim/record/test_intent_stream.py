"""Intents beside the bus: there and back; any bytes at all without an exception."""

import tracemalloc
from math import inf, nan
from random import Random
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.interface.config import NEIGHBOURS_MAX, PEERS_MAX
from agent.safety.stop_cause import StopCause
from sim.record.intent_stream import BYTES_MAX, MAGIC_INTENT, intent_bytes, read_intent
from sim.record.robot_intent import POINTS_MAX, STRANGE_MAX, Intent

metres = st.floats(-3276, 3276)
points = st.tuples(metres, metres)
slots = st.integers(0, PEERS_MAX - 1)
intents = st.builds(
    Intent, slots, metres, metres, metres, metres, metres, points,
    st.lists(points, max_size=POINTS_MAX).map(tuple),
    st.lists(slots, max_size=NEIGHBOURS_MAX).map(tuple),
    st.lists(slots, max_size=PEERS_MAX).map(tuple),
    st.lists(points, max_size=STRANGE_MAX).map(tuple),
    st.lists(st.sampled_from([cause.name for cause in StopCause]), max_size=22).map(tuple),
    st.booleans(),
)  # fmt: skip
FULL = Intent(
    107, -1234.567, 2345.678, 1.234, 9.876, -9.876, (1.5, -2.5), ((-1234.56, 2345.67),) * POINTS_MAX,
    tuple(range(90, 90 + NEIGHBOURS_MAX)), tuple(range(PEERS_MAX)), ((-1234.56, 2345.67),) * STRANGE_MAX,
    tuple(cause.name for cause in StopCause), True,
)  # fmt: skip


@given(intents)
def test_there_and_back(intent: Intent) -> None:
    assert read_intent(intent_bytes(intent)) == intent.to_dict()


def test_the_longest_intent_fits() -> None:
    assert len(intent_bytes(FULL)) <= BYTES_MAX
    assert read_intent(intent_bytes(FULL)) == FULL.to_dict()


@given(st.binary(max_size=200), st.booleans())
def test_any_bytes_are_no_intent(noise: bytes, headed: bool) -> None:
    assert read_intent(MAGIC_INTENT + noise if headed else noise) is None


@pytest.mark.parametrize(
    ("field", "wrong"),
    [
        ("slot", 256), ("slot", -1), ("slot", True), ("slot", 1.0), ("x", nan), ("y", inf),
        ("heading", "1"), ("vx", None), ("vy", True), ("wanted", [1.0]), ("wanted", [1.0, 2.0, 3.0]),
        ("path", [[1.0, 2.0]] * (POINTS_MAX + 1)), ("path", [1.0]), ("path", {}), ("avoids", [0.5]),
        ("avoids", [1] * (NEIGHBOURS_MAX + 1)), ("hears", [-1]), ("strange", [[nan, 0.0]]),
        ("holds", [1]), ("holds", ["x" * 65]), ("holds", "CREEP"), ("tool", 1),
    ],
)  # fmt: skip
def test_a_value_of_another_kind_is_no_intent(field: str, wrong: Any) -> None:
    plain = {**FULL.to_dict(), field: wrong}
    assert read_intent(MAGIC_INTENT + msgpack.packb(list(plain.values()))) is None


def test_what_follows_or_lacks_makes_it_no_intent() -> None:
    whole = intent_bytes(FULL)
    assert read_intent(whole + b"\0") is None
    assert all(read_intent(whole[:n]) is None for n in range(len(whole)))


@pytest.mark.slow
def test_hostile_bytes_neither_raise_nor_fill_memory() -> None:
    rng, read = Random(12), 0
    small = FULL._replace(path=((1.0, 2.0),), hears=(1, 2), strange=(), holds=("CREEP",))
    seeds = [
        intent_bytes(small),
        MAGIC_INTENT + b"\x9d" * 3000,
        MAGIC_INTENT + b"\xdc\0\x6c" * 1000,
    ]
    tracemalloc.start()
    for n in range(100_000):
        data = bytearray(seeds[0] if n % 100 else rng.choice(seeds[1:]))
        for _ in range(rng.randrange(1, 4)):
            at = rng.randrange(4, len(data))
            match rng.randrange(3):
                case 0:
                    data[at] = rng.randrange(256)
                case 1:
                    del data[at]
                case 2:
                    data[at:at] = rng.randbytes(rng.randrange(1, 4))
        read += read_intent(bytes(data)) is not None
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert 0 < read < 100_000
    assert peak < 4 << 20
