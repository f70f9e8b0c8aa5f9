"""Keys, MACs and seals against the values that the RFCs print."""

from protocol.ciphers import derived_key, mac_of, siv_opened, siv_sealed


def test_hkdf_is_that_of_rfc_5869() -> None:
    # Test case 3 (no salt, no info), and the same secret for two purposes.
    secret = bytes([0x0B]) * 22
    okm = "8da4e775a563c18f715f802a063c5a31b8a11f5c5ee1879ec3454e5f3c738d2d9d201395faa4b61a96c8"
    assert derived_key(secret, b"", 42).hex() == okm
    assert derived_key(secret, b"one", 16) != derived_key(secret, b"other", 16)


def test_the_mac_is_that_of_rfc_4493() -> None:
    key = bytes.fromhex("2b7e151628aed2a6abf7158809cf4f3c")
    mac = mac_of(key)
    mac.update(bytes.fromhex("6bc1bee22e409f96e93d7e117393172a"))
    assert mac.finalize().hex() == "070a16b46b4d4144f79bdd9dd04a287c"


def test_the_seal_is_that_of_rfc_5297() -> None:
    key = bytes.fromhex("fffefdfcfbfaf9f8f7f6f5f4f3f2f1f0f0f1f2f3f4f5f6f7f8f9fafbfcfdfeff")
    about = bytes.fromhex("101112131415161718191a1b1c1d1e1f2021222324252627")
    content = bytes.fromhex("112233445566778899aabbccddee")
    sealed = siv_sealed(key, content, about)
    assert sealed.hex() == "85632d07c6e8f37f950acd320a2ecc9340c02b9690c4dc04daef7f6afe5c"
    assert siv_opened(key, sealed, about) == content
    assert siv_opened(key, sealed, about + b".") is None
