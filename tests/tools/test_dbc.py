"""A recorded run, read by cantools alone with the DBC we write, against what our codec reads."""

from collections import Counter
from pathlib import Path
from random import Random
from typing import Any

import pytest

from agent.lifecycle import State
from protocol.codec import Malformed, decode, encode
from protocol.fleet_frames import Member
from protocol.frame import Frame
from protocol.identifier import Identifier
from protocol.messages import GROUPS, Message
from protocol.signals import SIGNALS, STATE
from sim.candump import read_candump
from sim.expedition import Expedition
from sim.scenario import load
from sim.setting import Setting
from tools.dbc import pgn_key, to_dbc

cantools = pytest.importorskip("cantools", reason="cantools is not installed")


@pytest.fixture(scope="module")
def by_group() -> dict[int, Any]:
    database = cantools.database.load_string(to_dbc(), "dbc")
    assert all(m.protocol == "j1939" for m in database.messages)
    return {pgn_key(m.frame_id): m for m in database.messages}


@pytest.fixture(scope="module")
def short_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """From boot into the work: what comes later is of the same kinds."""
    out = tmp_path_factory.mktemp("run")
    scenario = load("small").changed(3, 1)
    limit = scenario.run.model_copy(update={"time_limit_s": 60.0})
    Expedition(Setting(scenario.model_copy(update={"run": limit})), out).run()
    return out


def flat(message: Message) -> dict[str, float]:
    """Our fields under the names of signals; fields of several bytes one by one."""
    values: dict[str, float] = {}
    for name, value in message._asdict().items():
        if isinstance(value, bytes | tuple):
            values |= {f"{name}_{k}": part for k, part in enumerate(value)}
        else:
            values[name] = float(value)
    return values


def compare(identifier: int, data: bytes, by_group: dict[int, Any]) -> str:
    _, ours = decode(Frame(identifier, data))
    assert not isinstance(ours, Malformed), (hex(identifier), data.hex(), ours)
    definition = by_group[pgn_key(identifier)]
    theirs = definition.decode(data, decode_choices=False)
    ours_flat = flat(ours)
    assert theirs.keys() == ours_flat.keys()
    for name, value in theirs.items():
        assert value == pytest.approx(ours_flat[name], abs=1e-9), (definition.name, name)
    return str(definition.name)


def test_random_frames_of_every_kind_read_alike(by_group: dict[int, Any]) -> None:
    rng, read = Random(1), Counter[str]()
    for group in GROUPS:
        while read[group.name] < 50:
            data = rng.randbytes(group.length)
            identifier = Identifier(group.priority, group.pgn, 255, rng.randrange(254)).pack()
            if not isinstance(decode(Frame(identifier, data))[1], Malformed):
                read[compare(identifier, data, by_group)] += 1
    assert read.keys() == {group.name for group in GROUPS}


def test_a_recorded_run_reads_alike(by_group: dict[int, Any], short_run: Path) -> None:
    read = Counter(
        compare(frame.identifier, frame.data, by_group)
        for _, frame in read_candump(short_run / "can.log")
    )
    for kind in ("POSE", "HEARTBEAT", "TASK_CLAIM", "WORK_PROGRESS", "ADDRESS_CLAIMED", "MEMBER"):
        assert read[kind] > 0, kind


def test_states_are_the_agents() -> None:
    assert tuple((int(state), state.name) for state in State) == STATE


def test_encoded_frames_have_the_identifier_of_their_group(by_group: dict[int, Any]) -> None:
    frame = encode(Member(1, 1, 5), 130)
    assert by_group[pgn_key(frame.identifier)].name == "MEMBER"
    assert {signal.name for signal in SIGNALS[Member]} == {*Member._fields}
