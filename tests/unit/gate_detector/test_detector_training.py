"""The detector's training resumes, is prolonged, refuses other files, and keeps the evaluation's seeds free."""

import dataclasses
import json

import cv2
import numpy as np
import pytest

from swift_ros import configuration
from swift_ros import track as tracks
from swift_ros.camera import model as lens
from swift_ros.errors import UsageError
from swift_ros.perception.corner_network import CornerNetwork
from swift_sim_bridge.gate_detector import export, model
from swift_sim_bridge.gate_detector.images.labelled import LabelledExamples
from swift_sim_bridge.gate_detector.training import job as jobs
from swift_sim_bridge.gate_detector.training import picture, progress, train
from swift_sim_bridge.gate_detector.training.pool import Pool
from swift_sim_bridge.gate_detector.training.settings import ends, learning_rate, load_settings
from swift_sim_bridge.gate_detector.training.validation import ShownImage
from swift_sim_bridge.labels import coco, folder
from swift_sim_bridge.labels.labelled_images import LabelledGate, LabelledImage
from swift_sim_bridge.model_files.sittings import Sitting

TINY = {
    "panorama": {"side": 96, "pixels_per_radian": 33.75},
    "crop_px": 64,
    "batch": 2,
    "pool": 3,
    "steps": 4,
    "warmup_steps": 1,
    "validation_images": 2,
    "validation_every": 2,
    "composed_share": 0.0,
}


@pytest.fixture
def job(repository, tmp_path):
    folder = repository / "config"
    looks = configuration.read_yaml(folder / "training.yaml")["detector"]["looks"]
    settings = load_settings(folder, TINY | {"looks": looks | {"textures": 9, "blur_poses": 1}})
    camera = configuration.load(lens.Camera, folder / "camera.yaml")
    return jobs.DetectorJob(settings, camera, configuration.load(tracks.Track, folder / "track.yaml"), tmp_path)


def changed(job, **values):
    return dataclasses.replace(job, settings=dataclasses.replace(job.settings, **values))


def test_an_interrupted_training_resumes_and_ends_with_a_model(job, tmp_path, monkeypatch):
    renew, calls = train.Pool.renew, []

    def interrupted(pool, rng):
        calls.append(1)
        if len(calls) == TINY["pool"] + 3:
            raise KeyboardInterrupt
        renew(pool, rng)

    monkeypatch.setattr(train.Pool, "renew", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train.train(job, minutes=5, checkpoint_s=0)
    monkeypatch.undo()
    before = progress.restore(tmp_path / "checkpoint.pkl")
    assert before.step == 2
    after = train.train(job, minutes=5)
    assert after.step == 4 and after.seconds > before.seconds
    changes = [np.abs(after.weights[name]["kernel"] - before.weights[name]["kernel"]).max() for name in after.weights]
    assert all(0 < change < 0.1 for change in changes)
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == [2, 4]
    assert CornerNetwork(tmp_path / "gate_detector.onnx").shape.panorama.side == 96
    provenance = json.loads((tmp_path / "gate_detector.json").read_text())
    assert provenance["figures"]["step"] == 4 and provenance["seed"] == job.settings.seed
    assert [(one["begin"], one["end"]) for one in provenance["sittings"]] == [(0, 4), (2, 4)]
    assert provenance["trained_for"]["camera"]["fx"] == job.camera.fx
    assert cv2.imread(str(tmp_path / "progress.png")).shape == (810, 1440, 3)

    for values, sentence in (
        ({"seed": 1}, "'seed' 0, which is now 1"),
        ({"panorama": dataclasses.replace(job.settings.panorama, side=128)}, "'panorama.side' 96, which is now 128"),
    ):
        with pytest.raises(UsageError, match=sentence):
            train.train(changed(job, **values, steps=6), minutes=5)
    prolonged = train.train(changed(job, gradient_norm=2.0, steps=6), minutes=5)
    assert prolonged.step == 6
    assert prolonged.sittings[-1] == Sitting(4, 6, {"gradient_norm": [1.0, 2.0]})
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == [2, 4, 6]
    assert lines[-1]["learning_rate"] == pytest.approx(job.settings.restart_share * job.settings.learning_rate)


def test_the_learning_rate_restarts_lower_after_a_finished_training_and_stretches_in_an_unfinished_one(repository):
    settings = load_settings(repository / "config", {"restart_share": 0.5})
    whole = learning_rate(settings, (Sitting(0, 12000),))
    assert float(whole(200)) == pytest.approx(0.004) and float(whole(12000)) == pytest.approx(0.004 / 50)
    prolonged = learning_rate(settings, (Sitting(0, 12000), Sitting(12000, 16000)))
    for step in (0, 100, 5000, 11999):
        assert prolonged(step) == whole(step)
    assert float(prolonged(12200)) == pytest.approx(settings.restart_share * 0.004) and float(prolonged(12000)) < 0.0001
    assert float(prolonged(16000)) == pytest.approx(0.004 / 50)
    assert ends((Sitting(0, 12000), Sitting(3000, 12000), Sitting(9000, 15000))) == [15000]
    assert ends((Sitting(0, 12000), Sitting(12000, 16000), Sitting(13000, 16000))) == [12000, 16000]


@pytest.fixture
def labelled(tmp_path):
    """Return a folder of twelve photographs of one bright gate each, in the dark."""
    path, rng, images = tmp_path / "photographs", np.random.default_rng(0), []
    path.mkdir()
    for number in range(12):
        side, place = rng.uniform(60, 140), rng.uniform([20, 20], [100, 60])
        corners = place + side * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        image = rng.integers(20, 60, (240, 320)).astype(np.uint8)
        outline = np.rint(16 * (corners + 4 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))).astype(np.int32)
        cv2.polylines(image, [outline], True, 230, 8, cv2.LINE_AA, 4)
        cv2.imwrite(str(path / f"{number}.png"), image)
        images.append(LabelledImage(f"{number}.png", 320, 240, (LabelledGate(corners, np.full(4, 2)),)))
    folder.write(path, images, folder.pinhole(320, 240, 70.0))
    return folder.read(path)


@pytest.mark.slow
def test_a_training_on_labelled_images_begins_with_a_given_network_and_learns(job, labelled, tmp_path):
    weights = model.initial_weights(np.random.default_rng(7))
    export.write_detector(tmp_path / "first.onnx", weights, job.settings.panorama)
    first = jobs.first_network(str(tmp_path / "first.onnx"))
    job = dataclasses.replace(job, folders=(labelled,), first=first, out=tmp_path / "out")
    job = changed(job, steps=30, validation_every=30, pool=6, batch=4, labelled_share=1.0, learning_rate=0.02)
    began = progress.begin_sitting(tmp_path / "none.pkl", job.settings, job.conditions, first.weights)
    assert all(np.array_equal(began.weights[name]["kernel"], weights[name]["kernel"]) for name in weights)
    assert float(began.learning_rate(job.settings)(1)) == pytest.approx(job.settings.restart_share * 0.02)
    after = train.train(job, minutes=5)
    rng = np.random.default_rng(8)
    images, *answers = Pool(job.settings, LabelledExamples(job.settings, (labelled,)), rng).batch(rng)
    total = [
        float(model.loss(one, images, *answers, background=0.1, affinity_weight=0.5)[0])
        for one in (weights, after.weights)
    ]
    assert after.step == 30 and total[1] < 0.8 * total[0], total

    provenance = json.loads((job.out / "gate_detector.json").read_text())
    path = labelled.path
    assert provenance["command"].endswith(f"--steps 30 --images {path} --start-from {tmp_path / 'first.onnx'}")
    assert list(provenance["started_from"]) == ["first.onnx"]
    found = provenance["trained_for"]["images"]
    assert [(one["folder"], one["images"], one["gates"]) for one in found] == [("photographs", 12, 12)]

    with pytest.raises(UsageError, match=r"'start_from.first.onnx'"):
        train.train(changed(dataclasses.replace(job, first=None), steps=40), minutes=5)
    coco.write(path / folder.LABELS, coco.read(path / folder.LABELS)[:6])
    fewer = dataclasses.replace(job, folders=(folder.read(path),))
    again = train.train(changed(fewer, steps=32, validation_every=40), minutes=5)
    assert set(again.sittings[-1].changes) == {f"images.{path}", "validation_every"}


def test_sources_are_mixed_by_the_shares_of_the_settings(job, labelled):
    def kinds(job):
        source = jobs.examples_of(job, None)
        return {type(one).__name__: share for one, share in zip(source.sources, source.shares, strict=True)}

    assert kinds(job) == {"RenderedExamples": 1.0}
    with_images = dataclasses.replace(job, folders=(labelled,))
    assert kinds(changed(with_images, labelled_share=0.5)) == {"LabelledExamples": 0.5, "RenderedExamples": 0.5}
    everything = changed(with_images, labelled_share=0.25, composed_share=0.75)
    assert kinds(everything) == {"LabelledExamples": 0.25, "ComposedExamples": 0.5625, "RenderedExamples": 0.1875}
    assert kinds(changed(job, composed_share=1.0)) == {"ComposedExamples": 1.0}
    with pytest.raises(UsageError, match="--images has no effect: 'labelled_share'"):
        changed(with_images, labelled_share=0.0)
    with pytest.raises(UsageError, match="--photographs has no effect: 'composed_share'"):
        dataclasses.replace(job, photographs=labelled.path)


def test_crops_show_no_gates_too_but_stay_at_the_labels_where_not_all_gates_are_labelled(job, labelled):
    settings = dataclasses.replace(job.settings, pool=60, batch=60, crop_px=32)
    rng = np.random.default_rng(0)
    complete = Pool(settings, LabelledExamples(settings, (labelled,)), rng).batch(rng)
    without_corner = [not target[..., : model.CORNERS].any() for target in complete[1]]
    assert 0.03 < np.mean(without_corner) < 0.5
    partly = dataclasses.replace(
        labelled, images=tuple(dataclasses.replace(image, all_gates=False) for image in labelled.images)
    )
    images, targets, masks = Pool(settings, LabelledExamples(settings, (partly,)), rng).batch(rng)
    assert all(target.any() for target in targets) and all(mask.any() for mask in masks)


def test_a_first_network_that_does_not_fit_is_refused(tmp_path):
    with pytest.raises(UsageError, match="--start-from names .*nowhere.onnx, which does not exist"):
        jobs.first_network(str(tmp_path / "nowhere.onnx"))
    shipped = jobs.first_network(jobs.SHIPPED)
    assert {name: layer["kernel"].shape for name, layer in shipped.weights.items()} == model.layer_shapes()
    assert list(shipped.hashes) == ["gate_detector.onnx"]


def test_the_picture_shows_true_and_detected_corners(tmp_path):
    rows = [
        {"step": 1000, "corner_loss": 0.5, "recall_0.5": 0.4},
        {"step": 2000, "corner_loss": 0.2, "median_error_px": None},
    ]
    image = ShownImage(np.full((96, 96), 128, np.uint8), np.array([[30.0, 30.0]]), np.array([[60.0, 60.0]]))

    def pixels(shown, color_bgr):
        picture.draw(tmp_path / "progress.png", rows, [shown])
        content = cv2.imread(str(tmp_path / "progress.png")).astype(int)
        return np.sum(np.abs(content - color_bgr).sum(axis=-1) < 30)

    nothing = image._replace(true=np.zeros((0, 2)), found=np.zeros((0, 2)))
    for color in ((93, 171, 65), (44, 59, 239)):
        assert pixels(image, color) > pixels(nothing, color) + 5


def test_a_file_that_is_not_a_checkpoint_is_refused(job, tmp_path):
    (tmp_path / "checkpoint.pkl").write_bytes(b"something else")
    with pytest.raises(UsageError, match="is no detector checkpoint"):
        train.train(job, minutes=1)


def test_the_training_refuses_seeds_of_the_evaluation(repository):
    with pytest.raises(UsageError, match="'seed' must lie in 0..999"):
        load_settings(repository / "config", {"seed": 1000})
