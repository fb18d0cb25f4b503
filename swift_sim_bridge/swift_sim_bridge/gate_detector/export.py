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


def _normalize(graph, image, side):
    """Append `model.normalize` of an image (side, side). Blocks and their interpolation are products of matrices.

    They cost a third of pooling, concatenation and resizing in ONNX Runtime, which handle three channels one by one.
    """
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
    around_mean, divisor = _surroundings(graph, [lit, offset, square], floor, side)
    difference = graph.add("Mul", [graph.add("Sub", [offset, around_mean], "difference"), lit], "difference_lit")
    limits = [graph.constant(f"contrast_{k}", k * model.MOST_CONTRAST) for k in (-1, 1)]
    return graph.add("Clip", [graph.add("Div", [difference, divisor], "contrast"), *limits], "normal")


def _surroundings(graph, moments, floor, side):
    """Append mean of the surroundings of each pixel, and their standard deviation plus `floor`; return their names."""
    around = _both_axes(graph, "around", _mean_of_blocks(side))
    seen, first, second = (around(value) for value in moments)
    weight = graph.add("Add", [seen, graph.constant("least_lit", model.LEAST_LIT)], "around_weight")
    mean = graph.add("Div", [first, weight], "block_mean")
    mean_squared = graph.add("Mul", [mean, mean], "block_mean_squared")
    variance = graph.add("Sub", [graph.add("Div", [second, weight], "block_square"), mean_squared], "block_variance")
    deviation = graph.add("Sqrt", [graph.add("Relu", [variance], "block_variance_positive")], "block_deviation")
    fine = _both_axes(graph, "fine", _interpolation(side))
    return fine(mean), fine(graph.add("Add", [deviation, floor], "block_divisor"))


def _both_axes(graph, name, matrix):
    """Return a function that appends the product of a matrix with the columns and with the rows of a value."""
    left, right = graph.constant(f"{name}_rows", matrix), graph.constant(f"{name}_columns", matrix.T.copy())

    def append(value):
        rows = graph.add("MatMul", [left, value], f"{value}_{name}_rows")
        return graph.add("MatMul", [rows, right], f"{value}_{name}")

    return append


def _mean_of_blocks(side) -> np.ndarray:
    """Return the matrix (blocks, side) of the mean of three blocks around each block; 0 is taken beyond the border."""
    blocks = np.arange(side // model.BLOCK)
    near = np.abs(blocks[:, None] - np.arange(side) // model.BLOCK) <= 1
    return near.astype(np.float32) / (3 * model.BLOCK)


def _interpolation(side) -> np.ndarray:
    """Return the matrix (side, blocks) of the linear interpolation between the centres of blocks."""
    centres, blocks = model.BLOCK * (np.arange(side // model.BLOCK) + 0.5) - 0.5, np.eye(side // model.BLOCK)
    return np.stack([np.interp(np.arange(side), centres, one) for one in blocks], axis=1).astype(np.float32)


def _first_halved(graph, value, layer, side):
    """Append `model._first_halved` of an image (side, side), and return the name of its value.

    The upper and the lower half of the image become two channels, each with filters of its own: ONNX Runtime computes
    16 channels in the time of 8. The file keeps the kernel as it was trained, and ONNX Runtime doubles it once, when it
    loads the file.
    """
    kernel, bias = np.asarray(layer["kernel"]), layer["bias"]
    filters, half, margin = kernel.shape[3], side // 2, kernel.shape[0] // 2
    trained = graph.constant("down0_kernel", kernel.transpose(3, 2, 0, 1)), graph.constant("down0_bias", bias)
    rows, kernels, halves = graph.constant("rows", [2], np.int64), [], []
    border = graph.constant("border", [0, 0, margin, 0] * 2, np.int64)
    padded = graph.add("Pad", [value, border], "padded")
    for k, name in enumerate(("upper", "lower")):
        unseen = graph.constant(
            f"{name}_unseen", [0, k, 0, 0, 0, 1 - k, 0, 0], np.int64
        )  # the channel of the other half
        kernels.append(graph.add("Pad", [trained[0], unseen], f"{name}_kernel"))
        ends = [
            graph.constant(f"{name}_{end}", [row], np.int64)
            for end, row in (("first", k * half), ("last", (k + 1) * half + 2 * margin))
        ]
        halves.append(graph.add("Slice", [padded, *ends, rows], name))
    kernels = graph.add("Concat", kernels, "down0_kernels", axis=0)
    biases = graph.add("Concat", [trained[1]] * 2, "down0_biases", axis=0)
    image = graph.add("Concat", halves, "halves", axis=1)
    found = graph.add("Conv", [image, kernels, biases], "down0_halves", pads=[0, margin] * 2)
    value = graph.halve(graph.activate(found))
    small = side // model.STRIDE
    apart = graph.constant("down0_apart", [2, filters, small // 2, small], np.int64)
    apart = graph.add("Reshape", [value, apart], "down0_half_images")
    joined = graph.add("Transpose", [apart], "down0_by_filter", perm=[1, 0, 2, 3])
    return graph.add(
        "Reshape", [joined, graph.constant("down0_shape", [1, filters, small, small], np.int64)], "down0_on"
    )


def write_detector(path: Path, weights, panorama) -> None:
    """Write weights as the ONNX file that `swift_ros.perception.corner_network` loads.

    Args:
        path: the file.
        weights: of the network.
        panorama: geometry of its input.
    """
    graph, small, skips = _Graph(), panorama.side // model.STRIDE, []
    value = _normalize(graph, INPUT, panorama.side)
    value = _first_halved(graph, value, weights["down0"], panorama.side)
    skips.append(value)
    levels = len(model.FILTERS)
    for level in range(1, levels):
        value = graph.halve(value) if level > 1 else value
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
