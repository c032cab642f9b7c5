"""Pages with sections that are written from the stored results, between markers."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from wrongturn_agents.reporting.errors import OutdatedPageError, ResultsError

PAGES: Final = ("README.md", "docs/results.md", "docs/training.md")
"""Where there are such sections, from the repository's root."""
_SECTION: Final = re.compile(
    r"(?P<begin><!-- wrongturn results: (?P<name>[a-z-]+) -->\n)(?P<body>.*?)(?P<end><!-- end of results -->)",
    re.DOTALL,
)
_REMEDY: Final = "write '<!-- wrongturn results: NAME -->' and '<!-- end of results -->' on lines of their own"

Sections = Mapping[str, Callable[[], str]]
"""What makes each section's text, by name; none is made that no page has."""


def filled(page: Path, sections: Sections) -> str:
    """The page's text with its sections as the results have them.

    Raises:
        ResultsError: the page cannot be read, has no section, one that is unknown, or one without an end.
    """
    try:
        text = page.read_text(encoding="utf-8")
    except OSError as error:
        raise ResultsError(f"{page}: cannot be read ({error.strerror}); name a page that exists") from error
    except UnicodeDecodeError as error:
        raise ResultsError(f"{page}: is no text in UTF-8; name a page") from error
    begun = text.count("<!-- wrongturn results: ")
    found = list(_SECTION.finditer(text))
    if not begun:
        raise ResultsError(f"{page}: has no section for results; {_REMEDY}")
    if begun != len(found) or text.count("<!-- end of results -->") != begun:
        raise ResultsError(f"{page}: {begun} sections for results begin, {len(found)} are whole; {_REMEDY}")
    unknown = [match["name"] for match in found if match["name"] not in sections]
    if unknown:
        raise ResultsError(f"{page}: there is no section {unknown[0]!r}; known are {', '.join(sections)}")
    return _SECTION.sub(lambda match: f"{match['begin']}\n{sections[match['name']]()}\n{match['end']}", text)


def write(page: Path, sections: Sections) -> bool:
    """Write a page's sections; gives whether anything changed.

    Raises:
        ResultsError: see :func:`filled`; or the page cannot be written.
    """
    text = filled(page, sections)
    if text == page.read_text(encoding="utf-8"):
        return False
    try:
        page.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ResultsError(
            f"{page}: cannot be written ({error.strerror}); name another, or make it writable"
        ) from error
    return True


def check(page: Path, sections: Sections) -> None:
    """See that a page says what the stored results do.

    Raises:
        OutdatedPageError: it does not; names the section.
        ResultsError: see :func:`filled`.
    """
    new = {match["name"]: match["body"] for match in _SECTION.finditer(filled(page, sections))}
    old = {match["name"]: match["body"] for match in _SECTION.finditer(page.read_text(encoding="utf-8"))}
    wrong = [name for name, body in new.items() if old[name] != body]
    if wrong:
        raise OutdatedPageError(
            f"{page}: {', '.join(wrong)}: does not say what the stored results do; "
            f"write it by 'wrongturn results --write {page}'",
        )
