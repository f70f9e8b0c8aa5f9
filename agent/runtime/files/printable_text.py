"""Words of a file or of the bus as a terminal may be given them: it obeys control characters."""


def printable(text: str) -> str:
    """The text with a space in place of each character that is not printable, line breaks included.

    XML cannot carry control characters either.
    """
    return "".join(c if c.isprintable() else " " for c in text)


def one_line(text: str, most: int) -> str:
    """The printable text, cut to at most `most` characters."""
    line = printable(text)
    return line if len(line) <= most else f"{line[: most - 4]} ..."
