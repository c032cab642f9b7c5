"""How this program was called, so that a command it prints can be pasted."""

import shlex
import shutil
import sys
from pathlib import PurePath

_NAME = "wrongturn"


def program() -> str:
    """``wrongturn`` as the user called it, or in a way that works where it was no program of that name."""
    called = sys.argv[0] if sys.argv else ""
    if PurePath(called).name != _NAME:
        return f"{python()} -m wrongturn_client"
    return _NAME if shutil.which(_NAME) == called else shlex.quote(called)


def python() -> str:
    """This interpreter."""
    return shlex.quote(sys.executable)
