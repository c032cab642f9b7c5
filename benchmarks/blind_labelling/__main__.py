"""Blind labelling: a person and the judge look at the same 150 drives, and neither knows what the other says.

    python benchmarks/blind_labelling make PICTURES [--only 7 31]
    python benchmarks/blind_labelling label 7 exit_left --safe [--unclear] [--note "…"]
    python benchmarks/blind_labelling compare [--pictures docs/pictures]

``make`` drives eight drivers over trials of a draw of its own, on past any verdict, shuffles them, and draws each from
above without naming driver, fault or verdict. ``label`` writes down what you say about a picture. ``compare`` asks the
judge and prints both.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import experiment
import picture


def make(given: argparse.Namespace) -> int:
    if not experiment.DRIVES.exists():
        experiment.save(list(experiment.drive_all()))
    given.pictures.mkdir(parents=True, exist_ok=True)
    for number, one in enumerate(experiment.load()):
        if given.only is None or number in given.only:
            picture.draw(one.trajectory, number, given.pictures / f"{number:03d}.png")
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(prog="python benchmarks/blind_labelling", description=__doc__.split("\n")[0])
    ways = parser.add_subparsers(required=True)
    made = ways.add_parser("make", help="drive and draw. Example: make pictures")
    made.add_argument("pictures", type=Path, help="folder for the pictures")
    made.add_argument("--only", type=int, nargs="+", metavar="NUMBER", help="draw these only")
    made.set_defaults(run=make)
    given = parser.parse_args()
    return given.run(given)


if __name__ == "__main__":
    sys.exit(main())
