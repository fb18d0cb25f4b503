"""ONNX files of trained networks: checked when written, and compared with the network they were written from."""

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from onnx import helper

from swift_sim_bridge.model_files.whole_file import replacing

OPSET = 17  # has every operator of the exported networks
IR_VERSION = 8  # old enough for every ONNX Runtime that runs onboard


def write_model(path: Path, graph, metadata: dict[str, str] | None = None) -> None:
    """Check an ONNX graph and write it with its metadata; the file is replaced at once or not at all."""
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)])
    helper.set_model_props(model, metadata or {})
    model.ir_version = IR_VERSION
    onnx.checker.check_model(model)
    with replacing(path) as partial:
        partial.write_bytes(model.SerializeToString())


def largest_difference(path: Path, network, inputs) -> float:
    """Return the largest difference between the first output of an ONNX file and a network.

    Args:
        path: the ONNX file, of one input.
        network: function of one input, the network that the file was written from.
        inputs: (k, 1, ...), one row a call.
    """
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    differences = [np.max(np.abs(session.run(None, {name: x})[0] - np.asarray(network(x)))) for x in inputs]
    return float(np.max(differences))
