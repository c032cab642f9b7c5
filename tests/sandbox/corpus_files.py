"""Files that are no ONNX model, or one of a version that nobody reads."""

import gzip
import io
import pickle
import random
import zipfile
from pathlib import Path

from onnx import helper
from upload_models import By, Case, model, proto

MARK = Path("/tmp/wrongturn-corpus-was-run")
"""A file that a pickle of the corpus would make if anything loaded it."""


class _Payload:
    def __reduce__(self) -> object:
        return (Path.touch, (MARK,))


def _zip(*contents: tuple[str, bytes]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents:
            archive.writestr(name, content)
    return file.getvalue()


def _zip_bomb() -> bytes:
    inner = _zip(("zeros", bytes(20_000_000)))
    return _zip(*((f"{number}.zip", inner) for number in range(50)))


def _of_opsets(*opsets: tuple[str, int]) -> bytes:
    made = proto()
    del made.opset_import[:]
    made.opset_import.extend(helper.make_opsetid(*opset) for opset in opsets)
    return bytes(made.SerializeToString())


def _without_graph() -> bytes:
    made = proto()
    made.ClearField("graph")
    return bytes(made.SerializeToString())


FILES = (
    Case("empty", lambda: b"", "empty"),
    Case("text", lambda: b"import torch\nmodel = torch.load('model.pt')\n" * 20, "text"),
    Case("html", lambda: b"<!DOCTYPE html><html><body>404 Not Found</body></html>", "text"),
    Case("json", lambda: b'{"message": "Not Found"}', "text"),
    Case("pickle", lambda: pickle.dumps(_Payload()), "pickle"),
    Case("zip", lambda: _zip(("../../etc/cron.d/evil", b"x"), ("data", b"y")), "zip archive"),
    Case("zip-bomb", _zip_bomb, "zip archive"),
    Case("gzip-bomb", lambda: gzip.compress(bytes(50_000_000)), "gzip"),
    Case("onnxruntime-format", lambda: b"\x1c\0\0\0ORTM" + bytes(4000), "onnxruntime's own format"),
    Case("program", lambda: b"\x7fELF\x02\x01\x01" + bytes(1000), "program"),
    Case("git-lfs-pointer", lambda: b"version https://git-lfs.github.com/spec/v1\nsize 1\n", "git lfs"),
    Case("noise", lambda: b"\0" + random.Random(1).randbytes(100_000), "no ONNX model"),
    Case("zeros", lambda: bytes(1_000_000), "no ONNX model"),
    Case("cut-off", lambda: model()[:-20], "cut off"),
    Case("a-gibibyte-and-more", model, "bytes", By.SIZE, length=(1 << 30) + 1),
    Case("no-graph", _without_graph, "no graph"),
    Case("ir-version", lambda: model(ir=99), "IR version 99"),
    Case("opset-of-the-future", lambda: model(opset=99), "opset 99"),
    Case("opset-of-the-past", lambda: model(opset=1), "opset 1"),
    Case("opset-missing", lambda: _of_opsets(("com.example", 1)), "exactly one"),
    Case("opset-twice", lambda: _of_opsets(("", 18), ("ai.onnx", 17)), "exactly one"),
    Case("opset-negative", lambda: _of_opsets(("", -(1 << 62))), "opset"),
)
"""No models."""
