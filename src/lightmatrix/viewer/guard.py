"""Who may connect: this machine only, by the address that was handed out, and from its own page.

A page of another site could otherwise reach a server on the loopback: by a name that it makes point
there (DNS rebinding), or by a WebSocket, which browsers let any page open.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from typing import Any

LOOPBACK = "127.0.0.1"
# Bytes of randomness in a token.
_TOKEN_BYTES = 24


@dataclass(frozen=True)
class Guard:
    """The token and the hosts of one server."""

    port: int
    token: str = field(default_factory=lambda: secrets.token_urlsafe(_TOKEN_BYTES), repr=False)

    @property
    def address(self) -> str:
        """The address of the page."""
        return f"http://{LOOPBACK}:{self.port}/{self.token}/"

    @property
    def hosts(self) -> set[str]:
        """What a browser may call this server."""
        return {f"{LOOPBACK}:{self.port}", f"localhost:{self.port}"}

    def inner_path(self, scope: dict[str, Any]) -> str | None:
        """The path within the page that a request asks for; None if it is refused."""
        hosts, origins = _header(scope, b"host"), _header(scope, b"origin")
        if len(hosts) != 1 or hosts[0] not in self.hosts:
            return None
        # A browser names the page that opens a WebSocket, and so must others.
        if len(origins) > 1 or (scope["type"] == "websocket" and not origins):
            return None
        if origins and origins[0] != f"http://{hosts[0]}":
            return None
        token, _, path = scope["path"].removeprefix("/").partition("/")
        known = secrets.compare_digest(token.encode(), self.token.encode())
        return path if known else None

    def headers(self) -> list[tuple[bytes, bytes]]:
        """Headers of every answer: the page loads nothing from elsewhere and tells nobody of it."""
        sockets = " ".join(f"ws://{host}" for host in sorted(self.hosts))
        policy = (
            f"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
            f"connect-src 'self' {sockets}; base-uri 'none'; form-action 'none'; "
            "frame-ancestors 'none'"
        )
        return [
            (b"content-security-policy", policy.encode()),
            (b"referrer-policy", b"no-referrer"),
            (b"x-content-type-options", b"nosniff"),
            (b"cross-origin-resource-policy", b"same-origin"),
            (b"cross-origin-opener-policy", b"same-origin"),
            (b"cache-control", b"no-store"),
        ]


def _header(scope: dict[str, Any], name: bytes) -> list[str]:
    """All values of a header."""
    return [value.decode("latin-1") for key, value in scope["headers"] if key == name]
