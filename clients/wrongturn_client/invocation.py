"""The program's name in printed commands, so that they can be pasted into the same shell."""

import shlex
import shutil
import sys
from pathlib import PurePath

from wrongturn_protocol.installing import python

_NAME = "wrongturn"


def program() -> str:
    """Return ``wrongturn`` as the user called it, or as a module of this interpreter."""
    called = sys.argv[0] if sys.argv else ""
    if PurePath(called).name != _NAME:
        return f"{python()} -m wrongturn_client"
    return _NAME if shutil.which(_NAME) == called else shlex.quote(called)
