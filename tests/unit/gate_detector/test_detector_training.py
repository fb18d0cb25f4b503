"""The detector's training resumes after an interruption, refuses other files, and keeps the evaluation's seeds free."""

import json

import numpy as np
import pytest

from swift_ros import configuration
from swift_ros import track as tracks
from swift_ros.camera import model as lens
from swift_ros.errors import UsageError
from swift_ros.perception.corner_network import CornerNetwork
from swift_sim_bridge.gate_detector import train

TINY = {
    "panorama": {"side": 96, "pixels_per_radian": 33.75},
    "crop_px": 64,
    "batch": 2,
    "pool": 3,
    "steps": 4,
    "warmup_steps": 1,
    "validation_images": 2,
    "validation_every": 2,
}


@pytest.fixture
def setup(repository):
    folder = repository / "config"
    looks = configuration.read_yaml(folder / "training.yaml")["detector"]["looks"]
    settings = train.load_settings(folder, TINY | {"looks": looks | {"textures": 9, "blur_poses": 1}})
    camera = configuration.load(lens.Camera, folder / "camera.yaml")
    return settings, camera, configuration.load(tracks.Track, folder / "track.yaml")


def test_an_interrupted_training_resumes_and_ends_with_a_model(setup, tmp_path, monkeypatch):
    renew, calls = train.Pool.renew, []

    def interrupted(pool, rng):
        calls.append(1)
        if len(calls) == TINY["pool"] + 3:
            raise KeyboardInterrupt
        renew(pool, rng)

    monkeypatch.setattr(train.Pool, "renew", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train.train(*setup, tmp_path, minutes=5, checkpoint_s=0)
    monkeypatch.undo()
    before = train.restore(tmp_path / "checkpoint.pkl")
    assert before.step == 2
    after = train.train(*setup, tmp_path, minutes=5)
    assert after.step == 4 and after.seconds > before.seconds
    changes = [np.abs(after.weights[name]["kernel"] - before.weights[name]["kernel"]).max() for name in after.weights]
    assert all(0 < change < 0.1 for change in changes)
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == [2, 4]
    assert CornerNetwork(tmp_path / "gate_detector.onnx").shape.panorama.side == 96
    provenance = json.loads((tmp_path / "gate_detector.json").read_text())
    assert provenance["figures"]["step"] == 4 and provenance["seed"] == setup[0].seed


def test_a_file_that_is_not_a_checkpoint_is_refused(setup, tmp_path):
    (tmp_path / "checkpoint.pkl").write_bytes(b"something else")
    with pytest.raises(UsageError, match="is no detector checkpoint"):
        train.train(*setup, tmp_path, minutes=1)


def test_the_training_refuses_seeds_of_the_evaluation(repository):
    with pytest.raises(UsageError, match="'seed' must lie in 0..999"):
        train.load_settings(repository / "config", {"seed": 1000})
