"""Calibration files that others' tools write are read, scaled to the images of the stack, or refused by a sentence."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from swift_ros import cli, configuration
from swift_ros.camera.calibration_files import fitted, read_calibration
from swift_ros.camera.model import Camera, project, unproject
from swift_ros.errors import UsageError

KALIBR = """cam0:
  T_cam_imu:
  - [0.0148, -0.9998, 0.0041, -0.0216]
  - [0.9995, 0.0149, 0.0257, -0.0646]
  - [-0.0257, 0.0037, 0.9996, 0.0098]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
  distortion_model: radtan
  intrinsics: [458.654, 457.296, 367.215, 248.375]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  camera_model: ds
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [-0.1815, 0.5909, 156.27, 156.3, 254.88, 256.83]
  resolution: [512, 512]
cam2:
  camera_model: pinhole
  distortion_coeffs: [-0.004, 0.037, -0.036, 0.006]
  distortion_model: equidistant
  intrinsics: [286.0, 286.0, 423.5, 399.5]
  resolution: [848, 800]
cam3: {camera_model: omni, intrinsics: [1, 2, 3, 4, 5], distortion_model: radtan, resolution: [9, 9]}
"""
ROS = """image_width: 640
image_height: 480
camera_name: narrow
camera_matrix: {rows: 3, cols: 3, data: [420.0, 0, 322, 0, 421.0, 239, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.31, 0.12, -0.0008, 0.0006, 0.005]}
"""


@pytest.fixture
def kalibr(tmp_path) -> Path:
    path = tmp_path / "camchain.yaml"
    path.write_text(KALIBR)
    return path


def test_a_file_of_kalibr_has_one_lens_for_each_camera(kalibr):
    first, second, third = (read_calibration(kalibr, number) for number in range(3))
    assert (first.model, first.width, first.fx, len(first.distortion)) == ("pinhole", 752, 458.654, 4)
    assert (second.model, second.cx, second.distortion) == ("double_sphere", 254.88, (-0.1815, 0.5909))
    assert (third.model, third.height, third.distortion[3]) == ("kannala_brandt", 800, 0.006)


def test_the_images_of_the_stack_are_cropped_and_scaled(kalibr):
    """A T265's 848 x 800 px become the 384 x 384 px of the shipped camera.yaml."""
    found = fitted(read_calibration(kalibr, 2), 384, 384)
    shipped = configuration.load(Camera, configuration.configuration_folder() / "camera.yaml")
    assert (found.fx, found.cx, found.cy) == pytest.approx((shipped.fx, shipped.cx, shipped.cy), abs=0.05)


def test_a_camera_info_of_ros_is_read(tmp_path):
    path = tmp_path / "info.yaml"
    path.write_text(ROS)
    found = read_calibration(path)
    assert (found.model, found.fy, found.cy, len(found.distortion)) == ("pinhole", 421.0, 239.0, 5)


@pytest.mark.parametrize("suffix", [".yml", ".xml", ".json"])
@pytest.mark.parametrize("fisheye", [False, True])
def test_a_file_of_opencv_is_read_in_each_of_its_forms(tmp_path, suffix, fisheye):
    path = tmp_path / f"out{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 1280)
    storage.write("image_height", 720)
    storage.write("fisheye_model", int(fisheye))
    storage.write("camera_matrix", np.array([[790.0, 0, 650], [0, 792.0, 355], [0, 0, 1]]))
    storage.write("distortion_coefficients", np.array([[0.1, -0.05, 0.001, 0.002] + [0.0] * (0 if fisheye else 10)]).T)
    storage.release()
    found = read_calibration(path)
    assert found.model == ("kannala_brandt" if fisheye else "pinhole")
    assert found.distortion[:4] == (0.1, -0.05, 0.001, 0.002) and (found.width, found.fy) == (1280, 792.0)


def test_the_command_writes_a_camera_file_that_keeps_the_mount(kalibr, tmp_path, capsys):
    out = tmp_path / "mine" / "camera.yaml"
    assert cli.main(["calibration", str(kalibr), "--camera", "2", "--size", "384x384", "--out", str(out)]) == 0
    assert "kannala_brandt, 384 x 384 px" in capsys.readouterr().out
    camera = configuration.load(Camera, out)
    shipped = configuration.load(Camera, configuration.configuration_folder() / "camera.yaml")
    assert camera.position == shipped.position and camera.pitch_deg == shipped.pitch_deg
    pixels = np.array([[10.0, 190.0], [300.0, 40.0]])
    np.testing.assert_allclose(project(camera, unproject(shipped, pixels))[0], pixels, atol=0.2)
    assert cli.main(["calibration", str(kalibr), "--out", str(out)]) == 2 and "exists" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("radtan", "fov"), "the lens pinhole with fov is not supported"),
        (("[458.654, ", "["), "an intrinsic or a coefficient that is not a number"),
        (("458.654", ".nan"), "not a number"),
        (("  resolution: [752, 480]\n", ""), "lacks a value"),
        (("0.07395907, ", ""), "a pinhole lens has 0 or 4 or 5 or 8 coefficients, not 3"),
        (("cam0", "left"), "holds no camera 0 of Kalibr"),
    ],
)
def test_a_file_that_cannot_be_used_is_named_with_the_cure(kalibr, change, sentence):
    kalibr.write_text(kalibr.read_text().replace(*change, 1))
    with pytest.raises(UsageError, match=sentence):
        read_calibration(kalibr)


def test_other_lenses_and_binary_files_are_refused(kalibr, tmp_path):
    with pytest.raises(UsageError, match="omni with radtan is not supported; calibrate with a pinhole"):
        read_calibration(kalibr, 3)
    path = tmp_path / "image.png"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(UsageError, match="cannot be read as a text"):
        read_calibration(path)
