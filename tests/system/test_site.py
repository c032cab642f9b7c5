"""The documentation's site is whole and loads nothing from elsewhere."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_site_builds_without_warnings_and_loads_nothing_from_other_origins(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    pages = list(tmp_path.rglob("*.html"))
    assert len(pages) > len(list(ROOT.glob("docs/*.md")))
    for page in pages:
        loaded = re.findall(
            r"<(?:script|link|img|iframe)\b[^>]*?(?:src|href)=[\"']?([^\"' >]+)", page.read_text("utf-8")
        )
        # A notebook's pictures are data within its page.
        elsewhere = [address for address in loaded if "//" in address and not address.startswith("data:")]
        assert elsewhere == [], page
    assert (tmp_path / "search/search_index.json").is_file()


def test_the_overview_links_to_every_page() -> None:
    linked = set(re.findall(r"\]\(([\w/-]+\.(?:md|ipynb))\)", (ROOT / "docs/index.md").read_text("utf-8")))
    notebooks = {f"notebooks/{page.name}" for page in ROOT.glob("docs/notebooks/*.ipynb")}
    assert linked == {page.name for page in ROOT.glob("docs/*.md")} - {"index.md"} | notebooks
