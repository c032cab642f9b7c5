"""Driving weights as they travel: half precision, in parts small enough for anything, and joined again.

``python -m wrongturn_agents.training.bundle MANIFEST.json CHECKPOINT.pt`` joins them.
"""

import argparse
import hashlib
import io
import json
import os
from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor

from wrongturn_agents.training.checkpoint import UNDRIVEN, load_checkpoint
from wrongturn_agents.training.errors import TrainingError

PART: Final = 15_000_000
"""Bytes of a part at most."""


def split(checkpoint: Path, folder: Path, name: str) -> Path:
    """Write a checkpoint's driving weights into a folder, in parts, and drop an older one of the same name.

    What only learning needs is left out; matrices and convolutions become float16, the rest stays. It may be
    interrupted at any time: the manifest is written last, and names parts that are all there.

    Args:
        checkpoint: a run's ``best.pt``.
        folder: where to.
        name: of the manifest, ``NAME.json``.

    Returns:
        The manifest.

    Raises:
        TrainingError: the checkpoint is none.
    """
    told = load_checkpoint(checkpoint)
    told["state_dict"] = {
        key: _halved(tensor) for key, tensor in told["state_dict"].items() if not key.startswith(UNDRIVEN)
    }
    memory = io.BytesIO()
    torch.save(told, memory)
    content = memory.getvalue()
    digest = hashlib.sha256(content).hexdigest()
    folder.mkdir(parents=True, exist_ok=True)
    parts = []
    for number, begin in enumerate(range(0, len(content), PART)):
        part = content[begin : begin + PART]
        file = folder / f"{name}.{digest[:8]}.{number}.part"
        replace(file, part)
        parts.append({"file": file.name, "bytes": len(part), "sha256": hashlib.sha256(part).hexdigest()})
    manifest: dict[str, Any] = {
        "algorithm": told["algorithm"],
        "seed": told["seed"],
        "steps": told["steps"],
        "evaluation": told["evaluation"],
        "bytes": len(content),
        "sha256": digest,
        "parts": parts,
    }
    path = folder / f"{name}.json"
    replace(path, (json.dumps(manifest, indent=1) + "\n").encode())
    for old in folder.glob(f"{name}.*.part"):
        if old.name not in {part["file"] for part in parts}:
            old.unlink()
    return path


def join(manifest: Path, checkpoint: Path) -> None:
    """Write the checkpoint that :func:`split` took apart, as ``wrongturn score`` and ``wrongturn export`` read it.

    Raises:
        TrainingError: a part is missing or broken.
    """
    try:
        told = json.loads(manifest.read_text("utf-8"))
        content = b"".join(_part(manifest.parent / part["file"], part["sha256"]) for part in told["parts"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise TrainingError(f"{manifest}: cannot be read ({error}); name the manifest of a bundle") from error
    if hashlib.sha256(content).hexdigest() != told["sha256"]:
        raise TrainingError(f"{manifest}: the parts do not make the whole; fetch them again")
    whole = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    whole["state_dict"] = {
        key: tensor.float() if tensor.is_floating_point() else tensor for key, tensor in whole["state_dict"].items()
    }
    memory = io.BytesIO()
    torch.save(whole, memory)
    replace(checkpoint, memory.getvalue())


def replace(path: Path, content: bytes) -> None:
    """Write a file in one go."""
    beside = path.with_name(f".{path.name}.new")
    with beside.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)


def _halved(tensor: Tensor) -> Tensor:
    # Scales, offsets and statistics are few, and a variance may be out of half precision's range.
    return tensor.half() if tensor.is_floating_point() and tensor.ndim > 1 else tensor


def _part(path: Path, digest: str) -> bytes:
    if not path.is_file():
        raise TrainingError(f"{path}: is missing; fetch it, too")
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != digest:
        raise TrainingError(f"{path}: is broken; fetch it again")
    return content


def _main() -> None:
    parser = argparse.ArgumentParser(prog="python -m wrongturn_agents.training.bundle", description=__doc__)
    parser.add_argument("manifest", type=Path)
    parser.add_argument("checkpoint", type=Path)
    arguments = parser.parse_args()
    join(arguments.manifest, arguments.checkpoint)


if __name__ == "__main__":
    _main()
