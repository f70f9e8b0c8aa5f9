"""Named places: a TOML file of names and metres east and north, and what is near a misspelt one.

[places]
shelf = [12.0, 3.5]
"loading dock" = [-4.0, 20.0]
"""

import json
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from agent.interface.geometry import Point
from agent.runtime.files.given_file import SETTINGS_BYTES_MAX, GivenFileError, parse_toml, read_toml
from tools.language.intent import Metres
from tools.language.vocabulary import is_word, words_of

PLACES_MAX = 1000  # more are a map and not names
NEAR = 0.6  # likeness of a name that is offered instead


class PlacesError(Exception):
    """One line for the person who wrote the file."""


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid")
    places: dict[str, tuple[Metres, Metres]] = {}
    sections: dict[Annotated[str, Field(pattern=r"^S\d{1,5}$")], tuple[Metres, Metres]] = {}


class Places:
    """Names that a person may say, with their positions in metres east and north."""

    def __init__(self, named: Mapping[str, Point], sections: Mapping[str, Point] = {}) -> None:
        """`sections` are said as sections are: S7, section 7.

        Raises PlacesError for names that cannot be told from the words of the language.
        """
        if len(named) > PLACES_MAX:
            raise PlacesError(f"{len(named)} places: at most {PLACES_MAX}")
        self.points: dict[str, Point] = dict(sections)
        self.named: list[str] = sorted(named)
        self.groups: dict[tuple[str, ...], str] = {}
        for name, (x_m, y_m) in sorted(named.items()):
            group = tuple(words_of(name))
            if not group or is_word(group):
                raise PlacesError(f"place {name!r}: is a word of the language; choose another name")
            known = self.groups.setdefault(group, name)
            if known != name:
                raise PlacesError(f"places {known!r} and {name!r} are said alike; rename one")
            self.points[name] = (float(x_m), float(y_m))

    def __len__(self) -> int:
        return len(self.named)

    def like(self, name: str) -> tuple[str, ...]:
        """Up to three known names that are spelt nearly like this one."""
        return tuple(get_close_matches(name, self.named, n=3, cutoff=NEAR))

    @classmethod
    def read(cls, path: Path) -> "Places":
        """Raises PlacesError."""
        try:
            return cls._of(read_toml(path, SETTINGS_BYTES_MAX))
        except (GivenFileError, PlacesError) as problem:
            raise PlacesError(f"{path}: {problem}") from None

    @classmethod
    def parse(cls, text: str) -> "Places":
        """The places of the text of a file. Raises PlacesError."""
        try:
            return cls._of(parse_toml(text))
        except GivenFileError as problem:
            raise PlacesError(str(problem)) from None

    @classmethod
    def _of(cls, table: Mapping[str, Any]) -> "Places":
        try:
            file = _File(**table)
        except ValidationError as problem:
            error = problem.errors()[0]
            key = ".".join(map(str, error["loc"]))
            raise PlacesError(
                f"{key}: needs name = [east, north] in metres below [places]: {error['msg']}"
            ) from None
        return cls(file.places, file.sections)

    @staticmethod
    def write(named: Mapping[str, Point], sections: Mapping[str, Point]) -> str:
        """The text of a file that `Places` can read, from names and metres east and north."""
        lines = []
        for title, points in (("places", named), ("sections", sections)):
            lines += [f"[{title}]"]
            lines += [f"{_quoted(name)} = [{x:.2f}, {y:.2f}]" for name, (x, y) in points.items()]
        return "\n".join(lines) + "\n"


def _quoted(name: str) -> str:
    """As a string of TOML, which has no halves of a character, as JSON writes them of an emoji."""
    return json.dumps(name, ensure_ascii=False).replace("\x7f", "\\u007f")
