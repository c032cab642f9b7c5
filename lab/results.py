"""The tables and pictures of this repository's pages.

    python -m lab.results                        # print the tables
    python -m lab.results --check                # fail if a page, picture, film or card differs from what is stored
    python -m lab.results --write                # write all pages anew; with names, these alone
    python -m lab.results --curves               # draw the learning curves into docs/pictures
    python -m lab.results --import scored.json --agent ppo-image --seed 3   # store results or a training run's curve

A section of a page stands between ``<!-- results: NAME -->`` and ``<!-- end of results -->``.
"""

import argparse
import os
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final

from pydantic import ValidationError

from lab import cards, curves, doubting, endings, faults, films, order, redraws, studies, tables, unseen
from lab.stored_results import Collection, StoredResults
from lab.tables import OutdatedPageError
from wrongturn_agents.errors import AgentsError, ResultsError
from wrongturn_agents.stored_results import STORED
from wrongturn_agents.suites import UNSEEN
from wrongturn_client.tables import console
from wrongturn_protocol import RunFile, RunFormatError

_BEGIN: Final = "<!-- results: "
_END: Final = "<!-- end of results -->"
_SECTION: Final = re.compile(rf"({_BEGIN}(?P<name>[a-z-]+) -->\n)(?P<body>.*?)({_END})", re.DOTALL)
Sections = dict[str, Callable[[], tables.Table | str]]


def sections(collection: Collection) -> Sections:
    """Return what makes each section of the pages, by its name."""
    runs = curves.read_curves()
    return {
        "summary": partial(unseen.summary_table, collection),
        "unseen": unseen.unseen_table,
        "faults": faults.faults_table,
        "conditions": faults.conditions_table,
        "doses": faults.doses_table,
        "navigation": partial(tables.navigation_table, collection),
        "traffic": partial(tables.traffic_table, collection),
        "wrong-command": partial(tables.wrong_command_table, collection),
        "endings": partial(endings.endings_table, collection),
        "paper-endings": partial(endings.paper_endings_table, collection),
        "order": partial(order.order_in_words, collection),
        "ablations": partial(tables.ablations_table, collection),
        "thresholds": studies.thresholds_table,
        "draws": studies.draws_table,
        "redraws": redraws.coverage_table,
        "separation": redraws.separation_table,
        "failures": films.ways_table,
        "collisions": films.collisions_table,
        "training": partial(curves.training_table, runs),
        "imitation": partial(curves.imitation_table, runs),
        **{f"doubting-{name}": make for name, make in doubting.TABLES.items()},
        **{name: partial(_picture, picture) for name, picture in curves.PICTURES.items()},
    }


def _picture(picture: curves.Picture) -> str:
    return f"![{picture.seen}]({os.path.relpath(picture.path, 'docs')})\n"


def find_pages(root: Path = Path()) -> list[Path]:
    """Return the repository's pages that have sections: in its root, and anywhere in ``docs``."""
    pages = sorted([*root.glob("*.md"), *root.glob("docs/**/*.md")])
    return [page for page in pages if _BEGIN in page.read_text("utf-8")]


def filled(page: Path, made: Sections) -> str:
    """Return a page's text with its sections anew.

    Raises:
        ResultsError: A section is unknown or has no end.
    """
    text = page.read_text("utf-8")
    names = [match["name"] for match in _SECTION.finditer(text)]
    unknown = sorted(set(names) - made.keys())
    if unknown or not len(names) == text.count(_BEGIN) == text.count(_END):
        what = f"there is no section {unknown[0]!r}" if unknown else "a section is not whole"
        raise ResultsError(f"{page}: {what}; write '{_BEGIN}NAME -->' and '{_END}' on lines of their own")

    def section(match: re.Match[str]) -> str:
        found = made[match["name"]]()
        return f"{match[1]}\n{found if isinstance(found, str) else found.markdown()}\n{match[4]}"

    return _SECTION.sub(section, text)


def check_page(page: Path, made: Sections) -> None:
    """Raise OutdatedPageError if a page does not show what is stored. The error names the sections."""
    pairs = zip(_SECTION.finditer(page.read_text("utf-8")), _SECTION.finditer(filled(page, made)), strict=True)
    wrong = [before["name"] for before, after in pairs if before["body"] != after["body"]]
    if wrong:
        raise OutdatedPageError(f"{page}: {', '.join(wrong)}: does not show the stored results; write it anew")


def check_all() -> list[Path]:
    """Check all pages, pictures, films and cards, and return the pages."""
    collection, pages = Collection.read(STORED), find_pages()
    for page in pages:
        check_page(page, sections(collection))
    curves.check_pictures(curves.read_curves())
    films.check_films(collection)
    for file, text in cards.cards().items():
        if file.read_text("utf-8") != text:
            raise OutdatedPageError(f"{file}: is not the card that the files make; run python -m lab.cards")
    return pages


def import_results(source: Path, directory: Path = STORED, **given: str | int | None) -> Path:
    """Store a file of ``wrongturn score --json`` or ``wrongturn run --json``, and return the stored file's path.

    Args:
        source: The file.
        directory: Where results are stored.
        given: Fields that replace those of the file: ``agent``, ``seed``, ``variant``, ``steps``.
    """
    try:
        run = RunFile.read(source)
        if run.suite == UNSEEN:
            agent = given.get("agent")
            return unseen.UnseenResults.of(run, None if agent is None else str(agent)).write()
        file = studies.results_of_run(run)
    except RunFormatError:
        file = StoredResults.read(source)
    try:
        file = StoredResults.model_validate({**file.model_dump(), **{k: v for k, v in given.items() if v is not None}})
    except ValidationError as error:
        raise ResultsError(f"--import: {error.errors()[0]['loc'][0]}: {error.errors()[0]['msg']}") from error
    file.check(source.name)
    return file.write(directory)


def _print(collection: Collection) -> None:
    screen = console()
    for make in sections(collection).values():
        found = make()
        if not isinstance(found, str):
            screen.print(found.rich())
            screen.print()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the program; an error is one line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--write", type=Path, nargs="*", metavar="PAGE")
    parser.add_argument("--curves", action="store_true")
    parser.add_argument("--import", dest="source", type=Path, metavar="FILE|RUN")
    for name, kind in (("agent", str), ("seed", int), ("variant", str), ("steps", int)):
        parser.add_argument(f"--{name}", type=kind, help="of the import")
    asked = parser.parse_args(arguments)
    try:
        if asked.source is not None and asked.source.is_dir():
            print(curves.import_curve(asked.source, asked.variant))
        elif asked.source is not None:
            given = {name: getattr(asked, name) for name in ("agent", "seed", "variant", "steps")}
            print(import_results(asked.source, **given))
        elif asked.check:
            print(f"up to date with the stored results: {', '.join(map(str, check_all()))}")
        elif asked.curves:
            for picture in curves.PICTURES.values():
                curves.draw_picture(picture, curves.read_curves())
        elif asked.write is not None:
            made = sections(Collection.read(STORED))
            for page in asked.write or find_pages():
                page.write_text(filled(page, made), "utf-8")
        else:
            _print(Collection.read(STORED))
    except (AgentsError, OSError) as error:
        raise SystemExit(f"lab.results: {error}") from error


if __name__ == "__main__":
    main()
