"""Digests of replicated state: order-independent, kept up to date entry by entry.

An entry is mixed to 64 bits (splitmix64's finaliser, Steele et al. 2014) and added modulo 2^64; a
digest is the top 24 bits of the sum. Sums, not XOR: an entry that is wrongly counted twice shows.
"""

MASK = (1 << 64) - 1
DIGEST_BITS = 24
BUCKETS = 32  # of the fall-back sync; 11 frames of three digests carry them


def mix(number: int) -> int:
    """A 64-bit number spread over 64 bits."""
    number = (number + 0x9E3779B97F4A7C15) & MASK
    number = ((number ^ number >> 30) * 0xBF58476D1CE4E5B9) & MASK
    number = ((number ^ number >> 27) * 0x94D049BB133111EB) & MASK
    return number ^ number >> 31


def entry_hash(kind: int, key: int, value: int) -> int:
    """Of one entry: `kind` separates the collections, `key` names it, `value` is its state."""
    return mix(mix(kind << 32 | key) ^ value)


def short(total: int) -> int:
    """The 24 bits that travel."""
    return total >> (64 - DIGEST_BITS)


def bucket_of(kind: int, key: int) -> int:
    return mix(kind << 32 | key) % BUCKETS
