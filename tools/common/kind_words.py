"""The kinds of scenarios as an error names them."""

from typing import Final

KIND_WORDS: Final = {
    "field": "a field", "errands": "a field of errands", "delivery": "a warehouse",
    "exploration": "an arena", "grid": "a grid map", "protocol": "a fleet without a field",
}  # fmt: skip
