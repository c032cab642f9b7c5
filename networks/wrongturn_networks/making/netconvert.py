"""Building of a town's folder with SUMO's netconvert."""

import functools
import importlib.util
import json
import subprocess
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, Final

from wrongturn_networks.loading import read_town
from wrongturn_networks.making import plain_xml
from wrongturn_networks.making.placing import place_scenery
from wrongturn_networks.making.recipes import Recipe
from wrongturn_networks.netfile import sha256_of
from wrongturn_networks.scenery import scenery_toml, sha256_of_scenery
from wrongturn_protocol.installing import install

OPTIONS: Final = (
    "--no-turnarounds",
    "--walkingareas",
    "--junctions.corner-detail=8",
    "--junctions.internal-link-detail=12",
    "--offset.disable-normalization",
)


def netconvert() -> Path:
    """Return the path of SUMO's netconvert. Raises RuntimeError if SUMO is not installed."""
    # Not imported: the package changes this process's environment, which libsumo reads.
    found = importlib.util.find_spec("sumo")
    if found is None or found.origin is None:
        raise RuntimeError(f"SUMO's netconvert is missing; {install('eclipse-sumo')}")
    return Path(found.origin).parent / "bin" / "netconvert"


@functools.cache
def version() -> str:
    """Return netconvert's version. Raises RuntimeError if SUMO is not installed."""
    said = subprocess.run([netconvert(), "--version"], capture_output=True, text=True, check=True).stdout
    return said.splitlines()[0].split()[-1]


def build(recipe: Recipe, folder: Path, **told: Any) -> None:
    """Write a town's folder, with the same bytes each time. ``told`` is kept in its manifest.

    Raises RuntimeError if netconvert rejects the recipe.
    """
    folder.mkdir(parents=True, exist_ok=True)
    nodes, edges = folder / f"{recipe.name}.nod.xml", folder / f"{recipe.name}.edg.xml"
    nodes.write_text(plain_xml.nodes_xml(recipe), "utf-8")
    edges.write_text(plain_xml.edges_xml(recipe), "utf-8")
    net = folder / f"{recipe.name}.net.xml"
    with tempfile.TemporaryDirectory() as scratch:
        raw = Path(scratch) / net.name
        # Its input is ours, so that it need not look for the schemas to check it by.
        command: list[str | Path] = [netconvert(), "-X", "never", "-n", nodes, "-e", edges, "-o", raw, *OPTIONS]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"netconvert rejects {recipe.name}: {done.stderr.strip()}")
        # Parsing drops netconvert's header comment, which holds the time and paths of this run.
        tree = ET.parse(raw)
        tree.write(net, "utf-8", xml_declaration=True)
    (folder / "scenery.toml").unlink(missing_ok=True)
    _write_manifest(recipe, folder, told)
    (folder / "scenery.toml").write_text(
        scenery_toml(place_scenery(read_town(folder), recipe.seed, recipe.styles)), "utf-8"
    )
    _write_manifest(recipe, folder, told)


def _write_manifest(recipe: Recipe, folder: Path, told: dict[str, Any]) -> None:
    manifest = {
        "town": recipe.name,
        "sumo": version(),
        "options": list(OPTIONS),
        "seed": recipe.seed,
        "radii": recipe.radii(),
        "net_sha256": sha256_of(folder / f"{recipe.name}.net.xml"),
        "scenery_sha256": sha256_of_scenery(folder / "scenery.toml"),
        **told,
    }
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n", "utf-8")
