"""Print the packages that the named parts need from outside this repository, one on each line.

A part is named by its folder, with an extra in brackets where one is wanted: ``agents[onnx]``.
An image can install these with only the pyproject files, before it has the sources.
"""

import sys
import tomllib
from pathlib import Path

needed: set[str] = set()
for argument in sys.argv[1:]:
    part, _, extra = argument.rstrip("]").partition("[")
    project = tomllib.loads(Path(part, "pyproject.toml").read_text())["project"]
    needed |= {*project["dependencies"], *(project["optional-dependencies"][extra] if extra else ())}
print("\n".join(sorted(requirement for requirement in needed if not requirement.startswith("wrongturn-"))))
