"""Writes the table of docs/settings.md from the docstrings of the settings: python lab/settings_page.py."""

import re
from pathlib import Path

from wrongturn_ray.settings import RaySettings
from wrongturn_service.settings import PREFIX, Settings

PAGE = Path(__file__).parents[1] / "docs/settings.md"


def table() -> str:
    """Return a row for each setting: its variable, its default and its meaning."""
    rows = []
    for name, field in {**Settings.model_fields, **RaySettings.model_fields}.items():
        text, _, default = " ".join((field.description or "").split()).partition(" Default: ")
        value = f"{field.default:g}" if isinstance(field.default, float) else field.default
        default = default.rstrip(".") or ("none" if value in {None, ""} else f"`{value}`")
        rows.append(f"| `{PREFIX}{name.upper()}` | {default} | {text} |\n")
    return "".join(rows)


def page() -> str:
    """Return the page with its table written anew."""
    return re.sub(rf"(^\| `{PREFIX}.*\n)+", lambda _: table(), PAGE.read_text("utf-8"), count=1, flags=re.MULTILINE)


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
