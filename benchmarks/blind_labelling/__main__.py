"""Blind labelling: a labeller and the judge look at the same drives, and neither knows what the other says.

    python benchmarks/blind_labelling [--experiment hard_cases] make PICTURES [--only 7 31]
    python benchmarks/blind_labelling [--experiment hard_cases] label 7 exit_left [--opposed] [--unclear] [--note "…"]
    python benchmarks/blind_labelling [--experiment hard_cases] compare

``make`` draws each drive from above, without driver, fault, route or verdict. The drives lie in ``drives.npz``, which
you do not look into. Without that file ``make`` first drives anew, on past any verdict, in a shuffled order. ``label``
writes down what you say about a picture. ``compare`` asks the judge and prints both. The README beside this file tells
what came of it.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import comparison
import experiment
import labels
import picture


def make(given: argparse.Namespace) -> None:
    chosen = experiment.EXPERIMENTS[given.experiment]
    if not chosen.drives.exists():
        experiment.save(list(chosen.drive_all()), chosen.drives)
    given.pictures.mkdir(parents=True, exist_ok=True)
    for number, one in enumerate(experiment.load(chosen.drives)):
        if given.only is None or number in given.only:
            picture.draw(one.trajectory, number, given.pictures / f"{number:03d}.png")


def label(given: argparse.Namespace) -> None:
    file = experiment.EXPERIMENTS[given.experiment].labels
    said = labels.read(file)
    said[given.number] = labels.label_of(given.verdict, opposed=given.opposed, clear=not given.unclear, note=given.note)
    labels.write(said, file)


def compare(given: argparse.Namespace) -> None:
    chosen = experiment.EXPERIMENTS[given.experiment]
    pairs = comparison.compare(experiment.load(chosen.drives), labels.read(chosen.labels))
    comparison.write(pairs, chosen.verdicts)
    print(comparison.table(pairs))


def main() -> int:
    parser = argparse.ArgumentParser(prog="python benchmarks/blind_labelling", description=__doc__.split("\n")[0])
    parser.add_argument(
        "--experiment",
        choices=experiment.EXPERIMENTS,
        default=experiment.EIGHT_DRIVERS.name,
        help="the drives. Example: --experiment hard_cases",
    )
    ways = parser.add_subparsers(required=True)
    made = ways.add_parser("make", help="draw the drives. Example: make pictures")
    made.add_argument("pictures", type=Path, help="folder for the pictures")
    made.add_argument("--only", type=int, nargs="+", metavar="NUMBER", help="draw these only. Example: --only 7 31")
    made.set_defaults(run=make)
    said = ways.add_parser("label", help="write down what you say about a picture. Example: label 7 exit_left")
    said.add_argument("number", type=int)
    said.add_argument("verdict", choices=labels.WORDS)
    said.add_argument(
        "--opposed", action="store_true", help="the centre was more than 10 m on opposed lanes, or on one at the end"
    )
    said.add_argument("--unclear", action="store_true", help="the picture does not decide")
    said.add_argument("--note", default="", help='why. Example: --note "stands 15.1 m before the line"')
    said.set_defaults(run=label)
    both = ways.add_parser("compare", help="ask the judge, print both, and keep what it said in verdicts.json")
    both.set_defaults(run=compare)
    given = parser.parse_args()
    try:
        given.run(given)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
