"""Options of bodies, as a robot file gives them: of any kind, and of any size."""

from math import inf
from typing import Final

ANTENNA_MAX_M: Final = 100.0  # from the middle of the body; no machine is longer
LATENCY_MAX_MS: Final = 1000.0  # a robot believes no place that is nearly as old
VALUE_MAX: Final = 1e9  # a larger integer may be no float
WHEEL_RADIUS_M: Final = (0.01, 10.0)


def number(name: str, value: object, least: float = -inf, most: float = inf) -> float:
    """The value of an option, in its own unit. Raises ValueError, one line, if it is no finite number
    from `least` to `most`."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"options.{name}: {value!r} is no number")
    if not abs(value) <= VALUE_MAX:  # nan, too
        raise ValueError(f"options.{name}: it is no number up to {VALUE_MAX:g}")
    if value < least:
        raise ValueError(f"options.{name}: {value!r} is less than {least:g}")
    if value > most:
        raise ValueError(f"options.{name}: {value!r} is more than {most:g}")
    return float(value)


def whole(name: str, value: object, least: int, most: int) -> int:
    """The value of an option that counts. Raises ValueError, one line, if it is no whole number from
    `least` to `most`."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"options.{name}: {value!r} is no whole number")
    return int(number(name, value, least, most))


def flag(name: str, value: object) -> bool:
    """The value of an option that is true or false. Raises ValueError, one line, for all else: a text
    would count as true, "false" too."""
    if not isinstance(value, bool):
        raise ValueError(f"options.{name}: {value!r} is neither true nor false")
    return value


def text(name: str, value: object, wanted: str) -> str:
    """The value of an option that is a text, for example an address. `wanted`: what it is to be, for the
    person. Raises ValueError, one line, if it is none or empty."""
    if not isinstance(value, str) or not value:
        raise ValueError(f"options.{name}: {value!r} is not {wanted}")
    return value


def name_or_number(name: str, value: object, wanted: str) -> str:
    """The value of an option that is a name, for which a file may also have a whole number without
    quotes: a serial number, or the channel of a CAN interface. Raises ValueError as `text` does."""
    if isinstance(value, int) and not isinstance(value, bool):
        value = f"{value:d}"
    return text(name, value, wanted)


def antenna(ahead_m: object, left_m: object) -> tuple[float, float]:
    """Where an antenna is, metres ahead and left of the middle of the body. Raises ValueError."""
    return (
        number("antenna_ahead_m", ahead_m, -ANTENNA_MAX_M, ANTENNA_MAX_M),
        number("antenna_left_m", left_m, -ANTENNA_MAX_M, ANTENNA_MAX_M),
    )


def accuracy(accuracy_m: object) -> float:
    """Standard deviation of places whose receiver says none, metres; inf without the option.

    Raises ValueError."""
    return inf if accuracy_m is None else number("accuracy_m", accuracy_m, 0.0)


def origin_or_none(origin: object) -> tuple[float, float] | None:
    """Latitude and longitude of (0, 0), degrees; None without the option. Raises ValueError."""
    if origin is None:
        return None
    if not isinstance(origin, list | tuple) or len(origin) != 2:
        raise ValueError(f"options.origin: {origin!r} is not [latitude, longitude]")
    return number("origin", origin[0], -90.0, 90.0), number("origin", origin[1], -180.0, 180.0)
