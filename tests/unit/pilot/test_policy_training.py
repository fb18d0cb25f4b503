"""An interrupted training of the policy resumes bit by bit, and the exported model is the trained network."""

import argparse
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

from swift_ros import configuration
from swift_ros.errors import UsageError
from swift_ros.policy.actor import Actor
from swift_ros.policy.observation import SIZE
from swift_sim_bridge.commands import train as command
from swift_sim_bridge.pilot import algorithm, environment, export, networks, trial
from swift_sim_bridge.pilot import train as training

FOLDER = configuration.configuration_folder()
TINY = {"interactions": 256, "agents": 4, "steps": 16, "minibatch": 32, "epochs": 1, "trial_every": 64}
TINY |= {"trial_races": 2, "final_races": 2, "difficulty_from": 64, "difficulty_full": 128}


@pytest.fixture(autouse=True, scope="module")
def compile_once(tmp_path_factory):
    """Share compiled code between trainings of the same shape: compiling takes far longer than these trainings."""
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path_factory.mktemp("compiled")))
    yield
    jax.config.update("jax_compilation_cache_dir", before)


@pytest.fixture
def tiny_configuration(tmp_path):
    """A configuration folder whose training takes seconds."""
    folder = tmp_path / "config"
    folder.mkdir()
    for name in ("drone.yaml", "track.yaml", "camera.yaml"):
        (folder / name).write_text((FOLDER / name).read_text())
    training = yaml.safe_load((FOLDER / "training.yaml").read_text())
    training["policy"] |= TINY
    training["policy"]["environment"] |= {"bank_size": 4, "bank_straight": 2}
    (folder / "training.yaml").write_text(yaml.safe_dump(training))
    return folder


def train(folder, out, *options):
    parser = argparse.ArgumentParser()
    command.command(parser.add_subparsers())
    arguments = parser.parse_args(["train", "policy", "--config", str(folder), "--out", str(out), *options])
    return arguments.run(arguments)


def test_an_interrupted_training_resumes_bit_by_bit(tiny_configuration, tmp_path, monkeypatch):
    assert train(tiny_configuration, tmp_path / "whole") == 0
    saved = []

    def interrupted_save(path, tree, *, fingerprint, save=training.checkpoint.save):
        save(path, tree, fingerprint=fingerprint)
        saved.append(path)
        if len([path for path in saved if path.name == "training.npz"]) == 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(training.checkpoint, "save", interrupted_save)
        train(tiny_configuration, tmp_path / "halves")
    assert train(tiny_configuration, tmp_path / "halves") == 0
    whole, halves = (np.load(tmp_path / name / "training.npz") for name in ("whole", "halves"))
    assert whole.files == halves.files
    for name in whole.files:
        np.testing.assert_array_equal(whole[name], halves[name], err_msg=name)
    lines = [(tmp_path / name / "progress.jsonl").read_text().splitlines() for name in ("whole", "halves")]
    assert [json.loads(line)["interactions"] for line in lines[1]] == [64, 128, 192, 256]
    assert [json.loads(line)["kl"] for line in lines[0]] == [json.loads(line)["kl"] for line in lines[1]]
    record = json.loads((tmp_path / "halves" / "pilot.json").read_text())
    assert record["seed"] == 0 and len(record["sha256"]) == 64 and record["figures"]["onnx_parity"] < 1e-5

    with pytest.raises(UsageError, match="a training with other settings"):
        train(tiny_configuration, tmp_path / "halves", "--seed", "1")
    heavier = yaml.safe_load((FOLDER / "drone.yaml").read_text())
    (tmp_path / "heavier.yaml").write_text(yaml.safe_dump(heavier | {"mass": 1.1 * heavier["mass"]}))
    with pytest.raises(UsageError, match="a training with other settings"):
        train(tiny_configuration, tmp_path / "halves", "--vehicle", str(tmp_path / "heavier.yaml"))


def test_an_unreadable_checkpoint_is_refused_in_one_sentence(tiny_configuration, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "training.npz").write_bytes(b"torn")
    with pytest.raises(UsageError, match="not a readable checkpoint"):
        train(tiny_configuration, tmp_path / "out")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"rewards": {"speed": [1, 1]}}, "unknown reward 'speed'"),
        ({"minibatch": 33}, "'minibatch' must divide"),
        ({"epoch": 3}, "unknown key 'epoch'"),
    ],
)
def test_bad_settings_are_refused_in_one_sentence(tiny_configuration, tmp_path, change, sentence):
    path = tiny_configuration / "training.yaml"
    content = yaml.safe_load(path.read_text())
    content["policy"] |= change
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(UsageError, match=sentence):
        train(tiny_configuration, tmp_path / "out")


def test_the_exported_actor_gives_the_actions_of_the_trained_one(tmp_path):
    actor = networks.make_actor_and_critic(jax.random.PRNGKey(0), SIZE, algorithm.CRITIC_SIZE)["actor"]
    actor[-1] = (actor[-1][0] * 300.0, actor[-1][1])  # some actions beyond the limits
    export.write_actor(tmp_path / "pilot.onnx", actor, SIZE)
    inputs = np.random.default_rng(0).normal(size=(200, SIZE)).astype(np.float32)
    expected = np.clip(np.asarray(networks.apply(actor, inputs)), -1, 1)
    onboard = Actor(tmp_path / "pilot.onnx")
    np.testing.assert_allclose([onboard.act(row) for row in inputs], expected, atol=1e-5)
    assert np.abs(expected).max() == 1


def test_advantages_end_at_a_crash_and_continue_after_a_timeout():
    settings = training.read_settings(FOLDER)
    flags = {name: jnp.zeros((3, 1), bool) for name in ("done", "timeout", "passed", "crashed", "missed")}
    outcome = environment.Outcome(reward=jnp.ones((3, 1)), margin=jnp.zeros((3, 1)), **flags)
    values, last = jnp.full((3, 1), 2.0), jnp.array([7.0])
    reward, discount = settings.reward_scale, settings.discount

    def advantages_with(step, *names):
        marked = {name: flag.at[step, 0].set(True) for name, flag in flags.items() if name in names}
        return np.asarray(algorithm.advantages(settings, outcome._replace(**marked), values, last, 0.0))[:, 0]

    np.testing.assert_allclose(
        advantages_with(2), [reward + 2 * discount - 2] * 2 + [reward + 7 * discount - 2], rtol=1e-5
    )
    np.testing.assert_allclose(advantages_with(1, "done")[1], reward - 2, rtol=1e-5)
    np.testing.assert_allclose(advantages_with(1, "timeout")[1], reward + 2 * discount - 2, rtol=1e-5)


def test_trials_count_laps_from_gate_one_to_gate_one():
    ticks = np.full((2, 22), -1)
    ticks[0] = 80 + 90 * np.arange(22)
    ticks[1, :9] = 80 + 100 * np.arange(9)
    figures = trial.figures(trial.Trial(ticks, np.full((2, 22), 0.3), np.zeros((2, 3))), 7)
    assert figures["finish_rate"] == 0.5 and figures["median_race_s"] == pytest.approx(19.7)
    assert figures["best_lap_s"] == pytest.approx(6.3) and figures["median_lap_s"] == pytest.approx(6.3)
    assert figures["passages"] == 15.5
