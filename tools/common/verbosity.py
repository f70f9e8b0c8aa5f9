"""How much a command says: `-q` leaves only results and errors, `-v` adds where an error came from.

Both may stand before or behind the command's name. They are set once, when the command line is read.
"""

QUIET_WORDS, VERBOSE_WORDS = ("-q", "--quiet"), ("-v", "--verbose")


class Verbosity:
    """What was asked for; one for the process."""

    quiet = False
    verbose = False


def taken_from(words: list[str]) -> list[str]:
    """The words without those of verbosity, which are obeyed. Words behind `--` are left alone."""
    own = words[: words.index("--")] if "--" in words else words
    Verbosity.quiet = any(word in QUIET_WORDS for word in own)
    Verbosity.verbose = any(word in VERBOSE_WORDS for word in own)
    if Verbosity.verbose:
        import logging

        logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s")
    kept = [word for word in own if word not in (*QUIET_WORDS, *VERBOSE_WORDS)]
    return kept + words[len(own) :]
