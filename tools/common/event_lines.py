"""Events of a command that runs until it is ended: a line for people, or a JSON object, for each."""

from collections.abc import Callable

from agent.runtime.files.printable_text import printable
from sim.files.strict_json import dumps


def _printed(line: str) -> None:
    print(line, flush=True)


class EventLines:
    """Says each event at once."""

    def __init__(self, as_json: bool = False, out: Callable[[str], None] = _printed) -> None:
        """`out`: takes the lines, one at a time."""
        self.as_json, self.out = as_json, out

    def say(self, event: str, text: str, /, **values: object) -> None:
        """One event: its text, or with `as_json` its name and values. Words of others in the text do not
        steer a terminal, and are no line of their own."""
        self.out(dumps({"event": event, **values}) if self.as_json else printable(text))

    def note(self, text: str) -> None:
        """What only a person has a use for."""
        self.say("note", text, text=text)
