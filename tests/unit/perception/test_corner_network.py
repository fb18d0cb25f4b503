"""The model file: equal to the trained network; other files are refused."""

from pathlib import Path

import numpy as np
import pytest

from swift_ros.errors import UsageError
from swift_ros.perception.corner_network import CornerNetwork, choose_provider
from swift_ros.perception.upright import Panorama
from swift_sim_bridge.gate_detector import export
from swift_sim_bridge.gate_detector import model as detector_model
from swift_sim_bridge.pilot.export import write_actor

PANORAMA = Panorama(64, 22.5)


@pytest.fixture(scope="module")
def weights():
    return detector_model.initial_weights(np.random.default_rng(0))


@pytest.fixture
def model(tmp_path, weights):
    path = tmp_path / "model.onnx"
    export.write_detector(path, weights, PANORAMA)
    return path


def test_the_file_and_the_network_have_equal_outputs(model, weights):
    images = np.random.default_rng(1).integers(0, 256, (3, 64, 64)).astype(np.uint8)
    images[1, :, 30:] = 0  # beyond the image circle
    images[2] = 0
    assert export.largest_difference(model, weights, images) < 1e-3


def test_a_faint_gate_in_the_dark_gains_on_a_painted_one_in_full_light():
    """Their levels differ from the surroundings by 12 and 110."""
    image = np.full((1, 128, 128), 30, np.uint8)
    image[0, :, 64:] = 140
    for column, level in ((16, 42), (88, 250)):
        image[0, 40:80, column : column + 4] = image[0, 40:80, column + 20 : column + 24] = level
    normal = np.asarray(detector_model.normalize(image))[0, ..., 0]
    faint, painted = (normal[60, column] - normal[60, column + 10] for column in (17, 89))
    assert 2 * 12 / 110 < faint / painted < 1.0
    assert np.abs(normal).max() <= detector_model.MOST_CONTRAST


def test_the_weights_of_a_file_are_those_it_was_written_from(model, weights):
    found = export.read_detector(model)
    assert list(found) == list(weights)
    for name, layer in weights.items():
        assert all(np.array_equal(found[name][part], layer[part]) for part in ("kernel", "bias"))


def test_the_shipped_file_is_written_again_without_a_difference(repository, tmp_path):
    shipped = repository / "config/models/gate_detector.onnx"
    weights, panorama = export.read_detector(shipped), CornerNetwork(shipped).shape.panorama
    export.write_detector(tmp_path / "again.onnx", weights, panorama)
    images = np.random.default_rng(2).integers(0, 256, (2, panorama.side, panorama.side)).astype(np.uint8)
    first, again = CornerNetwork(shipped), CornerNetwork(tmp_path / "again.onnx")
    for image in images:
        assert all(np.array_equal(a, b) for a, b in zip(first.maps(image), again.maps(image), strict=True))
    assert export.largest_difference(shipped, weights, images[:1]) < 2e-3


def test_a_detector_with_other_layers_gives_no_weights(tmp_path, weights, monkeypatch):
    path = tmp_path / "other.onnx"
    export.write_detector(path, weights, PANORAMA)
    monkeypatch.setattr(detector_model, "FILTERS", (8, 16, 16, 16, 16, 16))
    with pytest.raises(
        UsageError, match="other.onnx is a detector of another kind: its layer 'down4' has not the shape"
    ):
        export.read_detector(path)


def test_the_file_contains_its_panorama_and_stride(model):
    network = CornerNetwork(model)
    assert network.shape.panorama == PANORAMA and network.shape.stride == 2
    corners, edges = network.maps(np.zeros((64, 64), np.uint8))
    assert corners.shape == (4, 32, 32) and edges.shape == (8, 32, 32)


def test_the_network_has_the_papers_kernels_and_its_first_levels():
    shapes = detector_model.layer_shapes()
    assert [shapes[f"down{k}"][3] for k in range(4)] == [8, 16, 16, 16]
    assert [shapes[f"down{k}"][0] for k in range(6)] == [3, 3, 3, 5, 7, 7]
    assert shapes["out"][3] == 12


def test_a_model_of_another_shape_is_refused(tmp_path):
    path = tmp_path / "pilot.onnx"
    write_actor(path, [(np.zeros((31, 4), np.float32), np.zeros(4, np.float32))], 31)
    with pytest.raises(UsageError, match="pilot.onnx is not a gate detector: its inputs are 'observation' 1x31"):
        CornerNetwork(path)


def test_a_missing_and_an_invalid_model_are_refused(tmp_path):
    with pytest.raises(UsageError, match="nowhere.onnx is missing"):
        CornerNetwork(tmp_path / "nowhere.onnx")
    (tmp_path / "broken.onnx").write_bytes(b"no model")
    with pytest.raises(UsageError, match="broken.onnx cannot be loaded"):
        CornerNetwork(tmp_path / "broken.onnx")


def test_a_model_whose_metadata_is_damaged_is_refused(model, tmp_path):
    content = bytearray(Path(model).read_bytes())
    content[content.rindex(b"stride")] = 0xFF  # not UTF-8
    (tmp_path / "damaged.onnx").write_bytes(content)
    with pytest.raises(UsageError, match="damaged.onnx"):
        CornerNetwork(tmp_path / "damaged.onnx")


def test_the_first_available_provider_is_chosen(model):
    available = ["CUDAExecutionProvider", "CPUExecutionProvider"]
    assert choose_provider(("tensorrt", "cuda", "cpu"), available) == "cuda"
    with pytest.raises(UsageError, match="none of gate_detector's providers"):
        choose_provider(("tensorrt",), available)
    network = CornerNetwork(model, ("tensorrt", "cpu"))
    assert (network.provider, network.unavailable_providers) in (("cpu", ("tensorrt",)), ("tensorrt", ()))
