"""What to type to install what is missing, in the way in which Wrongturn itself was installed."""

import json
import re
import shlex
import sys
import tomllib
from importlib.metadata import Distribution, PackageNotFoundError, entry_points
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote, urlsplit

_OURS: Final = re.compile(r"(wrongturn[\w-]*)(?:\[([\w,-]*)\])?")


class NotInstalledError(ValueError):
    """What is wanted is not installed. The message says how to install it."""


def ray(name: str) -> Any:
    """Return what the package wrongturn-ray adds to ``wrongturn.ray`` under a name. Raises NotInstalledError."""
    for point in entry_points(group="wrongturn.ray", name=name):
        return point.load()
    raise NotInstalledError(f"needs Ray, which is not installed; install it with: {install('wrongturn-ray')}")


def python() -> str:
    """Return this interpreter's path, quoted for a shell."""
    return shlex.quote(sys.executable)


def install(*wanted: str) -> str:
    """Return the command that installs requirements, such as ``wrongturn-agents[onnx]``.

    Parts of ours come from the clone that the client came from, else from a folder of wheels: no index has them.
    """
    pip, ours = f"{python()} -m pip install", any(_OURS.match(one) for one in wanted)
    if not ours:
        return f"{pip} {shlex.join(wanted)}"
    clone, editable = _clone()
    folders = {} if clone is None else _folders(clone)
    if clone is None or not all(one.partition("[")[0] in folders for one in wanted):
        return f"{pip} -c dist/constraints.txt --find-links dist {shlex.join(wanted)}"
    parts: dict[str, str] = {}
    for one in wanted:
        _add(one, folders, parts)
    found = [word for part in parts.values() for word in (["-e"] if editable else []) + [part]]
    return f"{pip} -c {shlex.join([str(clone / 'constraints.txt'), *found])}"


def _add(wanted: str, folders: dict[str, Path], parts: dict[str, str]) -> None:
    """Add the folder of a part, and those of the parts that it needs and that are not installed."""
    name, _, extras = wanted.rstrip("]").partition("[")
    parts[name] = f"{folders[name]}[{extras}]" if extras else str(folders[name])
    project = tomllib.loads((folders[name] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needs = list(project.get("dependencies", ()))
    for extra in extras.split(","):
        needs += project.get("optional-dependencies", {}).get(extra, ())
    for need in needs:
        match = _OURS.match(need)
        if match and match[1] not in parts and match[1] in folders and (match[2] or not _is_installed(match[1])):
            _add(match[0], folders, parts)


def _is_installed(name: str) -> bool:
    try:
        Distribution.from_name(name)
    except PackageNotFoundError:
        return False
    return True


def _clone() -> tuple[Path | None, bool]:
    """Return the clone from whose folder the client was installed (PEP 610), None without one; whether as editable."""
    try:
        told = json.loads(Distribution.from_name("wrongturn-client").read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, ValueError):
        return None, False
    folder = Path(unquote(urlsplit(told.get("url", "")).path)).parent
    found = "dir_info" in told and (folder / "constraints.txt").is_file()
    return (folder, bool(told["dir_info"].get("editable"))) if found else (None, False)


def _folders(clone: Path) -> dict[str, Path]:
    """Return the folder of each part of a clone, by the name of its distribution."""
    files = (*clone.glob("*/pyproject.toml"), *clone.glob("plugins/*/pyproject.toml"))
    return {tomllib.loads(file.read_text(encoding="utf-8"))["project"]["name"]: file.parent for file in files}
