"""A session with a task controller, byte by byte as ISO 11783-10 has it, in versions 3 and 4."""

from struct import calcsize, unpack_from
from typing import Any

import pytest

from protocol.device_description import VALUES, WORK_STATE, DeviceDescription
from protocol.name import fleet_name
from protocol.task_client import (
    JoinWorkingSet,
    SessionMessage,
    SessionOutput,
    SessionState,
    TaskClient,
)
from protocol.units import MS, S

SERVER = 247  # an address
NAME = fleet_name("tasks", 3)
DEVICE = DeviceDescription(NAME, "robot 3", "1.2.3", 4000)
STATUS = bytes.fromhex("FEFFFFFF01FFFFFF")  # of the task controller: a task is active
VALUES_NOW: dict[tuple[int, int], int] = {(1, WORK_STATE): 1, (0, 397): 1500, (1, 117): 0}


def parsed(pool: bytes, version: int) -> dict[int, tuple[str, dict[str, Any]]]:
    """The objects of a pool by their number, read by the tables of annex A."""
    objects: dict[int, tuple[str, dict[str, Any]]] = {}
    at = 0

    def take(form: str) -> Any:
        nonlocal at
        (value,) = unpack_from("<" + form, pool, at)
        at += calcsize("<" + form)
        return value

    def text() -> str:
        length = take("B")
        return bytes(take("B") for _ in range(length)).decode()

    while at < len(pool):
        kind, number = bytes(take("B") for _ in range(3)).decode(), take("H")
        found: dict[str, Any] = {}
        if kind == "DVC":
            found |= {"designator": text(), "software": text(), "name": take("Q"), "serial": text()}
            found |= {"label": bytes(take("B") for _ in range(7))}
            found |= {"localization": bytes(take("B") for _ in range(7))}
            if version >= 4:
                found["extended"] = text()
        elif kind == "DET":
            found |= {"type": take("B"), "designator": text(), "element": take("H")}
            found |= {"parent": take("H"), "children": [take("H") for _ in range(take("H"))]}
        elif kind == "DPD":
            found |= {"ddi": take("H"), "properties": take("B"), "triggers": take("B")}
            found |= {"designator": text(), "unit": take("H")}
        elif kind == "DPT":
            found |= {"ddi": take("H"), "value": take("i"), "designator": text(), "unit": take("H")}
        else:
            assert kind == "DVP", kind
            found |= {
                "offset": take("i"),
                "scale": take("f"),
                "decimals": take("B"),
                "unit": text(),
            }
        assert number not in objects
        objects[number] = kind, found
    return objects


@pytest.mark.parametrize("version", [3, 4])
def test_the_pool_is_whole(version: int) -> None:
    objects = parsed(DEVICE.pool(version), version)
    kinds = [kind for kind, _ in objects.values()]
    assert kinds[0] == "DVC" and kinds.count("DVC") == 1 and kinds.count("DET") == 3
    device = objects[0][1]
    assert device["name"] == NAME.pack() and device["designator"] == "robot 3"
    assert device["label"] == DEVICE.label and device["localization"][:2] == b"en"
    for kind, found in objects.values():
        if kind == "DET":
            assert found["parent"] in objects and all(
                child in objects for child in found["children"]
            )
        if found.get("unit") not in (None, 0xFFFF) and kind != "DVP":
            assert objects[found["unit"]][0] == "DVP"
    referenced = {c for k, found in objects.values() if k == "DET" for c in found["children"]}
    assert {n for n, (k, _) in objects.items() if k in ("DPD", "DPT")} == referenced
    widths = [f["value"] for k, f in objects.values() if k == "DPT" and f["ddi"] == 67]
    assert widths == [4000, 4000]


def test_the_label_changes_with_the_description() -> None:
    assert DEVICE.label == DEVICE._replace().label != DEVICE._replace(width_mm=3000).label
    assert len(DEVICE.label) == 7


class Controller:
    """A task controller that answers as the tables say, with what it has stored."""

    def __init__(self, version: int) -> None:
        self.version = version
        self.stored = b""
        self.label = b"\xff" * 7
        self.said: list[bytes] = []
        self.used = False

    def answers(self, data: bytes) -> list[bytes]:
        self.said.append(data)
        language = b"\xff" * 7 if self.label == b"\xff" * 7 else b"en\0\0\0\0\xff"
        kind = data[0]
        if kind == 0x61:
            self.stored = data[1:]
            device = parsed(self.stored, self.version)[0][1]
            self.label = device["label"]
            return [b"\x71\x00" + len(self.stored).to_bytes(4, "little") + b"\xff\xff"]
        fixed = {
            0x00: b"\x10" + bytes((self.version, 0x05, 0x01, 0x00, 0x01, 0x10, 0x01)),
            0x01: b"\x11" + self.label,
            0x21: b"\x31" + language,
            0x41: b"\x51\x00\xff\xff\xff\xff\xff\xff",
            0x81: b"\x91\x00\xff\xff\xff\xff\x00\xff",
            0xA1: b"\xb1\x00\xff\xff\xff\xff\xff\xff",
        }
        self.used = self.used or kind == 0x81
        return [fixed[kind]] if kind in fixed else []


def exchanged(
    client: TaskClient, controller: Controller, out: list[SessionOutput], now_us: int
) -> None:
    """Both talk until nobody has anything to say."""
    while out:
        each = out.pop(0)
        if isinstance(each, SessionMessage):
            for answer in controller.answers(each.data):
                out += client.on_message(SERVER, answer, VALUES_NOW, now_us)


def logged_in(client: TaskClient) -> bool:
    return client.state is SessionState.CONNECTED


def connected(version: int, controller: Controller | None = None) -> tuple[TaskClient, Controller]:
    client, server = TaskClient(DEVICE), controller or Controller(version)
    exchanged(client, server, client.on_message(SERVER, STATUS, VALUES_NOW, 0), 0)
    assert client.state is SessionState.CONNECTED and server.used
    return client, server


@pytest.mark.parametrize("version", [3, 4])
def test_it_logs_in_and_uploads(version: int) -> None:
    client, server = connected(version)
    kinds = [data[0] for data in server.said]
    assert kinds == [0xFF, 0x00, 0x01, 0x41, 0x61, 0x81]
    assert int.from_bytes(server.said[3][1:5], "little") == len(server.stored)
    assert server.said[0] == bytes.fromhex("FFFFFFFF01000000")
    assert client.version == version
    # It asks us, too.
    (told,) = client.on_message(SERVER, b"\x00" + b"\xff" * 7, VALUES_NOW, 0)
    assert told == SessionMessage(bytes((0x10, version, 0xFF, 0x11, 0, 1, 1, 1)))


def test_the_first_thing_is_the_working_set() -> None:
    out = TaskClient(DEVICE).on_message(SERVER, STATUS, VALUES_NOW, 0)
    assert isinstance(out[0], JoinWorkingSet)


def test_a_stored_description_is_only_activated_and_an_old_one_is_replaced() -> None:
    _, server = connected(4)
    server.said.clear()
    connected(4, server)
    assert [data[0] for data in server.said] == [0xFF, 0x00, 0x01, 0x21, 0x81]
    server.said.clear()
    server.label = b"OLDPOOL"
    connected(4, server)
    assert [data[0] for data in server.said] == [0xFF, 0x00, 0x01, 0xA1, 0x41, 0x61, 0x81]


@pytest.mark.parametrize("at", [0x00, 0x01, 0x41, 0x61, 0x81])
def test_a_controller_that_falls_silent_in_the_log_in_is_asked_again(at: int) -> None:
    client, server = TaskClient(DEVICE), Controller(4)
    plain = server.answers
    server.answers = lambda data: [] if data[0] == at else plain(data)  # type: ignore[method-assign]
    exchanged(client, server, client.on_message(SERVER, STATUS, VALUES_NOW, 0), 0)
    assert not logged_in(client)
    now_us = 0
    while client.server is not None:
        now_us += S
        client.on_timer(VALUES_NOW, now_us)
        assert now_us < 40 * S
    server.answers = plain  # type: ignore[method-assign]
    exchanged(client, server, client.on_message(SERVER, STATUS, VALUES_NOW, now_us), now_us)
    assert logged_in(client)


@pytest.mark.parametrize("refusal", ["51 01", "71 01", "91 01"])
def test_a_refusal_ends_the_log_in(refusal: str) -> None:
    client, server = TaskClient(DEVICE), Controller(4)
    plain, wrong = server.answers, bytes.fromhex(refusal).ljust(8, b"\xff")

    def answers(data: bytes) -> list[bytes]:
        return [wrong if answer[0] == wrong[0] else answer for answer in plain(data)]

    server.answers = answers  # type: ignore[method-assign]
    exchanged(client, server, client.on_message(SERVER, STATUS, VALUES_NOW, 0), 0)
    assert client.state is SessionState.WAITING and client.due_at_us is None


@pytest.mark.parametrize("refusal", ["51 01", "71 01", "91 01"])
def test_a_task_controller_that_refuses_a_robot_is_asked_ever_less_often(refusal: str) -> None:
    """It got the whole description at each of its statuses: 3 % of the bus for each robot."""
    client, server = TaskClient(DEVICE), Controller(4)
    plain, wrong = server.answers, bytes.fromhex(refusal).ljust(8, b"\xff")

    def answers(data: bytes) -> list[bytes]:
        said = [wrong if answer[0] == wrong[0] else answer for answer in plain(data)]
        server.label = b"\xff" * 7  # what is refused is not kept
        return said

    server.answers = answers  # type: ignore[method-assign]
    log_ins = []
    for now_us in range(0, 400 * S, 2 * S):
        out = client.on_message(SERVER, STATUS, VALUES_NOW, now_us)
        if any(isinstance(each, JoinWorkingSet) for each in out):
            log_ins.append(now_us // S)
        exchanged(client, server, out, now_us)
        assert client.state is SessionState.WAITING
        client.on_message(SERVER + 1, STATUS[:1] + b"\0" * 7, VALUES_NOW, now_us)
        client.reset()  # the other one does not let it forget
    assert log_ins == [0, 30, 90, 210]
    server.answers = plain  # type: ignore[method-assign]
    again_us = 410 * S  # it was away, and may have been repaired
    exchanged(client, server, client.on_message(SERVER, STATUS, VALUES_NOW, again_us), again_us)
    assert logged_in(client)


def test_eight_hours_without_loss_and_a_new_log_in_after_silence() -> None:
    client, server = connected(4)
    end_us, now_us, statuses = 8 * 3600 * S, 0, 0
    heard_at_us = 0
    while now_us < end_us:
        due_at_us = client.due_at_us
        assert due_at_us is not None
        if heard_at_us + 2 * S <= due_at_us:
            now_us = heard_at_us = heard_at_us + 2 * S
            exchanged(client, server, client.on_message(SERVER, STATUS, VALUES_NOW, now_us), now_us)
        else:
            now_us = due_at_us
        for each in client.on_timer(VALUES_NOW, now_us):
            assert isinstance(each, SessionMessage)
            statuses += each.data[0] == 0xFF
    assert logged_in(client) and client.sessions == 1
    assert statuses == 8 * 1800
    client.on_timer(VALUES_NOW, now_us + 7 * S)
    assert client.server is None
    again_us = now_us + 20 * S
    exchanged(client, server, client.on_message(SERVER, STATUS, VALUES_NOW, again_us), again_us)
    assert client.sessions == 2


def asked(client: TaskClient, text: str, now_us: int = 0) -> list[bytes]:
    """What is sent after these bytes of the task controller."""
    out = client.on_message(SERVER, bytes.fromhex(text), VALUES_NOW, now_us)
    return [each.data for each in out if isinstance(each, SessionMessage)]


def test_values_are_told_when_asked() -> None:
    client, _ = connected(4)
    assert asked(client, "12 00 8D 00 00000000") == [bytes.fromhex("13008D0001000000")]
    assert asked(client, "02 00 8D 01 00000000") == [bytes.fromhex("03008D01DC050000")]
    default = asked(client, "02 00 FF DF 00000000")
    told = {int.from_bytes(data[2:4], "little") for data in default}
    assert told == {value.ddi for value in VALUES if value.properties & 1}


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        ("22 01 8D 00 00000000", 2),  # no such element
        ("12 00 01 00 00000000", 4),  # no such value of it
        ("02 00 01 00 00000000", 4),
        ("22 00 01 00 00000000", 4),
        ("13 00 8D 00 00000000", 16),  # nothing is set by a task controller
        ("1A 00 8D 00 00000000", 16),
        ("15 00 A0 00 E8030000", 8),  # not by distance
        ("16 00 8D 00 01000000", 8),  # not by a threshold
        ("14 00 8D 00 FFFFFFFF", 32),  # an interval below zero
    ],
)
def test_what_is_not_obeyed_is_refused_with_its_reason(command: str, reason: int) -> None:
    client, _ = connected(4)
    (answer,) = asked(client, command)
    sent = bytes.fromhex(command)
    assert answer[0] == 0x0D | sent[0] & 0xF0 and answer[1:4] == sent[1:4]
    assert answer[4] == reason and answer[5] & 0xF == sent[0] & 0xF


def test_values_by_time_by_way_and_on_change() -> None:
    client, _ = connected(4)
    assert asked(client, "14 00 8D 00 F4010000") == []  # work state each 500 ms
    for now_us, expected in ((400 * MS, 0), (500 * MS, 1), (600 * MS, 0), (1000 * MS, 1)):
        assert len(client.changed(VALUES_NOW, now_us)) == expected, now_us
    asked(client, "14 00 8D 00 00000000")  # no longer
    assert client.changed(VALUES_NOW, 9 * S) == []
    asked(client, "15 00 8D 00 E8030000")  # each metre
    assert client.changed({**VALUES_NOW, (1, 117): 999}, 9 * S) == []
    assert len(client.changed({**VALUES_NOW, (1, 117): 1000}, 9 * S)) == 1
    asked(client, "15 00 8D 00 00000000")
    asked(client, "18 00 8D 00 01000000")  # on change
    assert len(client.changed(VALUES_NOW, 9 * S)) == 1
    assert client.changed(VALUES_NOW, 9 * S) == []
    assert len(client.changed({**VALUES_NOW, (1, WORK_STATE): 0}, 9 * S)) == 1


def test_another_task_controller_is_not_obeyed() -> None:
    client, _ = connected(4)
    assert client.on_message(SERVER - 1, bytes.fromhex("12008D0000000000"), VALUES_NOW, 0) == []
    assert client.on_message(SERVER - 1, STATUS, VALUES_NOW, 0) == []
    assert client.server == SERVER


def test_any_bytes_in_any_state_raise_nothing() -> None:
    from random import Random

    rng = Random(10)
    client, server = connected(4)
    for step in range(20_000):
        client.on_message(rng.choice((SERVER, 1)), rng.randbytes(8), VALUES_NOW, step * 10 * MS)
        client.on_timer(VALUES_NOW, step * 10 * MS)
    del server


def test_a_task_controller_switches_work_and_sections() -> None:
    client, _ = connected(4)
    assert asked(client, "1A 00 21 01 00000000") == [bytes.fromhex("1D 00 21 01 00 FA FFFF")]
    assert client.work_off and not client.section_off
    assert asked(client, "13 00 21 01 01000000") == [] and not client.work_off
    assert asked(client, "13 00 22 01 FCFFFFFF") == []
    assert not client.section_off, "section control is not automatic yet"
    assert asked(client, "13 00 A0 00 01000000") == [] and client.section_off
    assert asked(client, "13 00 22 01 FFFFFFFF") == [] and client.section_off, "no change"
    assert asked(client, "13 00 22 01 FDFFFFFF") == [] and not client.section_off
    asked(client, "13 00 21 01 00000000")
    client.on_timer(VALUES_NOW, 7 * S)
    assert client.state is SessionState.WAITING and not client.work_off, "it ends with the session"
