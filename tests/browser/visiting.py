"""The browser, and the types of the fixtures."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

from playwright.sync_api import Page

CHROMIUM: Final = Path("/usr/bin/chromium")
OPTIONS: Final = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
)
PATIENCE_MS: Final = 120_000
"""For what a page does, however busy the machine is."""
Visit = Callable[..., Page]
Accessible = Callable[[Page], None]
