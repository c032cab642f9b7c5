"""A look at a model's file before it is handed in: the mistakes that its first bytes, inputs and outputs show."""

import shlex
from collections.abc import Collection
from pathlib import Path
from typing import Final

from wrongturn_client.errors import ModelFileError
from wrongturn_client.invocation import program
from wrongturn_protocol import ContractError, Track, contract_of, signature_of

_HEAD: Final = 64
"""Bytes that tell the kinds below apart."""
_ZIP: Final = b"PK\x03\x04"
_PICKLE: Final = tuple(bytes((0x80, protocol)) for protocol in range(2, 6))
_LFS: Final = b"version https://git-lfs"


def check_model_file(path: Path) -> None:
    """Raise ModelFileError, which says what to do, unless a file may be an ONNX file."""
    try:
        if path.is_dir():
            raise ModelFileError(f"FILE: {path} is a folder; name the .onnx file in it")
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError as error:
        raise ModelFileError(f"FILE: {path} cannot be read: {error.strerror or error}") from error
    if not head:
        raise ModelFileError(f"FILE: {path} is empty; export the model again")
    if head.startswith(_ZIP):
        raise ModelFileError(f"FILE: {path} {_of_zip(path)}")
    if head.startswith(_PICKLE):
        raise ModelFileError(
            f"FILE: {path} is a pickle, which can run any code and is never loaded; export the model to ONNX, "
            "for example by torch.onnx.export"
        )
    if head.startswith(_LFS):
        raise ModelFileError(f"FILE: {path} is only a pointer of Git LFS; fetch the file by 'git lfs pull'")
    if path.name.lower() == ".onnx":
        raise ModelFileError(f"FILE: {path} has no name before .onnx; rename it, for example to my_agent.onnx")
    if path.suffix.lower() != ".onnx":
        raise ModelFileError(f"FILE: {path} does not end in .onnx; hand in a model in ONNX's format")


def check_contract(path: Path, tracks: Collection[Track]) -> None:
    """Raise ModelFileError unless a model keeps the contract of ``docs/models.md`` in one of a suite's tracks.

    The service checks it again, with onnxruntime.
    """
    try:
        contract_of(signature_of(path), tracks)
    except OSError as error:
        raise ModelFileError(f"FILE: {path} cannot be read: {error.strerror or error}") from error
    except ContractError as error:
        raise ModelFileError(f"FILE: {path}: {error}") from error


def _of_zip(path: Path) -> str:
    """Return what a zip file is and what to do: Stable-Baselines3 and torch both save zips."""
    if path.suffix.lower() == ".zip":
        zipped, onnx = shlex.quote(str(path)), shlex.quote(str(path.with_suffix(".onnx")))
        return (
            "is a zip file. If Stable-Baselines3 saved it, export it first: "
            f"{program()} export sb3 {zipped} --out {onnx}, then hand in {onnx}"
        )
    return (
        "is a zip file, as torch.save writes it, and holds pickles, which are never loaded; export the model to ONNX, "
        "for example by torch.onnx.export"
    )
