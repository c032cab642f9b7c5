"""Virtual environments that have only what some distributions need, made of links to what is installed here."""

import os
import re
import subprocess
import venv
import zipfile
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
SOURCES = {
    "client": "clients",
    "networks": "networks",
    "service": "service",
    "agents": "agents",
    "certificates": "plugins/certificates",
    "exploits": "plugins/exploits",
    "figures": "plugins/figures",
    "lbc": "plugins/lbc",
    "marln": "plugins/marln",
    "openenv": "plugins/openenv",
    "ray": "plugins/ray",
    "sb3": "plugins/sb3",
    "statistics": "plugins/statistics",
}


def distribution_name(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


class Wheels:
    """The wheels in a folder, by the name of their distribution."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.paths = {distribution_name(file.name.split("-")[0]): file for file in folder.glob("*.whl")}

    def metadata(self, name: str) -> metadata.Distribution:
        """Return a wheel's metadata, or those of a distribution of others that is installed."""
        if name not in self.paths:
            return metadata.distribution(name)
        wheel = zipfile.ZipFile(self.paths[name])
        (info,) = {file.split("/")[0] for file in wheel.namelist() if ".dist-info/" in file}
        return metadata.PathDistribution(zipfile.Path(wheel, f"{info}/"))  # type: ignore[arg-type]

    def closure(self, *wanted: str) -> set[str]:
        """Return the names of all distributions that pip would install for some requirements."""
        done: set[tuple[str, str]] = set()
        open_ = [Requirement(text) for text in wanted]
        while open_:
            one = open_.pop()
            name = distribution_name(one.name)
            for extra in {"", *one.extras} - {extra for known, extra in done if known == name}:
                done.add((name, extra))
                needed = [Requirement(text) for text in self.metadata(name).requires or ()]
                open_ += [line for line in needed if line.marker is None or line.marker.evaluate({"extra": extra})]
        return {name for name, _ in done}

    def install(self, folder: Path, *wanted: str) -> "BareEnvironment":
        """Make an environment for some requirements.

        Our own parts' code is that of the working tree, so that numba finds its compiled kernels.
        """
        environment = BareEnvironment(folder)
        sources = []
        for name in sorted(self.closure(*wanted)):
            if name in self.paths:
                with zipfile.ZipFile(self.paths[name]) as wheel:
                    info = [file for file in wheel.namelist() if ".dist-info/" in file]
                    wheel.extractall(environment.packages, info)
            else:
                link_files(metadata.distribution(name), environment.packages)
            if name.removeprefix("wrongturn-") in SOURCES:
                sources.append(str(ROOT / SOURCES[name.removeprefix("wrongturn-")]))
        (environment.packages / "sources.pth").write_text("\n".join(sources))
        return environment


def link_files(distribution: metadata.Distribution, folder: Path) -> None:
    """Link the packages, modules and metadata of an installed distribution into a folder."""
    for top in {file.parts[0] for file in distribution.files or ()} - {"..", "__pycache__"}:
        if not (folder / top).exists():
            (folder / top).symlink_to(str(distribution.locate_file(top)))


class BareEnvironment:
    """A virtual environment without pip."""

    def __init__(self, folder: Path) -> None:
        venv.create(folder, symlinks=True)
        (self.packages,) = folder.glob("lib/python*/site-packages")
        self._python = folder / "bin/python"

    def python(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        """Run Python in this environment."""
        left_out = ("WRONGTURN_URL", "WRONGTURN_TOKEN", "PYTHONPATH", "VIRTUAL_ENV")
        return subprocess.run(
            [self._python, *arguments],
            env={name: value for name, value in os.environ.items() if name not in left_out},
            capture_output=True,
            text=True,
            check=False,
        )

    def wrongturn(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        """Run the program ``wrongturn`` in this environment."""
        return self.python("-m", "wrongturn_client", *arguments)
