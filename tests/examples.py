"""How many examples a property test draws: a quarter of them in `make test`, all of them in `make slow`.

The profiles are those of `tests/conftest.py`. A test names its number for the profile `thorough`.
"""

from hypothesis import settings

THOROUGH = 100  # hypothesis's own number, for tests that name none
QUICK = THOROUGH // 4


def examples(thorough: int) -> int:
    """The number of examples in the profile that is loaded; `thorough`: in the profile of that name."""
    return max(1, thorough * settings().max_examples // THOROUGH)
