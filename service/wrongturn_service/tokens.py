"""Bearer tokens, opaque ids, and the encryption of a stored reply's token."""

import hashlib
import hmac
import secrets

_TOKEN_BYTES = 32


def new_token() -> str:
    """Return a bearer token of 256 random bits."""
    return f"wt_{secrets.token_urlsafe(_TOKEN_BYTES)}"


def new_id(prefix: str) -> str:
    """Return a random id. Its prefix tells the kind of thing that it names."""
    return f"{prefix}_{secrets.token_hex(12)}"


def digest(text: str) -> str:
    """Return the SHA-256 that is stored in place of a token or an idempotency key."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def same(one: str, other: str) -> bool:
    """Compare two secrets in constant time."""
    return hmac.compare_digest(one.encode("utf-8", "surrogatepass"), other.encode("utf-8", "surrogatepass"))


def _mask(key: str, salt: bytes, length: int) -> bytes:
    return hashlib.pbkdf2_hmac("sha256", key.encode(), salt, 1, dklen=length)


def seal(text: str, key: str) -> bytes:
    """Encrypt a text with a key.

    The reply to a registration holds the token. A repeat of the request has to get the same reply, but the database
    must not reveal the token. Only the client has the key; the database has its SHA-256.

    Args:
        text: A text of at most a few hundred bytes.
        key: The client's idempotency key. A random key is strong, a guessable one is not.
    """
    salt, raw = secrets.token_bytes(16), text.encode()
    return salt + bytes(a ^ b for a, b in zip(raw, _mask(key, salt, len(raw)), strict=True))


def unseal(sealed: bytes, key: str) -> str:
    """Decrypt a text that :func:`seal` encrypted with the same key."""
    salt, raw = sealed[:16], sealed[16:]
    return bytes(a ^ b for a, b in zip(raw, _mask(key, salt, len(raw)), strict=True)).decode()
