"""What a model's file says of its inputs and outputs, against files that the ``onnx`` package writes."""

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from wrongturn_protocol import ContractError, ModelSignature, TensorSpec, Track, contract_of, signature_of
from wrongturn_protocol.onnx_file import opset_of


def save(path: Path, *, inputs: list[onnx.ValueInfoProto], ir_version: int = 8, data: bool = False) -> Path:
    """Write a model with these inputs, an output ``action`` and a weight."""
    weight = numpy_helper.from_array(np.ones((1000, 100), np.float32), "weight")
    listed = [helper.make_tensor_value_info("weight", TensorProto.FLOAT, [1000, 100])] if data else []
    graph = helper.make_graph(
        [helper.make_node("Identity", ["speed"], ["action"])],
        "graph",
        [*inputs, *listed],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["batch", 3])],
        initializer=[weight],
    )
    opsets = [helper.make_opsetid("ai.onnx.ml", 3), helper.make_opsetid("", 17)]
    model = helper.make_model(graph, opset_imports=opsets, ir_version=ir_version)
    helper.set_model_props(model, {"track": "camera", "name": "größer"})
    onnx.save(model, path)
    return path


ACTION = TensorSpec("action", "float32", ("batch", 3))


def test_a_file_tells_what_its_model_takes_and_gives(tmp_path: Path) -> None:
    inputs = [
        helper.make_tensor_value_info("speed", TensorProto.FLOAT, ["batch", 1]),
        helper.make_tensor_value_info("rgb", TensorProto.UINT8, [1, 64, 192, 3]),
        helper.make_tensor_value_info("command", TensorProto.INT64, [None, 1]),
        helper.make_tensor_value_info("state_in", TensorProto.FLOAT16, None),
    ]
    found = signature_of(save(tmp_path / "a.onnx", inputs=inputs))
    assert found == ModelSignature(
        (
            TensorSpec("speed", "float32", ("batch", 1)),
            TensorSpec("rgb", "uint8", (1, 64, 192, 3)),
            TensorSpec("command", "int64", (None, 1)),
            TensorSpec("state_in", "float16", ()),
        ),
        (ACTION,),
        17,
        {"track": "camera", "name": "größer"},
    )


def test_weights_that_old_files_list_among_the_inputs_are_none(tmp_path: Path) -> None:
    speed = helper.make_tensor_value_info("speed", TensorProto.FLOAT, [1, 1])
    found = signature_of(save(tmp_path / "a.onnx", inputs=[speed], ir_version=3, data=True))
    assert [put.name for put in found.inputs] == ["speed"]
    assert contract_of(found).track is Track.CAMERA


def test_every_type_has_numpys_name(tmp_path: Path) -> None:
    for number in sorted(set(TensorProto.DataType.values()) - {TensorProto.UNDEFINED, TensorProto.BFLOAT16}):
        if number > TensorProto.BFLOAT16:
            continue
        put = helper.make_tensor_value_info("speed", number, [1])
        (found,) = signature_of(save(tmp_path / "a.onnx", inputs=[put])).inputs
        wanted = "string" if number == TensorProto.STRING else helper.tensor_dtype_to_np_dtype(number).name
        assert found.dtype == wanted


def test_what_is_no_tensor_is_told_as_such(tmp_path: Path) -> None:
    sequence = helper.make_tensor_sequence_value_info("speed", TensorProto.FLOAT, [1])
    with pytest.raises(ContractError, match="input speed: takes no tensor; let it take float32"):
        contract_of(signature_of(save(tmp_path / "a.onnx", inputs=[sequence])))


@pytest.mark.parametrize(
    "content", [b"", b"\x00", b"hello", b"\x08\x08", b"\x3a\xff\xff\xff\xff\x0f", b"\x3a\x02\x5a\x05"]
)
def test_a_file_that_is_no_model_is_told(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "a.onnx"
    file.write_bytes(content)
    with pytest.raises(ContractError, match=r"^the file (is no ONNX model|holds no graph)"):
        signature_of(file)
    assert opset_of(file) == 0


def test_a_file_that_is_cut_off_is_no_model(tmp_path: Path) -> None:
    speed = helper.make_tensor_value_info("speed", TensorProto.FLOAT, [1, 1])
    whole = save(tmp_path / "a.onnx", inputs=[speed]).read_bytes()
    for end in (1, 5, 100, len(whole) // 2, len(whole) - 1):
        (tmp_path / "b.onnx").write_bytes(whole[:end])
        with pytest.raises(ContractError):
            signature_of(tmp_path / "b.onnx")


def test_a_file_that_is_not_there_is_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        signature_of(tmp_path / "none.onnx")
