"""`headland say`: plain language to a fleet, and its answers; without a phrase, a conversation.

What reads phrases is imported once a bus is there: it is half of the start of this command.
"""

import asyncio
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from tools.common.bus_attach import Attached, AttachError, address_of_launch, folder_of_launch
from tools.common.run_folder import QUEUE, RUNS

WRONG = 2


class Options(NamedTuple):
    """As given on the command line."""

    bus: Attached
    key: Path | None = None
    places: Path | None = None
    queue: Path | None = None  # None: in the folder of the launch whose bus it is
    by: str | None = None
    endpoint: str | None = None
    model: str = "default"
    timeout_s: float = 5.0
    wait: bool = True  # until goals that are queued were given
    yes: bool = False
    read_only: bool = False  # show how phrases are read, and do nothing
    log: Path | None = None
    as_json: bool = False


def say(words: list[str], options: Options) -> int:
    """The exit code of `headland say`: that of the phrase, or of the last one of a conversation; 2
    for a wrong argument, file or bus."""
    if find_spec("lark") is None:
        return _wrong("the language needs lark: pip install 'headland[operator]'")
    if options.by is not None and options.by != "any" and not options.by.isdigit():
        return _wrong(f"--by {options.by}: needs the number of a robot, or any")
    try:
        _find_launch(options)
    except AttachError as problem:
        return _wrong(str(problem))
    from tools.language.conversation import WRONG_WORDS, Conversation

    try:
        return asyncio.run(Conversation(options).hold(" ".join(words) or None))
    except WRONG_WORDS as problem:
        return _wrong(str(problem))


def _find_launch(options: Options) -> None:
    """Raises AttachError where the bus is that of a launch, and there is none. Files and addresses that
    were given are looked at first."""
    interface, _, _, _, port = options.bus
    given = options.key or options.places or options.endpoint or options.log or options.read_only
    if interface == "socketcand" and port == 0 and not given:
        address_of_launch()


def _wrong(message: str) -> int:
    print(f"headland: {message}", file=sys.stderr)
    return WRONG


def own_queue(bus: Attached) -> Path:
    """Goals of a launch are in its folder: the next fleet, on another field, does not get them."""
    interface, _, _, host, port = bus
    return (folder_of_launch(interface, host, port) or RUNS) / QUEUE
