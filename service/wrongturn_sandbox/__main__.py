"""Command line of a guest, and of the listener in a runner container."""

import argparse
import logging
import sys
from pathlib import Path

from wrongturn_sandbox.errors import SandboxUnavailableError
from wrongturn_sandbox.guest import serve
from wrongturn_sandbox.host import probe

_EXAMPLE = "Example: python -m wrongturn_sandbox --listen /run/wrongturn/runner.sock --most 4"


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m wrongturn_sandbox", description=f"Hold the sandboxes of a runner container. {_EXAMPLE}"
    )
    task = parser.add_mutually_exclusive_group(required=True)
    task.add_argument("--listen", metavar="SOCKET", type=Path, help="Unix socket to make")
    task.add_argument("--probe", metavar="SOCKET", type=Path, help="open a sandbox there once, and say what it is")
    task.add_argument("--guest", metavar="FD", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--most", metavar="N", type=int, default=8, help="sandboxes at a time (default: 8)")
    arguments = parser.parse_args()
    if arguments.guest is not None:
        serve(arguments.guest)
    elif arguments.probe is not None:
        try:
            print(probe(arguments.probe))
        except SandboxUnavailableError as error:
            sys.exit(f"error: {error}")
    elif arguments.most < 1:
        parser.error("--most: use at least 1")
    else:
        from wrongturn_sandbox.listener import Listener  # noqa: PLC0415 - a guest has no use for it

        logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
        path = arguments.listen
        try:
            Listener(path, arguments.most).run()
        except OSError as error:
            sys.exit(f"error: cannot listen at {path}: {error.strerror}; choose a folder that this user may write")


if __name__ == "__main__":
    main()
