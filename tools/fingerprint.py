"""Which code a result was had with: a hash of every source that can change it."""

from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROBOTS = ("crdt", "protocol", "agent")
PACKAGES = (*ROBOTS, "sim")


def fingerprint(packages: Sequence[str] = PACKAGES) -> str:
    """Twelve hexadecimal digits; equal wherever these packages are the same, byte for byte."""
    total = sha256()
    for package in packages:
        for path in sorted((ROOT / package).glob("*.py")):
            total.update(f"{package}/{path.name}\0".encode() + path.read_bytes())
    return total.hexdigest()[:12]
