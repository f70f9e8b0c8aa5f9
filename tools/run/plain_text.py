"""Words of a file in a picture of matplotlib: as they are written, whatever their characters are."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def plain_text() -> Iterator[None]:
    """A name such as `$a` is no formula, and one in a script that the font lacks is no warning.

    Also a decorator of what draws.
    """
    import matplotlib

    with warnings.catch_warnings(), matplotlib.rc_context({"text.parse_math": False}):
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        yield
