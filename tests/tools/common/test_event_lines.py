"""What commands say that run until they are ended."""

import json

from tools.common.event_lines import EventLines


def test_an_event_is_a_line_for_people_or_one_object() -> None:
    told: list[str] = []
    lines = EventLines(out=told.append)
    lines.say("goal-aborted", "goal aborted: \x1b[2J\nno key", why="\x1b[2J\nno key")
    assert told == ["goal aborted:  [2J\nno key"], "words of others do not steer a terminal"
    lines.as_json = True
    lines.say("goal-aborted", "", why="\x1b[2J\nno key", left_m=float("inf"))
    assert json.loads(told[1]) == {
        "event": "goal-aborted",
        "why": "\x1b[2J\nno key",
        "left_m": None,
    }
    assert "\x1b" not in told[1] and "\n" not in told[1]


def test_a_note_is_an_event_with_its_text() -> None:
    told: list[str] = []
    EventLines(as_json=True, out=told.append).note("a newer key is there")
    assert json.loads(told[0]) == {"event": "note", "text": "a newer key is there"}
