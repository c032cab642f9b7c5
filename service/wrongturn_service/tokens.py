"""Secrets: bearer tokens, opaque ids, and how a token is kept for a repeated request without being readable."""

import hashlib
import hmac
import secrets

_TOKEN_BYTES = 32


def new_token() -> str:
    """A bearer token of 256 random bits."""
    return f"wt_{secrets.token_urlsafe(_TOKEN_BYTES)}"


def new_id(prefix: str) -> str:
    """An opaque random id: it tells nothing of what it names but its kind."""
    return f"{prefix}_{secrets.token_hex(12)}"


def digest(text: str) -> str:
    """SHA-256 in hexadecimal: what is stored of a token or an idempotency key."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def same(one: str, other: str) -> bool:
    """Compare secrets in a time that does not depend on where they differ."""
    return hmac.compare_digest(one.encode("utf-8", "surrogatepass"), other.encode("utf-8", "surrogatepass"))


def _mask(key: str, salt: bytes, length: int) -> bytes:
    return hashlib.pbkdf2_hmac("sha256", key.encode(), salt, 1, dklen=length)


def seal(text: str, key: str) -> bytes:
    """Hide a text so that only who knows the key can read it.

    The reply to a registration holds the token, which the database must not tell; yet a repeat of the request has to
    get the same reply, after a restart too. The database has only the idempotency key's SHA-256, the client the key.

    Args:
        text: what to hide, at most a few hundred bytes.
        key: the client's idempotency key; random ones are strong, guessable ones are not.
    """
    salt, raw = secrets.token_bytes(16), text.encode()
    return salt + bytes(a ^ b for a, b in zip(raw, _mask(key, salt, len(raw)), strict=True))


def unseal(sealed: bytes, key: str) -> str:
    """The text that :func:`seal` hid by the same key."""
    salt, raw = sealed[:16], sealed[16:]
    return bytes(a ^ b for a, b in zip(raw, _mask(key, salt, len(raw)), strict=True)).decode()
