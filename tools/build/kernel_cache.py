"""Whether numba has compiled kernels on this machine before: the first run waits for them."""

from importlib.util import find_spec
from pathlib import Path

WAIT = "compiling kernels: once on this machine, about 25 s on two idle cores"


def kernels_kept() -> int | None:
    """How many are in the cache; None: numba is not installed."""
    if find_spec("numba") is None:
        return None
    import numba

    folder = Path(numba.config.CACHE_DIR or "agent")
    root = folder if folder.is_absolute() else Path(__file__).parents[2] / folder
    return sum(1 for _ in root.rglob("*.nbi"))
