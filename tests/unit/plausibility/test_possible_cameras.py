"""Calibrations that belong to no camera are refused by a sentence each; odd but possible ones are used.

A case is a change of the shipped file: keys joined by dots, and the new value.
"""

import pytest
from changed_files import changed
from file_checks import check_acceptance, check_advice, check_refusal

from swift_ros.camera.model import Camera

IMPOSSIBLE = [
    ({"cx": 424.0}, "principal point .*; give 'cx' and 'cy' in pixels of this image$"),
    (
        {"fx": 286.0, "fy": 286.0, "cx": 399.5, "cy": 399.5},
        "the calibration is of a larger image, about 800 x 800 px: scale 'fx', 'fy', 'cx' and 'cy'",
    ),
    ({"cx": 399.5, "cy": 399.5, "fx": 28.6, "fy": 28.6}, "'cx' and 'cy' in pixels of this image$"),
    ({"fx": -137.3}, "must be positive"),
    ({"width": 0}, "must be positive"),
    ({"image_circle_deg": 400.0}, "no field of view"),
    ({"distortion": [-0.4, 0.037, -0.036, 0.006]}, "two directions"),
    ({"distortion": [-0.9, 0.0, 0.0, 0.0], "model": "pinhole", "image_circle_deg": None}, "less than half"),
    ({"exposure_s": 6.0}, "'exposure_s' 6 s is not between 0 and the 0.0333 s .* have 0.0005 to 0.01"),
    ({"exposure_s": -0.006}, "'exposure_s'"),
    ({"rate_hz": 0.0}, "must be positive"),
    (
        {"processing_latency": 40.0},
        "'processing_latency' 40 s .* from an image's stamp until .* 0.01 to 0.1",
    ),
    ({"processing_latency": -0.04}, "'processing_latency'"),
    ({"position": [60.0, 0.0, 20.0]}, "'position' is 63.2 m"),
    ({"pitch_deg": 120.0}, "beyond the vertical"),
    ({"pitch_deg": 90.0}, "looks at the sky"),
    ({"pitch_deg": -90.0}, "looks at the ground"),
    ({"yaw_deg": 180.0}, "looks backwards"),
    ({"fx": 286.0, "fy": 286.0}, "radius of 385 px"),
    ({"fx": 13.7, "fy": 13.7}, "focal length in pixels of this image"),
    ({"cx": 0.4987}, "principal point .0.4987, 191.5. .* in pixels of this image, not as shares"),
    ({"cy": 382.4}, "principal point"),
    ({"cx": 90.0}, "the image circle lies outside of the image with 2.% of its diameter"),
    ({"fx": 200.0, "fy": 200.0}, "the image circle lies outside of the image with 29% of its diameter"),
    ({"fx": 286.0}, "'fx' 286 and 'fy' 137.3 differ by a factor of 2.1"),
    ({"image_circle_deg": 2.845}, "'image_circle_deg' 2.845 .* give degrees, not radians"),
    ({"fy": 1373.0}, "differ by a factor of 10"),
    ({"model": "pinhole"}, "'model' is pinhole"),
    ({"model": "pinhole", "image_circle_deg": None}, "third and fourth value of 'distortion'"),
    ({"model": "double_sphere", "distortion": [-0.17, 1.5]}, "alpha in 0 to 1"),
    ({"rate_hz": 0.033}, "not the time between two"),
    ({"width": 38400}, "are no image"),
    ({"model": "fisheye"}, "must be one of"),
    ({"distortion": [0.1]}, "has 4 values, not 1; give k1 k2 k3 k4$"),
    (
        {"model": "double_sphere"},
        "2 values, not 4; give xi alpha, or correct 'model': kannala_brandt has k1 k2 k3 k4, pinhole has k1 k2 p1 p2$",
    ),
    (
        {"model": "pinhole", "distortion": [0.1, 0.2]},
        "give none or k1 k2 p1 p2 or .* double_sphere has xi alpha",
    ),
]
POSSIBLE = [
    ({"pitch_deg": 45.0, "roll_deg": 90.0}),
    ({"height": 216, "cy": 107.5}),
    ({"fx": 240.0, "image_circle_deg": None}),
    ({"pitch_deg": -30.0}),
    ({"exposure_s": 0.0}),
    ({"model": "pinhole", "distortion": [], "image_circle_deg": None}),
    ({"model": "double_sphere", "distortion": [-0.18, 0.59], "image_circle_deg": None}),
]
ODD = [
    ({"fx": 3000.0, "fy": 3000.0, "image_circle_deg": None}, "field of view is 10 degrees"),
    ({"fx": 165.0}, "differ by a factor of 1.2"),
    ({"yaw_deg": 90.0}, "90 degrees to the side"),
    ({"pitch_deg": -50.0}, "50 degrees downwards"),
    ({"rate_hz": 5.0}, "some 30 images a second"),
    ({"exposure_s": 0.03}, "blurred"),
    ({"cx": 120.0}, "off the middle of the image"),
]


@pytest.mark.parametrize(("changes", "sentence"), IMPOSSIBLE)
def test_an_impossible_camera_is_refused_by_one_sentence(tmp_path, changes, sentence):
    check_refusal(Camera, changed(tmp_path, "camera", changes), sentence)


@pytest.mark.parametrize("changes", POSSIBLE)
def test_an_odd_camera_is_accepted(tmp_path, changes):
    check_acceptance(Camera, changed(tmp_path, "camera", changes))


@pytest.mark.parametrize(("changes", "sentence"), ODD)
def test_what_is_odd_of_a_camera_is_said(tmp_path, capsys, changes, sentence):
    check_advice(changed(tmp_path, "camera", changes), sentence, capsys)
