"""Print what the named parts need from outside this repository, one requirement a line.

An image can install these from the pyproject files alone, before it has the sources.
"""

import sys
import tomllib
from pathlib import Path

needed = {
    requirement
    for part in sys.argv[1:]
    for requirement in tomllib.loads(Path(part, "pyproject.toml").read_text())["project"]["dependencies"]
    if not requirement.startswith("wrongturn-")
}
print("\n".join(sorted(needed)))
