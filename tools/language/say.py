"""`headland say`: plain language to a fleet, and its answers; without a phrase, a conversation.

What reads phrases is imported when the options are sound: it is half of the start of this command.
"""

import asyncio
from importlib.util import find_spec

from tools.common.exit_codes import wrong
from tools.language.say_options import Options

BY_SHOWN_MAX = 40  # characters of a wrong `--by`
BY_DIGITS_MAX = 3  # of the number of a robot


def say(words: list[str], options: Options) -> int:
    """The exit code of `headland say`: that of the phrase, or of the last one of a conversation; 2
    for a wrong argument, file or bus."""
    if find_spec("lark") is None:
        return wrong("the language needs lark: pip install 'headland[operator]'")
    if options.by is not None and not _is_robot(options.by) and options.by != "any":
        return wrong(f"--by {options.by[:BY_SHOWN_MAX]}: needs the number of a robot, or any")
    if words and not "".join(words).strip():
        return wrong('nothing is said; say what you want: headland say "where is robot 2"')
    from tools.language.conversation import WRONG_WORDS, Conversation

    try:
        return asyncio.run(Conversation(options).hold(" ".join(words) or None))
    except WRONG_WORDS as problem:
        return wrong(str(problem))


def _is_robot(word: str) -> bool:
    return word.isascii() and word.isdecimal() and len(word) <= BY_DIGITS_MAX
