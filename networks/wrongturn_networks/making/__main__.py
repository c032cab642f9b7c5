"""Build the shipped towns: ``python -m wrongturn_networks.making``."""

import argparse
import filecmp
import sys
import tempfile
from pathlib import Path

from wrongturn_networks.loading import TOWNS
from wrongturn_networks.making.netconvert import build
from wrongturn_networks.making.recipes import RECIPES


def main() -> int:
    """Run the program; the exit status is 1 where a file differs from its recipe."""
    parser = argparse.ArgumentParser(prog="python -m wrongturn_networks.making", description=__doc__)
    parser.add_argument("--check", action="store_true", help="change nothing; list the files that differ")
    check = parser.parse_args().check
    different: list[str] = []
    for recipe in RECIPES.values():
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch) / recipe.name if check else TOWNS / recipe.name
            build(recipe, folder)
            names = [path.name for path in folder.iterdir()]
            _, unequal, missing = filecmp.cmpfiles(folder, TOWNS / recipe.name, names, shallow=False)
            different += [f"{recipe.name}/{name}" for name in (*unequal, *missing)]
    for name in different:
        print(f"differs from its recipe: {name}; build it again, without --check", file=sys.stderr)
    return 1 if different else 0


if __name__ == "__main__":
    raise SystemExit(main())
