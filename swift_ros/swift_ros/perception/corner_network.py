"""Runs the corner network in ONNX Runtime: choice of the provider and check of the model file."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnxruntime

from swift_ros.errors import UsageError
from swift_ros.perception.settings import PROVIDERS
from swift_ros.perception.upright import Panorama
from swift_ros.text import excerpt

MAX_SIDE = 4096  # px of a panorama; a larger one has more pixels than any camera here
INPUT, CORNER_MAPS, EDGE_FIELDS = "image", "corners", "edges"


def choose_provider(wanted: tuple[str, ...], available: list[str]) -> str:
    """Return the first wanted provider that is available. Raises UsageError when there is none."""
    for name in wanted:
        if PROVIDERS[name][0] in available:
            return name
    raise UsageError(
        f"none of gate_detector's providers ({', '.join(wanted)}) is in this ONNX Runtime; it has "
        f"{', '.join(available)}; choose one of those"
    )


@dataclass(frozen=True)
class ModelShape:
    """Shape of a detector's model.

    Attributes:
        panorama: the view that it expects.
        stride: panorama pixels per map pixel.
    """

    panorama: Panorama
    stride: int


class CornerNetwork:
    """One model on one CPU thread or on one accelerator.

    Args:
        path: ONNX file.
        providers: names in `PROVIDERS`; the first available one runs the model.

    Attributes:
        provider: name of the chosen provider.
        unavailable_providers: wanted providers before it, which are not installed.
        shape: of the model.

    Raises:
        UsageError: the file is missing, is not an ONNX model, has inputs or outputs of no gate detector, or cannot
            be run.
    """

    def __init__(self, path: str | Path, providers: tuple[str, ...] = ("cpu",)):
        available = onnxruntime.get_available_providers()
        self.provider = choose_provider(tuple(providers), available)
        self.unavailable_providers = tuple(providers)[: tuple(providers).index(self.provider)]
        if not Path(path).is_file():
            raise UsageError(f"gate detector model {path} is missing; train one or name another in nodes.yaml")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        try:
            self._session = onnxruntime.InferenceSession(str(path), options, providers=[PROVIDERS[self.provider]])
        except Exception as error:  # the exception types of onnxruntime differ between releases
            raise UsageError(f"gate detector model {path} cannot be loaded: {excerpt(str(error))}") from error
        self.shape = _check(self._session, path)
        self._check_run(path)

    def maps(self, image) -> tuple[np.ndarray, np.ndarray]:
        """Return corner maps (4, h, w) in 0..1 and edge fields (8, h, w) of a panorama (side, side) uint8."""
        corners, edges = self._session.run([CORNER_MAPS, EDGE_FIELDS], {INPUT: image[None, None]})
        return np.asarray(corners)[0], np.asarray(edges)[0]

    def _check_run(self, path) -> None:
        """Run the network once, which also allocates its memory. Raises UsageError when it cannot be run."""
        side = self.shape.panorama.side
        try:
            found = self.maps(np.zeros((side, side), np.uint8))
        except Exception as error:  # the exception types of onnxruntime differ between releases
            raise UsageError(f"gate detector model {path} cannot be run: {excerpt(str(error))}") from error
        if [maps.shape for maps in found] != [
            (count, side // self.shape.stride, side // self.shape.stride) for count in (4, 8)
        ]:
            raise UsageError(f"gate detector model {path} is damaged: its maps have other shapes than it says")


def _check(session, path) -> ModelShape:
    inputs = {value.name: (value.type, value.shape) for value in session.get_inputs()}
    outputs = {value.name: (value.type, value.shape) for value in session.get_outputs()}
    try:
        metadata = session.get_modelmeta().custom_metadata_map
        kind, (one, channel, side, width) = inputs[INPUT]
        stride, density = int(metadata["stride"]), float(metadata["pixels_per_radian"])
        maps = [side // stride, side // stride]
        expected = {CORNER_MAPS: ("tensor(float)", [1, 4, *maps]), EDGE_FIELDS: ("tensor(float)", [1, 8, *maps])}
        fits = kind == "tensor(uint8)" and (one, channel, width) == (1, 1, side) and outputs == expected
        fits = fits and 0 < stride <= side <= MAX_SIDE and 0.0 < density < np.inf
    except (KeyError, ValueError, TypeError, ZeroDivisionError):  # a text that is not UTF-8 is a ValueError too
        fits = False
    if not fits:
        raise UsageError(
            f"{path} is not a gate detector: its inputs are {_names(inputs)} and its outputs {_names(outputs)}; needed "
            f"are '{INPUT}' 1x1xSxS uint8, '{CORNER_MAPS}' 1x4, '{EDGE_FIELDS}' 1x8, metadata stride, pixels_per_radian"
        )
    return ModelShape(Panorama(side, density), stride)


def _names(values) -> str:
    return (
        ", ".join(excerpt(f"'{name}' {'x'.join(map(str, shape))}") for name, (_, shape) in values.items()) or "nothing"
    )
