"""Make the documentation's pictures of pages, ``docs/pictures/pages/*.webp``.

``python tests/browser/picture_pages.py [--agents obeys-blindly,careful] [--suite smoke@3]``

A service of its own runs the agents first. The first one is shown.
"""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from playwright.sync_api import Browser, sync_playwright

sys.path.insert(0, str(Path(__file__).parents[1] / "service"))

from all_pages import page_paths
from filled_site import filled_site
from visiting import CHROMIUM, OPTIONS

FOLDER: Final = Path(__file__).parents[2] / "docs/pictures/pages"
SIZE: Final = {"width": 1000, "height": 1000}
LARGEST: Final = 100_000
"""Bytes of a picture."""


def picture(browser: Browser, url: str, path: str, file: Path) -> None:
    """Write a picture of a page's upper part, in light colours."""
    context = browser.new_context(base_url=url, viewport=SIZE, color_scheme="light", reduced_motion="reduce")
    page = context.new_page()
    page.goto(path, wait_until="networkidle")
    pixels = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    context.close()
    for quality in (85, 70, 55, 40):
        _, data = cv2.imencode(".webp", pixels, [cv2.IMWRITE_WEBP_QUALITY, quality])
        if len(data) < LARGEST:
            break
    file.write_bytes(data.tobytes())


def main() -> None:
    """Run the agents, and write the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--agents", default="obeys-blindly,careful")
    parser.add_argument("--suite", default="smoke@3")
    options = parser.parse_args()
    FOLDER.mkdir(parents=True, exist_ok=True)
    names = tuple(options.agents.split(","))
    with (
        tempfile.TemporaryDirectory() as folder,
        filled_site(Path(folder), names, options.suite) as site,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=list(OPTIONS))
        paths = page_paths(site, options.suite)
        for name in ("leaderboard", "agent", "episode"):
            picture(browser, site.url, paths[name], FOLDER / f"{name}.webp")
        browser.close()


if __name__ == "__main__":
    main()
