"""A training begins with the shipped pilot, or with the checkpoint of another training."""

import json
from pathlib import Path

import cv2
import jax
import numpy as np
import pytest
from tiny_training import FOLDER, log_of, other, provenance_of, rewrite, train

from swift_ros.errors import UsageError
from swift_ros.policy.actor import Actor
from swift_ros.policy.observation import SIZE
from swift_sim_bridge.model_files import provenance
from swift_sim_bridge.pilot import export, job, learner, networks
from swift_sim_bridge.pilot import train as training
from swift_sim_bridge.pilot.settings import Plan


def test_a_training_that_begins_with_the_shipped_pilot_first_learns_a_critic_alone(
    tiny_configuration, tmp_path, monkeypatch, draw_picture
):
    out, shipped = tmp_path / "out", FOLDER / "models" / "pilot.onnx"
    rewrite(
        tiny_configuration, "policy", fine_tuning={"interactions": 192, "critic_first": 128, "schedule_share": 0.75}
    )
    saved = []

    def keep(path, tree, *, record, save=training.checkpoint.save):
        save(path, tree, record=record)
        if path.name == "training.npz":
            saved.append(jax.tree.map(np.asarray, tree.networks))

    def draw(path, rows, races, track, guide):
        if len(rows) == 1:
            (out / "first.onnx").write_bytes((out / "pilot.onnx").read_bytes())
            draw_picture(path, rows, races, track, guide)

    monkeypatch.setattr(training.checkpoint, "save", keep)
    monkeypatch.setattr(training.picture, "draw", draw)
    assert train(tiny_configuration, out, "--start-from", "shipped") == 0
    assert [row["interactions"] for row in log_of(out)] == [0, 64, 128, 192]
    inputs = np.random.default_rng(0).normal(size=(200, SIZE)).astype(np.float32)
    before, after = (Actor(path) for path in (shipped, out / "first.onnx"))
    np.testing.assert_array_equal([after.act(row) for row in inputs], [before.act(row) for row in inputs])

    assert cv2.imread(str(out / "progress.png")).shape == (810, 1800, 3)
    actor = export.read_actor(shipped, saved[0]["actor"])
    assert [same(actor, networks["actor"]) for networks in saved] == [True, True, False]
    assert not same(saved[0]["critic"], saved[1]["critic"])
    record = provenance_of(out)
    assert record["command"] == "swiftros train policy --seed 0 --start-from shipped"
    assert record["started_from"]["pilot.onnx"] == json.loads(shipped.with_suffix(".json").read_text())["sha256"]


def same(first, second) -> bool:
    pairs = zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


def test_a_training_begins_with_the_checkpoint_of_another_on_another_track(tiny_configuration, tmp_path):
    given = networks.make_actor_and_critic(jax.random.PRNGKey(7), SIZE, learner.CRITIC_SIZE)
    origin = provenance.Origin("command", "hash", 0, {}, [])
    export.write_pilot(tmp_path, given, {}, origin=origin)
    moved = other(tmp_path, "track.yaml", lambda content: content["gates"][2]["position"].__setitem__(1, -5.0))
    for name in ("pilot.npz", "pilot.onnx"):
        chosen = {"track": Path(moved), "start_from": str(tmp_path / name)}
        options = job.TrainingOptions(tiny_configuration, tmp_path / "out", **chosen)
        prepared = job.prepare(options)
        training = job.first_state(prepared, options)
        assert same(training.networks["actor"], given["actor"])
        assert same(training.networks["critic"], given["critic"]) == (name == "pilot.npz")
        assert float(training.learning_rate) == pytest.approx(learner.MIN_LEARNING_RATE)
        assert (prepared.end, prepared.plan) == (128, Plan(128, 64, 0.75))
        assert prepared.track.positions[2, 1] == -5.0 and prepared.world.gates.positions[2, 1] == -5.0


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--start-from", "none.npz"), "none.npz, which does not exist"),
        (("--start-from", str(FOLDER / "models" / "gate_detector.onnx")), "is not a pilot of `swiftros train policy`"),
        (("--start-from", str(FOLDER / "models" / "race_poses.npz")), "holds a training of another shape"),
        (("--start-from", "shipped", "--interactions", "64"), "leave none after the 64 of 'fine_tuning.critic_first'"),
        (("--track", "none.yaml"), "none.yaml cannot be read"),
    ],
)
def test_a_bad_beginning_is_refused_in_one_sentence(tiny_configuration, tmp_path, options, sentence):
    with pytest.raises(UsageError, match=sentence):
        train(tiny_configuration, tmp_path / "out", *options)
