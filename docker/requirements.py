"""Print the packages that the named parts need from outside this repository, one on each line.

A part is named by its folder, with extras in brackets where some are wanted: ``agents[onnx]``, ``service[server]``.
An image can install these with only the pyproject files, before it has the sources.
"""

import sys
import tomllib
from pathlib import Path

needed: set[str] = set()
for argument in sys.argv[1:]:
    part, _, extras = argument.rstrip("]").partition("[")
    project = tomllib.loads(Path(part, "pyproject.toml").read_text())["project"]
    needed.update(project["dependencies"])
    for extra in extras.split(",") if extras else ():
        needed.update(project["optional-dependencies"][extra])
print("\n".join(sorted(requirement for requirement in needed if not requirement.startswith("wrongturn-"))))
