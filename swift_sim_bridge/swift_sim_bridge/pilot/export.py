"""The policy as an ONNX file: written node by node, then compared with the network it was written from."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from swift_ros.errors import UsageError
from swift_ros.policy.observation import SIZE as OBSERVATION_SIZE
from swift_sim_bridge.model_files import checkpoint, onnx_file, provenance
from swift_sim_bridge.pilot import networks

# Largest difference between an action of the file and of the network, in [-1, 1]: above the rounding of float32, 1e-7,
# and at most 0.001 rad/s of a body rate of the shipped vehicle.
MAX_DIFFERENCE = 1e-4


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
    constants += [
        numpy_helper.from_array(np.array(limit, np.float32), name) for limit, name in ((-1, "low"), (1, "high"))
    ]
    nodes.append(helper.make_node("Clip", [value, "low", "high"], ["action"]))
    graph = helper.make_graph(
        nodes,
        "pilot",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, [1, observation_size])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, 4])],
        constants,
    )
    onnx_file.write_model(path, graph)


def read_actor(path: Path, like) -> list:
    """Return the actor of an ONNX file that `write_actor` wrote, with the same numbers.

    Args:
        path: the file.
        like: an actor of the same shapes.

    Raises:
        UsageError: the file is no such actor.
    """
    try:
        stored = {one.name: numpy_helper.to_array(one) for one in onnx.load(path).graph.initializer}
        actor = [(jnp.asarray(stored[f"weight_{i}"]), jnp.asarray(stored[f"bias_{i}"])) for i in range(len(like))]
    except Exception as error:  # those of onnx and protobuf differ between releases
        raise UsageError(
            f"{path} is not a pilot of `swiftros train policy`; name a pilot.npz or a pilot.onnx"
        ) from error
    if [part.shape for layer in actor for part in layer] != [part.shape for layer in like for part in layer]:
        raise UsageError(f"{path} is a pilot with other layers than this version trains; start from another")
    return actor


def write_pilot(out: Path, parameters: dict, figures: dict, *, origin: provenance.Origin) -> None:
    """Write pilot.npz, from which another training can start, pilot.onnx and pilot.json.

    Args:
        out: the folder.
        parameters: {"actor", "critic"}, see `networks`.
        figures: what was measured; goes into pilot.json.
        origin: where the pilot comes from.

    Raises:
        RuntimeError: the ONNX file differs from the network.
    """
    checkpoint.save(out / "pilot.npz", parameters, record={"trained_for": origin.trained_for})
    model = out / "pilot.onnx"
    write_actor(model, parameters["actor"], OBSERVATION_SIZE)
    inputs = np.random.default_rng(0).normal(0.0, 0.5, (100, 1, OBSERVATION_SIZE)).astype(np.float32)
    difference = onnx_file.largest_difference(
        model, lambda x: np.clip(networks.apply(parameters["actor"], x), -1.0, 1.0), inputs
    )
    if difference > MAX_DIFFERENCE:
        raise RuntimeError(f"{model} differs by {difference:.1e} from the network it was written from")
    provenance.write_provenance(model, origin, figures | {"onnx_parity": difference})
