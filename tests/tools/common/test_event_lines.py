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
