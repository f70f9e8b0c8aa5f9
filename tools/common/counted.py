"""A count and what is counted, in words: one contact, two contacts."""


def counted(count: int, told: str) -> str:
    """`told` with the count at {} and, if there is not just one, an "s" at {s}.

    >>> counted(1, "{} contact{s}"), counted(2, "{} contact{s}")
    ('1 contact', '2 contacts')
    """
    return told.format(count, s="" if count == 1 else "s")
