"""The types of the fixtures."""

from collections.abc import Callable

from playwright.sync_api import Page

Visit = Callable[..., Page]
Accessible = Callable[[Page], None]
