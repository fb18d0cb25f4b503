"""Image sources: format, order, rate and end of their pictures, and errors."""

import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from synthetic_flight import CAMERA, settings

from swift_ros import geometry
from swift_ros.camera.picture import fit_to
from swift_ros.camera.sources import CameraSettings, open_source
from swift_ros.camera.t265 import T265, to_odometry
from swift_ros.errors import UsageError

FAST = replace(CAMERA, rate_hz=200.0)


def camera_settings(kind: str, path="", repeat: bool = False) -> CameraSettings:
    return settings("camera", CameraSettings, kind=kind, path=str(path), repeat=repeat)


def read_all(source, max_count: int = 20) -> list[np.ndarray]:
    pictures = []
    while len(pictures) < max_count and (picture := source.read()) is not None:
        pictures.append(picture.image)
    source.close()
    return pictures


def test_the_t265_image_is_cropped_and_scaled():
    """A mark 100 px from the centre of 848 x 800 px is 48 px from the centre of 384 x 384 px."""
    sensor = np.zeros((800, 848), np.uint8)
    sensor[497:504, 521:528] = 255
    image = fit_to(CAMERA, sensor)
    assert image.shape == (384, 384) and image.dtype == np.uint8
    rows, columns = np.nonzero(image > 100)
    assert rows.mean() == pytest.approx(191.5 + 48.24, abs=0.6)
    assert columns.mean() == pytest.approx(191.5 + 48.24, abs=0.6)


def test_orange_paint_on_concrete_of_its_luminance_is_seen():
    """Red, green and blue of equal luminance: 0.299 * 235 + 0.587 * 120 + 0.114 * 60 = 147."""
    picture = np.full((384, 384, 3), 147, np.uint8)
    picture[100:120, 100:300] = (60, 120, 235)
    image = fit_to(CAMERA, picture)
    assert image[110, 200] == 255 and image[50, 50] == pytest.approx(105.5, abs=0.5)


def test_colour_becomes_grey_and_an_image_of_the_right_size_is_unchanged():
    image = np.random.default_rng(0).integers(0, 255, (384, 384), np.uint8)
    assert np.array_equal(fit_to(CAMERA, image), image)
    assert np.abs(fit_to(CAMERA, cv2.merge([image] * 3)).astype(int) - image).max() <= 1


@pytest.fixture
def folder(tmp_path):
    """Images 1 to 11; the grey level of each is its number times 20."""
    for number in range(1, 12):
        cv2.imwrite(str(tmp_path / f"frame{number}.png"), np.full((40, 60), 20 * number, np.uint8))
    (tmp_path / "notes.txt").write_text("not an image")
    return tmp_path


def test_a_folder_is_read_in_the_order_of_the_numbers_in_its_file_names(folder):
    pictures = read_all(open_source(camera_settings("folder", folder), FAST))
    assert [int(image[0, 0]) // 20 for image in pictures] == list(range(1, 12))
    assert {image.shape for image in pictures} == {(384, 384)}


def test_files_repeat_with_the_setting_repeat(folder):
    pictures = read_all(open_source(camera_settings("folder", folder, repeat=True), FAST), max_count=15)
    assert [int(image[0, 0]) // 20 for image in pictures[10:]] == [11, 1, 2, 3, 4]


def test_files_are_read_at_the_rate_of_the_camera(folder):
    begun = time.monotonic()
    read_all(open_source(camera_settings("folder", folder), replace(CAMERA, rate_hz=50.0)))
    assert time.monotonic() - begun >= 10 / 50.0


def test_the_error_names_an_unreadable_image(folder):
    (folder / "frame5.png").write_bytes(b"no picture")
    with pytest.raises(UsageError, match="frame5.png is not a readable image"):
        read_all(open_source(camera_settings("folder", folder), FAST))


def test_a_video_is_read_to_its_end(tmp_path):
    path = tmp_path / "flight.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30, (848, 800))
    for number in range(5):
        writer.write(np.full((800, 848, 3), 40 * number, np.uint8))
    writer.release()
    pictures = read_all(open_source(camera_settings("video", path), FAST))
    assert [round(float(image.mean()) / 40) for image in pictures] == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    "kind, path, sentence",
    [
        ("v4l2", "/dev/video97", "cannot be opened"),
        ("video", "/nowhere/flight.avi", "does not exist"),
        ("folder", "/nowhere", "does not exist"),
    ],
)
def test_a_missing_device_or_file_is_an_error_of_one_sentence(kind, path, sentence):
    with pytest.raises(UsageError, match=sentence):
        open_source(camera_settings(kind, path), CAMERA)


def test_a_folder_without_images_is_an_error(tmp_path):
    with pytest.raises(UsageError, match="holds no image"):
        open_source(camera_settings("folder", tmp_path), CAMERA)


def test_a_file_that_is_not_a_video_is_an_error(tmp_path):
    (tmp_path / "flight.avi").write_bytes(b"no video")
    with pytest.raises(UsageError, match="cannot be decoded"):
        open_source(camera_settings("video", tmp_path / "flight.avi"), CAMERA)


def test_the_error_names_an_unknown_kind():
    with pytest.raises(ValueError, match="'kind' must be one of v4l2, video, folder, t265, not 'webcam'"):
        camera_settings("webcam")


def test_the_t265_without_its_library_is_an_error(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(UsageError, match="needs pyrealsense2, which is not installed"):
        open_source(camera_settings("t265"), CAMERA)


def xyz(x, y, z):
    return SimpleNamespace(x=x, y=y, z=z)


def test_a_t265_pose_is_converted_to_z_up_with_the_twist_in_the_device_frame():
    """Yawed 90 degrees to the left about the device's y axis and moving left at 3 m/s is 3 m/s forward."""
    half = np.sqrt(0.5)
    pose = SimpleNamespace(
        translation=xyz(-2.0, 1.0, -5.0),
        rotation=SimpleNamespace(x=0.0, y=half, z=0.0, w=half),
        velocity=xyz(-3.0, 0.0, 0.0),
        angular_velocity=xyz(0.0, 0.5, 0.0),
    )
    odometry = to_odometry(pose)
    assert np.allclose(odometry.p_world, [5.0, 2.0, 1.0])
    assert geometry.yaw_of(odometry.q_world_body) == pytest.approx(np.pi / 2)
    assert np.allclose(odometry.v_body, [3.0, 0.0, 0.0])
    assert np.allclose(odometry.omega_body, [0.0, 0.0, 0.5])


class FakePipeline:
    """The library's pipeline, which passes frames to a callback."""

    def start(self, config, callback):
        self.callback = callback

    def stop(self):
        self.stopped = True


def test_a_t265_delivers_its_left_image_and_its_odometry(monkeypatch):
    pipeline = FakePipeline()
    library = SimpleNamespace(
        pipeline=lambda: pipeline,
        stream=SimpleNamespace(pose=0, fisheye=1),
        config=lambda: SimpleNamespace(enable_stream=lambda *stream: None),
    )
    monkeypatch.setitem(sys.modules, "pyrealsense2", library)
    received = []
    source = T265(CAMERA, lambda age_s, odometry: received.append((age_s, odometry)))
    taken_ms = (time.time() - 0.02) * 1e3
    pose = SimpleNamespace(
        translation=xyz(0, 0, -1.0),
        rotation=SimpleNamespace(x=0, y=0, z=0, w=1.0),
        velocity=xyz(0, 0, 0),
        angular_velocity=xyz(0, 0, 0),
    )
    pipeline.callback(
        SimpleNamespace(
            is_pose_frame=lambda: True,
            as_pose_frame=lambda: SimpleNamespace(get_pose_data=lambda: pose),
            get_timestamp=lambda: taken_ms,
        )
    )
    for level in (10, 200):  # the second replaces the first, which was not read
        left = SimpleNamespace(
            get_data=lambda level=level: np.full((800, 848), level, np.uint8), get_timestamp=lambda: taken_ms
        )
        pipeline.callback(
            SimpleNamespace(
                is_pose_frame=lambda: False,
                is_frameset=lambda: True,
                as_frameset=lambda left=left: SimpleNamespace(get_fisheye_frame=lambda eye: left),
            )
        )
    picture = source.read()
    source.close()
    assert picture.image.shape == (384, 384) and picture.image[0, 0] == 200
    assert 0.0 <= received[0][0] < 1.0 and np.allclose(received[0][1].p_world, [1.0, 0.0, 0.0])
    assert pipeline.stopped
