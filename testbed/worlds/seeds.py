"""Seeds of random draws, derived from a secret, so that an estimator cannot repeat a draw from its names."""

from __future__ import annotations

import hashlib
from secrets import token_hex


def new_secret() -> str:
    """A fresh secret: 128 random bits in hexadecimal."""
    return token_hex(16)


def seed_of(secret: str, *names: object) -> int:
    """Seed of the draw with these names, a 64-bit integer; without a secret ("") the names determine it."""
    text = "/".join(map(str, (secret, *names) if secret else names))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
