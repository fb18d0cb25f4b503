"""ONNX: any damage of a model gives a network that runs, or one sentence that names the file."""

import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from fuzzing import budget, count, edited, edits, result_or_refusal
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper

from swift_ros import configuration
from swift_ros.errors import UsageError
from swift_ros.perception.corner_network import CORNER_MAPS, EDGE_FIELDS, INPUT, CornerNetwork
from swift_ros.policy.actor import ACTION_SIZE, Actor
from swift_ros.policy.observation import SIZE

MODELS = configuration.configuration_folder() / "models"
PATH = Path(tempfile.mkdtemp(prefix="swift-fuzz-")) / "model.onnx"
SIDE, STRIDE = 16, 4
OPERATORS = (
    "MatMul",
    "Add",
    "Gemm",
    "Relu",
    "Cast",
    "Reshape",
    "Concat",
    "Softmax",
    "NoSuchOperator",
    "Loop",
    "If",
    "",
)
SIZES = st.sampled_from((0, 1, 2, 3, SIZE, -1, 1 << 30, 1 << 60, -(1 << 63)))


def pilot() -> bytes:
    """Return a pilot of one layer."""
    weights = np.random.default_rng(0).standard_normal((SIZE, ACTION_SIZE)).astype(np.float32)
    nodes = [helper.make_node("MatMul", ["x", "w"], ["h"]), helper.make_node("Tanh", ["h"], ["y"])]
    inputs = [helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, SIZE])]
    outputs = [helper.make_tensor_value_info("y", TensorProto.FLOAT, [1, ACTION_SIZE])]
    initializer = [helper.make_tensor("w", TensorProto.FLOAT, weights.shape, weights.tobytes(), raw=True)]
    return model_of(helper.make_graph(nodes, "pilot", inputs, outputs, initializer), {})


def detector() -> bytes:
    """Return a gate detector of one convolution for each output."""
    nodes = [helper.make_node("Cast", [INPUT], ["x"], to=TensorProto.FLOAT)]
    outputs, weights = [], []
    for name, channels in ((CORNER_MAPS, 4), (EDGE_FIELDS, 8)):
        kernel = np.full((channels, 1, STRIDE, STRIDE), 1e-3, np.float32)
        weights.append(helper.make_tensor(f"w_{name}", TensorProto.FLOAT, kernel.shape, kernel.tobytes(), raw=True))
        nodes.append(helper.make_node("Conv", ["x", f"w_{name}"], [name], strides=[STRIDE, STRIDE]))
        shape = [1, channels, SIDE // STRIDE, SIDE // STRIDE]
        outputs.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, shape))
    inputs = [helper.make_tensor_value_info(INPUT, TensorProto.UINT8, [1, 1, SIDE, SIDE])]
    graph = helper.make_graph(nodes, "detector", inputs, outputs, weights)
    return model_of(graph, {"stride": str(STRIDE), "pixels_per_radian": "20.0"})


def model_of(graph, metadata: dict[str, str]) -> bytes:
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    helper.set_model_props(model, metadata)
    return model.SerializeToString()


CONTENTS = {"pilot": pilot(), "detector": detector()}


def assert_runs(kind: str, content: bytes) -> None:
    """Load a model file and run it once."""
    PATH.write_bytes(content)
    if kind == "pilot":
        assert Actor(PATH).act(np.zeros(SIZE)).shape == (ACTION_SIZE,)
    else:
        network = CornerNetwork(PATH)
        side = network.shape.panorama.side
        network.maps(np.zeros((side, side), np.uint8))


def assert_run_or_refused(kind: str, content: bytes) -> None:
    found = result_or_refusal(partial(assert_runs, kind, content))
    count("onnx", valid=not isinstance(found, UsageError))


def test_the_unmodified_models_are_run():
    for kind, content in CONTENTS.items():
        assert_runs(kind, content)
    assert_runs("pilot", (MODELS / "pilot.onnx").read_bytes())
    assert_runs("detector", (MODELS / "gate_detector.onnx").read_bytes())


def test_a_model_of_the_other_kind_is_refused():
    for kind, content in zip(("detector", "pilot"), CONTENTS.values(), strict=True):
        assert isinstance(result_or_refusal(partial(assert_runs, kind, content)), UsageError)


@budget(0.1)
@given(st.sampled_from(sorted(CONTENTS)), st.binary(max_size=200))
def test_any_bytes_are_run_or_refused(kind, content):
    assert_run_or_refused(kind, content)


@budget(0.5)
@given(st.sampled_from(sorted(CONTENTS)), edits())
def test_a_damaged_model_is_run_or_refused(kind, changes):
    assert_run_or_refused(kind, edited(CONTENTS[kind], changes))


@budget(0.4)
@given(
    st.sampled_from(sorted(CONTENTS)),
    st.lists(
        st.tuples(st.integers(0, 8), st.integers(0, 9), SIZES, st.sampled_from(OPERATORS)), min_size=1, max_size=3
    ),
)
def test_a_model_of_another_structure_is_run_or_refused(kind, changes):
    model = onnx.ModelProto.FromString(CONTENTS[kind])
    for change in changes:
        restructure(model, *change)
    assert_run_or_refused(kind, model.SerializeToString())


def restructure(model: onnx.ModelProto, what: int, number: int, size: int, operator: str) -> None:
    """Change one part of a model, chosen by two drawn numbers."""
    graph = model.graph
    node, weight = graph.node[number % len(graph.node)], graph.initializer[number % len(graph.initializer)]
    values = [*graph.input, *graph.output]
    match what:
        case 0:
            node.op_type = operator
        case 1:
            weight.dims[number % len(weight.dims)] = size
        case 2:
            shape = values[number % len(values)].type.tensor_type.shape.dim
            shape[number % len(shape)].dim_value = size
        case 3:
            values[number % len(values)].type.tensor_type.elem_type = size % 30
        case 4:
            node.input[0] = node.output[0]
        case 5:
            weight.data_type = size % 30
        case 6:
            weight.raw_data = weight.raw_data[: size % 100]
        case 7:
            for row in model.metadata_props:
                row.value = str(size)
        case _:
            model.ir_version, model.opset_import[0].version = size % 1000, size % 100


onnxruntime.set_default_logger_severity(4)  # the texts of refused models are in the exceptions
