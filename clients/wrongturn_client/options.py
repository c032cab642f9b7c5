"""Options that several commands have."""

from typing import Annotated

import typer

Url = Annotated[
    str | None,
    typer.Option(
        "--url", envvar="WRONGTURN_URL", metavar="URL", help="URL of the service. Example: --url http://127.0.0.1:8000"
    ),
]
