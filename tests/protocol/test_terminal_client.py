"""A session with a virtual terminal, byte by byte as ISO 11783-6 has it."""

from random import Random

import pytest

from protocol.terminal_client import (
    JoinTerminal,
    KeyPressed,
    PoolWanted,
    ShownScreen,
    TerminalClient,
    TerminalData,
    TerminalKey,
    TerminalOutput,
    TerminalState,
)
from protocol.terminal_pool import (
    BLACK,
    GREEN,
    PICTURE_HEIGHT,
    PICTURE_WIDTH,
    RED,
    field_picture,
    picture_object,
    screen_pool,
)
from protocol.units import MS, S

VT = 38
STATUS = bytes.fromhex("FE FE E803 D007 00 00")
SHOWN = ShownScreen(("0 IDLE", "1 IDLE"), 12)


def sent(outputs: list[TerminalOutput]) -> list[bytes]:
    return [each.data for each in outputs if isinstance(each, TerminalData)]


def tell(client: TerminalClient, text: str, now_us: int = 0) -> list[TerminalOutput]:
    return client.on_message(VT, bytes.fromhex(text).ljust(8, b"\xff"), now_us)


def shown() -> TerminalClient:
    client = TerminalClient()
    client.on_message(VT, STATUS, 0)
    outputs = client.serve(True, 0)
    assert isinstance(outputs[0], JoinTerminal)
    assert [data[0] for data in sent(outputs)] == [0xFF, 0xC0]
    assert sent(outputs)[0] == bytes.fromhex("FF 01 03 FFFFFFFF FF")
    assert [data[0] for data in sent(tell(client, "C0 04 00"))] == [0xC3]
    assert [data[0] for data in sent(tell(client, "C3 FFFFFFFF 7F 7F 0F"))] == [0xC7]
    assert tell(client, "C7 01 02 0F F000 F000") == [PoolWanted(240)]
    pool = screen_pool("north", SHOWN.rows, 12, field_picture((), (), ()), 240)
    assert sent(client.upload(pool, SHOWN, 0)) == [b"\x11" + pool]
    assert sent(client.uploaded()) == [b"\x12" + b"\xff" * 7]
    tell(client, "12 00 FFFF FFFF 00")
    assert client.state is TerminalState.SHOWN
    return client


def changed(client: TerminalClient) -> list[bytes]:
    """What the client says in a second to a terminal that answers each change."""
    said: list[bytes] = []
    for now_us in range(0, S, 50 * MS):
        client.on_message(VT, STATUS, now_us)
        now = sent(client.on_timer(now_us))
        said += now
        for data in now:
            tell(client, f"{data[0]:02X} FFFF 0410 00", now_us)
    return said


def test_the_first_change_is_maintained_and_answered() -> None:
    client = shown()
    client.show(SHOWN._replace(rows=("0 STOP_DOT", "1 IDLE"), alarm="1 stopped"), 0)
    said = changed(client)
    assert [data[0] for data in said[:3]] == [0xB3, 0xAD, 0xB3]
    assert said[0][1:5] == bytes.fromhex("A30F 3000") and said[0][5:14] == b"1 stopped"
    assert said[1] == bytes.fromhex("AD 0000 E903 FFFFFF"), "the alarm mask"
    assert said[2][1:5] == bytes.fromhex("0410 1800") and said[2][5:15] == b"0 STOP_DOT"
    (maintenance,) = (data for data in sent(client.on_timer(S)) if data[0] == 0xFF)
    assert maintenance == bytes.fromhex("FF 00 03 FFFFFFFF FF")


def test_a_text_without_its_own_answer_brings_the_screen_again() -> None:
    """Found by a review: any answer passed for those of all changes, so a line that got lost was shown as
    it had been, for ever: latched robots as IDLE."""
    client = shown()
    client.show(SHOWN._replace(rows=("0 STOP_DOT", "1 STOP_DOT")), 0)
    said = []
    for now_us in range(0, 3 * S, 50 * MS):
        client.on_message(VT, STATUS, now_us)
        said += sent(client.on_timer(now_us))
        tell(client, "A8 0004 FF 0C000000", now_us)  # of a number, to which nothing was said
        if client.state is not TerminalState.SHOWN:
            break
    assert client.state is TerminalState.MEMORY
    assert [data[0] for data in said].count(0xB3) == 1, "one change at a time"


def test_lines_without_a_robot_are_emptied() -> None:
    """Found by a review: after a revocation the last line told what was true before, for ever."""
    client = shown()
    client.show(ShownScreen(("1 IDLE",), 12), 0)
    said = changed(client)
    texts = [data[5:].decode().strip() for data in said if data[0] == 0xB3]
    assert texts == ["1 IDLE", ""]


def test_a_terminal_that_refuses_the_pool_gets_it_ever_less_often() -> None:
    """Found by a review: it got the pool at each of its statuses, a fifth of the bus."""
    client = TerminalClient()
    client.serve(True, 0)
    pools = []
    for now_us in range(0, 400 * S, 250 * MS):
        outputs = client.on_message(VT, STATUS, now_us)
        outputs += client.on_timer(now_us)
        if any(data[0] == 0xC0 for data in sent(outputs)):
            tell(client, "C0 04 00", now_us)
            tell(client, "C3 FFFFFFFF 7F 7F 0F", now_us)
            tell(client, "C7 01 02 0F F000 F000", now_us)
            client.upload(b"pool", SHOWN, now_us)
            client.uploaded()
            tell(client, "12 01 0410 FFFF 02", now_us)
            pools.append(now_us // S)
    assert pools == [0, 30, 90, 210]
    client.on_message(VT, STATUS, 500 * S)
    assert client.state is TerminalState.MEMORY, "it was away, and may have been repaired"


def test_two_terminals_that_refuse_the_pool_get_it_ever_less_often() -> None:
    """Each status of the one let the refusal of the other be forgotten, so both got the pool at each
    of their statuses."""
    client = TerminalClient()
    client.serve(True, 0)
    pools: dict[int, list[int]] = {VT: [], VT + 1: []}
    for now_us in range(0, 400 * S, 250 * MS):
        for terminal in pools:
            outputs = client.on_message(terminal, STATUS, now_us)
            outputs += client.on_timer(now_us)
            if any(data[0] == 0xC0 for data in sent(outputs)):
                assert client.server == terminal
                for text in ("C0 04 00", "C3 FFFFFFFF 7F 7F 0F", "C7 01 02 0F F000 F000"):
                    client.on_message(terminal, bytes.fromhex(text).ljust(8, b"\xff"), now_us)
                client.upload(b"pool", SHOWN, now_us)
                for later_us in range(0, 5 * S, 250 * MS):  # the other one speaks meanwhile
                    for each in pools:
                        client.on_message(each, STATUS, now_us + later_us)
                client.uploaded()
                client.on_message(terminal, bytes.fromhex("12 01 0410 FFFF 02 FF"), now_us)
                pools[terminal].append(now_us // S)
    assert pools == {VT: [0, 30, 90, 210], VT + 1: [0, 30, 90, 210]}


def test_a_terminal_that_answers_nothing_keeps_no_other_one_from_showing_the_screen() -> None:
    """It was asked again and again, and the statuses of the other one were not listened to."""
    client = TerminalClient()
    client.serve(True, 0)
    asked: list[int | None] = []
    for now_us in range(0, 10 * S, 50 * MS):
        outputs = client.on_timer(now_us)
        for terminal, after_us in ((VT, 0), (VT + 1, 500 * MS)):
            if now_us % S == after_us:
                outputs += client.on_message(terminal, STATUS, now_us)
        asked += [client.server for data in sent(outputs) if data[0] == 0xC0]
        if VT + 1 in asked:
            break
    assert asked == [VT, VT + 1] and now_us < 3 * S


def test_a_terminal_that_did_not_answer_is_asked_again() -> None:
    client, asked = TerminalClient(), list[float]()
    client.serve(True, 0)
    for now_us in range(0, 10 * S, 50 * MS):
        outputs = client.on_timer(now_us)
        if now_us % S == 0:
            outputs += client.on_message(VT, STATUS, now_us)
        asked += [now_us / S for data in sent(outputs) if data[0] == 0xC0]
    assert asked == [0.0, 4.0, 8.0]


def test_keys_are_told_and_sent_back() -> None:
    client = shown()
    outputs = tell(client, "00 01 B80B E803 01 FF")
    assert sent(outputs) == [bytes.fromhex("00 01 B80B E803 01 FF")]
    assert KeyPressed(TerminalKey.STOP) in outputs
    assert not any(isinstance(each, KeyPressed) for each in tell(client, "00 00 B80B E803 01 FF"))
    assert KeyPressed(TerminalKey.ACKNOWLEDGE) in tell(client, "00 01 FFFF E903 00 FF")
    assert client.on_message(VT + 1, bytes.fromhex("0001B80BE80301FF"), 0) == []


def test_another_robots_turn_takes_the_screen_down() -> None:
    client = shown()
    assert sent(client.serve(False, 0)) == [b"\xb2" + b"\xff" * 7]
    assert client.state is TerminalState.AWAY and client.due_at_us is None
    assert client.on_message(VT, STATUS, S) == [], "it only listens"


def test_a_silent_terminal_and_one_without_memory() -> None:
    client = shown()
    assert client.on_timer(4 * S) == [] and client.state is TerminalState.AWAY
    client = shown()
    for now_us in range(0, 4 * S, 50 * MS):
        client.on_message(VT, STATUS, now_us)
        client.on_timer(now_us)
        if client.state is not TerminalState.SHOWN:
            break
    assert client.state is TerminalState.MEMORY, "it asks again, because changes are not answered"
    assert now_us <= 2_500 * MS


def test_the_picture_has_the_outline_and_the_robots() -> None:
    picture = field_picture([(0, 0), (100, 0), (100, 50), (0, 50)], [], [(50, 25)])
    assert len(picture.dots) == PICTURE_WIDTH * PICTURE_HEIGHT
    assert picture.dots.count(RED) == 1 and picture.dots.count(BLACK) > 100


def test_the_picture_has_what_is_worked() -> None:
    outline = [(0, 0), (100, 0), (100, 50), (0, 50)]
    none = field_picture(outline, [], []).dots.count(GREEN)
    half = field_picture(
        outline, [[(10, y_m), (50, y_m)] for y_m in range(2, 50, 2)], []
    ).dots.count(GREEN)
    whole = field_picture(
        outline, [[(2, y_m), (98, y_m)] for y_m in range(2, 50, 2)], []
    ).dots.count(GREEN)
    assert none == 0 and whole > 2 * half > 200


def test_the_picture_is_sent_again_and_a_terminal_that_refuses_it_keeps_the_first_one() -> None:
    picture = picture_object(field_picture((), (), [(1, 1)]))
    client = shown()
    assert sent(client.redraw(picture, 0)) == [b"\x11" + picture] and len(picture) > 1785
    assert client.redraw(picture, 0) == [], "one at a time"
    assert KeyPressed(TerminalKey.STOP) in tell(client, "00 01 B80B E803 01 FF"), "keys are obeyed"
    assert sent(client.uploaded()) == [b"\x12" + b"\xff" * 7]
    tell(client, "12 00 FFFF FFFF 00")
    assert client.state is TerminalState.SHOWN and client.screens == 1
    assert client.redraw(picture, 0)
    tell(client, "12 01 FFFF FFFF 02")
    assert client.screens == 1
    assert client.on_message(VT, STATUS, 0), "it begins again"
    client = shown()
    client._refuses = VT
    assert client.redraw(picture, 0) == []


def test_any_bytes_in_any_state_raise_nothing() -> None:
    rng, client = Random(11), shown()
    for step in range(20_000):
        now_us = step * 20 * MS
        if step % 40 == 0:
            client.on_message(VT, STATUS, now_us)
        client.serve(rng.random() < 0.9, now_us)
        first = rng.choice((0, 0x12, 0xA8, 0xAD, 0xB3, 0xC0, 0xC3, 0xC7, rng.randrange(256)))
        for out in client.on_message(
            rng.choice((VT, 1)), bytes((first,)) + rng.randbytes(7), now_us
        ):
            if isinstance(out, PoolWanted):
                client.upload(bytes(2000), SHOWN, now_us)
        client.show(ShownScreen((str(step), "x"), step % 100, rng.choice(("", "alarm"))), now_us)
        client.on_timer(now_us)


@pytest.mark.parametrize(("said", "dots"), [("FFFF", 2000), ("2080", 2000), ("0000", 200)])
def test_a_width_that_no_terminal_has_is_one_that_fits(said: str, dots: int) -> None:
    """A pool for it cannot be packed, and its robot ended; so did the next leader."""
    client = TerminalClient()
    client.on_message(VT, STATUS, 0)
    client.serve(True, 0)
    tell(client, "C0 04 00")
    tell(client, "C3 FFFFFFFF 7F 7F 0F")
    assert tell(client, f"C7 01 02 0F {said} {said}") == [PoolWanted(dots)]
    assert screen_pool("north", SHOWN.rows, 12, field_picture((), (), ()), dots)
