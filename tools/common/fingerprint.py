"""Which code made a result: a hash of every source that can change it."""

from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

ROOT = Path(__file__).parents[2]
ROBOTS = ("crdt", "protocol", "agent")
PACKAGES = (*ROBOTS, "sim")


def fingerprint(packages: Sequence[str] = PACKAGES) -> str:
    """Twelve hexadecimal digits; equal wherever these packages are the same, byte for byte."""
    total = sha256()
    for package in packages:
        for path in sorted((ROOT / package).rglob("*.py")):
            total.update(f"{path.relative_to(ROOT).as_posix()}\0".encode() + path.read_bytes())
    return total.hexdigest()[:12]
