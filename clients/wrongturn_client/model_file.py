"""A look at a model's file before it is handed in: the mistakes that its first bytes, inputs and outputs show."""

import shlex
from collections.abc import Collection
from pathlib import Path
from typing import Final

from wrongturn_client.errors import ModelFileError
from wrongturn_client.invocation import program
from wrongturn_protocol import ContractError, Track, contract_of, signature_of
from wrongturn_protocol.onnx_file import check_whole

_HEAD: Final = 64
"""Bytes that tell other kinds of files apart."""
_ZIP: Final = b"PK\x03\x04"
_EXPORT: Final = "export the model to ONNX, for example by torch.onnx.export"
_PICKLE: Final = f"is a pickle, which can run any code and is never loaded; {_EXPORT}"
_OTHERS: Final = {
    **{bytes((0x80, protocol)): _PICKLE for protocol in range(2, 6)},
    b"version https://git-lfs": "is only a pointer of Git LFS; fetch the file by 'git lfs pull'",
    _ZIP: f"is a zip file, as torch.save writes it, and holds pickles, which are never loaded; {_EXPORT}",
}
"""What a file is that begins so, and what to do."""


def check_model_file(path: Path) -> None:
    """Raise ModelFileError, which says what to do, unless a file may be an ONNX file."""
    if why := _why_no_model(path):
        raise ModelFileError(f"FILE: {path} {why}")


def _why_no_model(path: Path) -> str | None:
    if path.is_dir():
        return "is a folder; name the .onnx file in it"
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError as error:
        return f"cannot be read: {error.strerror or error}"
    if not head:
        return "is empty; export the model again"
    if head.startswith(_ZIP) and path.suffix.lower() == ".zip":
        zipped, onnx = shlex.quote(str(path)), shlex.quote(str(path.with_suffix(".onnx")))
        return (
            "is a zip file. If Stable-Baselines3 saved it, export it first: "
            f"{program()} export sb3 {zipped} --out {onnx}, then hand in {onnx}"
        )
    for begin, what in _OTHERS.items():
        if head.startswith(begin):
            return what
    if path.name.lower() == ".onnx":
        return "has no name before .onnx; rename it, for example to my_agent.onnx"
    if path.suffix.lower() != ".onnx":
        return "does not end in .onnx; hand in a model in ONNX's format"
    return None


def check_contract(path: Path, tracks: Collection[Track]) -> None:
    """Raise ModelFileError unless a model keeps the contract of ``docs/models.md`` in one of a suite's tracks.

    The service checks it again, with onnxruntime.
    """
    try:
        contract_of(signature_of(path), tracks)
        check_whole(path)
    except OSError as error:
        raise ModelFileError(f"FILE: {path} cannot be read: {error.strerror or error}") from error
    except ContractError as error:
        raise ModelFileError(f"FILE: {path}: {error}") from error
