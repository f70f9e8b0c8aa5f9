"""All that is used of the package `cryptography`: a key from a secret, a MAC, and a seal.

The package is imported with the first key (`load`). A fleet without keys does without it, and so does a
tool that has none.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.cmac import CMAC


def load() -> None:
    """Import the package now, so that no frame waits for it."""
    from cryptography.hazmat.primitives.ciphers import aead as aead
    from cryptography.hazmat.primitives.ciphers import algorithms as algorithms
    from cryptography.hazmat.primitives.kdf import hkdf as hkdf


def derived_key(secret: bytes, info: bytes, size: int) -> bytes:
    """HKDF-SHA256 (RFC 5869) without salt: `size` bytes for the purpose that `info` names."""
    from cryptography.hazmat.primitives.hashes import SHA256
    from cryptography.hazmat.primitives.kdf.hkdf import HKDF

    return HKDF(algorithm=SHA256(), length=size, salt=None, info=info).derive(secret)


def mac_of(key: bytes) -> "CMAC":
    """An AES-CMAC (RFC 4493) that nothing was fed to yet. `key`: 16 or 32 bytes."""
    from cryptography.hazmat.primitives.ciphers.algorithms import AES
    from cryptography.hazmat.primitives.cmac import CMAC

    return CMAC(AES(key))


def siv_sealed(key: bytes, content: bytes, about: bytes) -> bytes:
    """AES-SIV (RFC 5297): 16 bytes longer than the content. `key`: 32 bytes; `about` is covered, too."""
    from cryptography.hazmat.primitives.ciphers.aead import AESSIV

    return AESSIV(key).encrypt(content, [about])


def siv_opened(key: bytes, content: bytes, about: bytes) -> bytes | None:
    """What was sealed; None if another key sealed it, or somebody changed it."""
    from cryptography.exceptions import InvalidTag
    from cryptography.hazmat.primitives.ciphers.aead import AESSIV

    try:
        return AESSIV(key).decrypt(content, [about])
    except InvalidTag:
        return None
