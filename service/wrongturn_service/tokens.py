"""Bearer tokens and opaque ids."""

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
