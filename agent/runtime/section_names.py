"""Section names of the engine's API (strings) and section numbers of the wire (16 bits).

`S7`, `section_7` and `7` are section 7. So names with a number agree between peers that share only
the convention. Any other name is hashed into the upper half. Two names with the same number are
refused, as `north 7` and `south 7`, because silently sharing one register would be worse.
"""

from zlib import crc32

NAMED_FIRST = 0x8000  # numbers below come from the digits of a name
CONVENTION = ("", "s", "section")  # what may stand before the digits of one section


class SectionNames:
    """The names that one program has used, by number."""

    def __init__(self) -> None:
        self.by_number: dict[int, str] = {}

    def number(self, name: str) -> int:
        """The number of a section, from its digits or by a hash of its name.

        Raises ValueError if the name is empty, or if the name of another section has the same number.
        """
        digits = name[len(name.rstrip("0123456789")) :]
        if digits and int(digits) < NAMED_FIRST:
            number = int(digits)
        elif name:
            number = NAMED_FIRST | crc32(name.encode()) & 0x7FFF
        else:
            raise ValueError("a section needs a name")
        known = self.by_number.setdefault(number, name)
        if known != name and (number >= NAMED_FIRST or _words(known) != _words(name)):
            raise ValueError(f"section names {known!r} and {name!r} collide; rename one")
        return number

    def name(self, number: int) -> str:
        """The name that was used for a number; S and the number if none was."""
        return self.by_number.get(number, f"S{number}")


def _words(name: str) -> str:
    """What stands before the digits of a name; the words of the convention are all alike."""
    words = name.rstrip("0123456789").strip(" _-").casefold()
    return "" if words in CONVENTION else words
