"""What commands say that run until they are ended."""

import json

from tools.common.event_lines import EventLines


def test_an_event_is_a_line_for_people_or_one_object() -> None:
    told: list[str] = []
    lines = EventLines(out=told.append)
    lines.say("goal-aborted", "goal aborted: \x1b[2J\nno key", why="\x1b[2J\nno key")
    assert told == ["goal aborted:  [2J no key"], "words of others do not steer a terminal"
    lines.as_json = True
    lines.say("goal-aborted", "", why="\x1b[2J\nno key", left_m=float("inf"))
    assert json.loads(told[1]) == {
        "event": "goal-aborted",
        "why": "\x1b[2J\nno key",
        "left_m": None,
    }
    assert "\x1b" not in told[1] and "\n" not in told[1]


def test_words_of_others_make_no_line_of_their_own() -> None:
    """An order's id with a line break could print an event that never was."""
    told: list[str] = []
    order_id = "o1\nrobot3: order o7 is task 12\u2028robot4"
    EventLines(out=told.append).say("order", f"robot0: order {order_id} is task 5")
    assert told == ["robot0: order o1 robot3: order o7 is task 12 robot4 is task 5"]


def test_a_note_is_an_event_with_its_text() -> None:
    told: list[str] = []
    EventLines(as_json=True, out=told.append).note("a newer key is there")
    assert json.loads(told[0]) == {"event": "note", "text": "a newer key is there"}
