"""The gate detector as an ONNX file: normalisation, network and sigmoid, written node by node.

Input `image` [1, 1, S, S] uint8, a panorama; outputs `corners` [1, 4, S/2, S/2] in 0..1 and `edges` [1, 8, S/2, S/2].
The panorama's geometry and the stride are in the file's metadata.
"""

from pathlib import Path

import jax
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from swift_ros.errors import UsageError
from swift_ros.perception.corner_network import CORNER_MAPS, EDGE_FIELDS, INPUT, CornerNetwork
from swift_sim_bridge.gate_detector import model
from swift_sim_bridge.model_files.onnx_file import write_model


class _Graph:
    """An ONNX graph under construction; each call appends a node or constant and returns the name of its value."""

    def __init__(self):
        self.nodes, self.constants = [], []

    def constant(self, name, values, kind=np.float32):
        self.constants.append(numpy_helper.from_array(np.asarray(values, kind), name))
        return name

    def add(self, operator, inputs, name, **attributes):
        outputs = name if isinstance(name, list) else [name]
        self.nodes.append(helper.make_node(operator, inputs, outputs, **attributes))
        return name

    def convolve(self, value, name, layer):
        """Append a convolution with the weights of a trained layer, HWIO."""
        kernel = np.asarray(layer["kernel"])
        weight = self.constant(f"{name}_kernel", kernel.transpose(3, 2, 0, 1))
        bias = self.constant(f"{name}_bias", layer["bias"])
        margin = [kernel.shape[0] // 2, kernel.shape[1] // 2] * 2
        return self.add("Conv", [value, weight, bias], f"{name}_sum", pads=margin)

    def activate(self, value):
        return self.add("LeakyRelu", [value], f"{value}_on", alpha=model.SLOPE)

    def halve(self, value):
        return self.add("MaxPool", [value], f"{value}_half", kernel_shape=[2, 2], strides=[2, 2])


def _normalize(graph, image):
    """Append `model.normalize`."""
    grey = graph.add("Cast", [image], "grey", to=TensorProto.FLOAT)
    is_lit = graph.add("Greater", [grey, graph.constant("zero", 0.0)], "is_lit")
    lit = graph.add("Cast", [is_lit], "lit", to=TensorProto.FLOAT)
    axes, one = graph.constant("axes", [2, 3], np.int64), graph.constant("one", 1.0)
    count = graph.add("Add", [graph.add("ReduceSum", [lit, axes], "lit_sum"), one], "count")
    mean = graph.add("Div", [graph.add("ReduceSum", [grey, axes], "grey_sum"), count], "mean")
    offset = graph.add("Mul", [graph.add("Sub", [grey, mean], "centred"), lit], "offset")
    square = graph.add("Mul", [offset, offset], "square")
    variance = graph.add("Div", [graph.add("ReduceSum", [square, axes], "square_sum"), count], "variance")
    share = graph.constant("whole_share", model.WHOLE_SHARE)
    floor = graph.add("Mul", [graph.add("Sqrt", [variance], "deviation"), share], "deviation_share")
    floor = graph.add("Add", [floor, one], "least_deviation")
    around_mean, around_deviation = _surroundings(graph, [lit, offset, square])
    difference = graph.add("Mul", [graph.add("Sub", [offset, around_mean], "difference"), lit], "difference_lit")
    divisor = graph.add("Add", [around_deviation, floor], "divisor")
    limits = [graph.constant(f"contrast_{k}", k * model.MOST_CONTRAST) for k in (-1, 1)]
    return graph.add("Clip", [graph.add("Div", [difference, divisor], "contrast"), *limits], "normal")


def _surroundings(graph, moments):
    """Append mean and standard deviation of the surroundings of each pixel, and return their names."""
    sums = graph.add("Concat", moments, "moments", axis=1)
    blocks = graph.add("AveragePool", [sums], "blocks", kernel_shape=[model.BLOCK] * 2, strides=[model.BLOCK] * 2)
    around = graph.add("AveragePool", [blocks], "around", kernel_shape=[3, 3], pads=[1] * 4, count_include_pad=1)
    thirds = graph.constant("thirds", [1, 1, 1], np.int64)
    seen, first, second = graph.add("Split", [around, thirds], ["around_lit", "around_sum", "around_squares"], axis=1)
    weight = graph.add("Add", [seen, graph.constant("least_lit", model.LEAST_LIT)], "around_weight")
    mean = graph.add("Div", [first, weight], "block_mean")
    mean_squared = graph.add("Mul", [mean, mean], "block_mean_squared")
    variance = graph.add("Sub", [graph.add("Div", [second, weight], "block_square"), mean_squared], "block_variance")
    deviation = graph.add("Sqrt", [graph.add("Relu", [variance], "block_variance_positive")], "block_deviation")
    coarse = graph.add("Concat", [mean, deviation], "coarse", axis=1)
    scales = graph.constant("block_scales", [1.0, 1.0, model.BLOCK, model.BLOCK])
    linear = {"mode": "linear", "coordinate_transformation_mode": "half_pixel"}
    fine = graph.add("Resize", [coarse, "", scales], "fine", **linear)
    halves = graph.constant("halves", [1, 1], np.int64)
    return graph.add("Split", [fine, halves], ["around_mean", "around_deviation"], axis=1)


def write_detector(path: Path, weights, panorama) -> None:
    """Write weights as the ONNX file that `swift_ros.perception.corner_network` loads.

    Args:
        path: the file.
        weights: of the network.
        panorama: geometry of its input.
    """
    graph, small, skips = _Graph(), panorama.side // model.STRIDE, []
    value = _normalize(graph, INPUT)
    levels = len(model.FILTERS)
    for level in range(levels):
        value = graph.halve(value) if level else value
        value = graph.activate(graph.convolve(value, f"down{level}", weights[f"down{level}"]))
        skips.append(value)
    scales = graph.constant("twice", [1.0, 1.0, 2.0, 2.0])
    nearest = {"mode": "nearest", "nearest_mode": "floor", "coordinate_transformation_mode": "asymmetric"}
    for level in range(levels - 2, 0, -1):
        doubled = graph.add("Resize", [value, "", scales], f"up{level}_doubled", **nearest)
        both = graph.add("Concat", [doubled, skips[level]], f"up{level}_both", axis=1)
        value = graph.activate(graph.convolve(both, f"up{level}", weights[f"up{level}"]))
    value = graph.convolve(value, "out", weights["out"])
    sizes = graph.constant("sizes", [model.CORNERS, model.OUTPUTS - model.CORNERS], np.int64)
    logits, _ = graph.add("Split", [value, sizes], ["logits", EDGE_FIELDS], axis=1)
    graph.add("Sigmoid", [logits], CORNER_MAPS)
    image = helper.make_tensor_value_info(INPUT, TensorProto.UINT8, [1, 1, panorama.side, panorama.side])
    maps = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, channels, small, small])
        for name, channels in ((CORNER_MAPS, model.CORNERS), (EDGE_FIELDS, model.OUTPUTS - model.CORNERS))
    ]
    metadata = {"stride": str(model.STRIDE), "pixels_per_radian": repr(panorama.pixels_per_radian)}
    write_model(path, helper.make_graph(graph.nodes, "gate_detector", [image], maps, graph.constants), metadata)


def read_detector(path: Path) -> dict:
    """Return the weights of a file that `write_detector` wrote, float32, in the form of `model.initial_weights`.

    Raises:
        UsageError: the file is no such network.
    """
    CornerNetwork(path)  # names what is wrong with a file that is no detector
    constants = {one.name: numpy_helper.to_array(one) for one in onnx.load(str(path)).graph.initializer}
    weights = {}
    for name, shape in model.layer_shapes().items():
        kernel, bias = constants.get(f"{name}_kernel"), constants.get(f"{name}_bias")
        if kernel is None or bias is None or kernel.transpose(2, 3, 1, 0).shape != shape or bias.shape != shape[3:]:
            raise UsageError(f"{path} is a detector of another kind: its layer '{name}' has not the shape {shape}")
        weights[name] = {"kernel": kernel.transpose(2, 3, 1, 0).copy(), "bias": bias.copy()}
    return weights


def largest_difference(path: Path, weights, images) -> float:
    """Return the largest difference between the outputs of the file and of the network over images (n, S, S) uint8."""
    network, detect, largest = CornerNetwork(path), jax.jit(model.detect), 0.0
    for image in images:
        exported = np.concatenate(network.maps(np.asarray(image)))
        trained = np.moveaxis(np.asarray(detect(weights, image[None]))[0], -1, 0)
        largest = max(largest, float(np.max(np.abs(exported - trained))))
    return largest
