"""Build the towns and write the suites: ``python -m wrongturn_networks.making``."""

import argparse
import filecmp
import sys
import tempfile
from pathlib import Path

from wrongturn_networks.loading import TOWNS
from wrongturn_networks.making.netconvert import build
from wrongturn_networks.making.recipes import RECIPES
from wrongturn_networks.making.writing_suites import SUITE_RECIPES, suite_text
from wrongturn_networks.suites import SUITES


def make_towns(*, compare: bool) -> list[str]:
    """Build all towns, or with ``compare`` only return the files that differ from what their recipe gives."""
    different: list[str] = []
    for recipe in RECIPES.values():
        if not compare:
            build(recipe, TOWNS / recipe.name)
            print(f"built {recipe.name}")
            continue
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch) / recipe.name
            build(recipe, folder)
            names = [path.name for path in folder.iterdir()]
            _, unequal, missing = filecmp.cmpfiles(folder, TOWNS / recipe.name, names, shallow=False)
            different += [f"{recipe.name}/{name}" for name in (*unequal, *missing)]
    return different


def make_suites(*, compare: bool) -> list[str]:
    """Write the suites that are missing, and return those that differ from their recipe; no suite is overwritten."""
    different: list[str] = []
    for suite_id, (title, content) in SUITE_RECIPES.items():
        path, text = SUITES / f"{suite_id}.json", suite_text(suite_id, title, content())
        if path.exists() and path.read_text("utf-8") != text:
            different.append(path.name)
        elif not compare:
            path.write_text(text, "utf-8")
    return different


def main() -> int:
    """Run the program; the exit status is 1 where a file differs from its recipe."""
    parser = argparse.ArgumentParser(prog="python -m wrongturn_networks.making", description=__doc__)
    parser.add_argument("what", nargs="?", choices=("towns", "suites", "all"), default="all")
    parser.add_argument("--check", action="store_true", help="change nothing; list the files that differ")
    arguments = parser.parse_args()
    different: list[str] = []
    if arguments.what in {"towns", "all"}:
        different += make_towns(compare=arguments.check)
    if arguments.what in {"suites", "all"}:
        different += make_suites(compare=arguments.check)
    for name in different:
        print(f"differs from its recipe: {name}; a changed suite needs a new version", file=sys.stderr)
    return 1 if different else 0


if __name__ == "__main__":
    raise SystemExit(main())
