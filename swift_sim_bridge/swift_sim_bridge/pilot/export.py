"""Networks as ONNX files that fly: written node by node, then held against the network they came from."""

import os
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper

from swift_ros.policy.observation import SIZE as OBSERVATION_SIZE
from swift_sim_bridge.model_files import checkpoint, provenance
from swift_sim_bridge.pilot import networks

OPSET = 17
LARGEST_DIFFERENCE = 1e-4  # between the actions of the file and of the network, of 1
IR_VERSION = 8  # old enough for every ONNX Runtime that flies


def write_actor(path: Path, actor, observation_size: int) -> None:
    """Write the actor as ONNX: `observation` [1, n] float32 -> `action` [1, 4], the mean clipped to [-1, 1]."""
    nodes, constants, value = [], [], "observation"
    for i, (weight, bias) in enumerate(actor):
        constants += [numpy_helper.from_array(np.asarray(weight, np.float32), f"weight_{i}")]
        constants += [numpy_helper.from_array(np.asarray(bias, np.float32), f"bias_{i}")]
        nodes.append(helper.make_node("Gemm", [value, f"weight_{i}", f"bias_{i}"], [f"linear_{i}"]))
        value = f"linear_{i}"
        if i < len(actor) - 1:
            nodes.append(helper.make_node("LeakyRelu", [value], [f"hidden_{i}"], alpha=networks.SLOPE))
            value = f"hidden_{i}"
    constants += [numpy_helper.from_array(np.float32(limit), name) for limit, name in ((-1, "low"), (1, "high"))]
    nodes.append(helper.make_node("Clip", [value, "low", "high"], ["action"]))
    graph = helper.make_graph(
        nodes,
        "pilot",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, [1, observation_size])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, 4])],
        constants,
    )
    write_model(path, graph)


def write_model(path: Path, graph, metadata: dict[str, str] | None = None) -> None:
    """Check an ONNX graph and write it with its metadata, replacing the file at once or not at all."""
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)])
    helper.set_model_props(model, metadata or {})
    model.ir_version = IR_VERSION
    onnx.checker.check_model(model)
    partial = Path(path).with_suffix(".partial")
    partial.write_bytes(model.SerializeToString())
    os.replace(partial, path)


def largest_difference(path: Path, network, inputs) -> float:
    """Return the largest difference between the ONNX file at `path` and `network` (a function of one input) over
    `inputs` (k, 1, ...): the parity that a shipped model must show."""
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    differences = [np.max(np.abs(session.run(None, {name: x})[0] - np.asarray(network(x)))) for x in inputs]
    return float(np.max(differences))


def write_pilot(out: Path, parameters: dict, result: dict, *, command: str, configuration: str, seed: int) -> None:
    """Write best.npz, pilot.onnx and pilot.json into `out`. Raises RuntimeError when the ONNX file differs."""
    checkpoint.save(out / "best.npz", parameters, fingerprint=configuration)
    model = out / "pilot.onnx"
    write_actor(model, parameters["actor"], OBSERVATION_SIZE)
    inputs = np.random.default_rng(0).normal(0.0, 0.5, (100, 1, OBSERVATION_SIZE)).astype(np.float32)
    difference = largest_difference(model, lambda x: np.clip(networks.apply(parameters["actor"], x), -1.0, 1.0), inputs)
    if difference > LARGEST_DIFFERENCE:
        raise RuntimeError(f"{model} answers {difference:.1e} away from the network it was written from")
    figures = result | {"onnx_parity": difference}
    provenance.write_provenance(model, command=command, configuration=configuration, seed=seed, figures=figures)
