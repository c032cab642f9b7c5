"""``python -m wrongturn_service``: the same as ``wrongturn serve``."""

import typer

from wrongturn_service.cli import serve

if __name__ == "__main__":
    typer.run(serve)
