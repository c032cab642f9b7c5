"""Building of a town's folder with SUMO's netconvert."""

import json
import subprocess
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Final

from wrongturn_networks.loading import read_town
from wrongturn_networks.making import plain_xml
from wrongturn_networks.making.placing import place_scenery
from wrongturn_networks.making.recipes import Recipe
from wrongturn_networks.netfile import sha256_of
from wrongturn_networks.scenery import scenery_toml, sha256_of_scenery

OPTIONS: Final = (
    "--no-turnarounds",
    "--walkingareas",
    "--junctions.corner-detail=8",
    "--junctions.internal-link-detail=12",
    "--offset.disable-normalization",
)


def netconvert() -> Path:
    """Return the path of SUMO's netconvert. Raises RuntimeError if SUMO is not installed."""
    try:
        import sumo  # noqa: PLC0415 - only building towns needs it
    except ImportError as error:
        raise RuntimeError("netconvert is missing; pip install 'wrongturn-networks[making]'") from error
    return Path(sumo.SUMO_HOME) / "bin" / "netconvert"


def build(recipe: Recipe, folder: Path) -> None:
    """Write a town's folder, with the same bytes each time. Raises RuntimeError if netconvert rejects the recipe."""
    folder.mkdir(parents=True, exist_ok=True)
    nodes, edges = folder / f"{recipe.name}.nod.xml", folder / f"{recipe.name}.edg.xml"
    nodes.write_text(plain_xml.nodes_xml(recipe), "utf-8")
    edges.write_text(plain_xml.edges_xml(recipe), "utf-8")
    net = folder / f"{recipe.name}.net.xml"
    with tempfile.TemporaryDirectory() as scratch:
        raw = Path(scratch) / net.name
        done = subprocess.run(
            [netconvert(), "-n", nodes, "-e", edges, "-o", raw, *OPTIONS], capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise RuntimeError(f"netconvert rejects {recipe.name}: {done.stderr.strip()}")
        # Parsing drops netconvert's header comment, which holds the time and paths of this run.
        tree = ET.parse(raw)
        tree.write(net, "utf-8", xml_declaration=True)
    (folder / "scenery.toml").unlink(missing_ok=True)
    _write_manifest(recipe, folder)
    (folder / "scenery.toml").write_text(scenery_toml(place_scenery(read_town(folder), recipe.seed)), "utf-8")
    _write_manifest(recipe, folder)


def _write_manifest(recipe: Recipe, folder: Path) -> None:
    version = subprocess.run([netconvert(), "--version"], capture_output=True, text=True, check=True).stdout
    manifest = {
        "town": recipe.name,
        "sumo": version.splitlines()[0].split()[-1],
        "options": list(OPTIONS),
        "seed": recipe.seed,
        "radii": recipe.radii(),
        "net_sha256": sha256_of(folder / f"{recipe.name}.net.xml"),
        "scenery_sha256": sha256_of_scenery(folder / "scenery.toml"),
    }
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n", "utf-8")
