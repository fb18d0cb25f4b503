"""A training of the policy resumes bit by bit, is prolonged, changed, drawn, and refused where it cannot be."""

import json
from dataclasses import replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml
from tiny_training import FOLDER, log_of, other, provenance_of, rewrite, train

from swift_ros import configuration
from swift_ros.errors import UsageError
from swift_ros.policy.actor import Actor
from swift_ros.policy.observation import SIZE
from swift_ros.track import Track
from swift_sim_bridge.model_files import checkpoint, sittings
from swift_sim_bridge.pilot import export, job, learner, networks, ppo, trial
from swift_sim_bridge.pilot import train as training
from swift_sim_bridge.pilot.episodes import environment
from swift_sim_bridge.pilot.episodes.time_optimal import Guide
from swift_sim_bridge.pilot.settings import Plan, schedule_at, share_at


def test_an_interrupted_training_resumes_bit_by_bit(tiny_configuration, tmp_path, monkeypatch):
    assert train(tiny_configuration, tmp_path / "whole") == 0
    saved = []

    def interrupted_save(path, tree, *, record, save=training.checkpoint.save):
        save(path, tree, record=record)
        saved.append(path)
        if len([path for path in saved if path.name == "training.npz"]) == 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(training.checkpoint, "save", interrupted_save)
        train(tiny_configuration, tmp_path / "halves")
    assert train(tiny_configuration, tmp_path / "halves") == 0
    whole, halves = (np.load(tmp_path / name / "training.npz") for name in ("whole", "halves"))
    assert whole.files == halves.files
    for name in set(whole.files) - {checkpoint.RECORD}:  # which has one sitting more
        np.testing.assert_array_equal(whole[name], halves[name], err_msg=name)
    lines = [(tmp_path / name / "progress.jsonl").read_text().splitlines() for name in ("whole", "halves")]
    assert [json.loads(line)["interactions"] for line in lines[1]] == [64, 128, 192, 256]
    assert [json.loads(line)["kl"] for line in lines[0]] == [json.loads(line)["kl"] for line in lines[1]]
    record = json.loads((tmp_path / "halves" / "pilot.json").read_text())
    assert record["seed"] == 0 and len(record["sha256"]) == 64 and record["figures"]["onnx_parity"] < 1e-5
    assert [(one["begin"], one["end"]) for one in record["sittings"]] == [(0, 256), (128, 256)]
    with pytest.raises(UsageError, match="has 256 interactions already; give more with --interactions"):
        train(tiny_configuration, tmp_path / "halves")


def test_a_finished_training_is_prolonged_at_the_end_of_its_schedules_or_refused(tiny_configuration, tmp_path, capsys):
    out = tmp_path / "out"
    assert train(tiny_configuration, out) == 0
    heavier = other(tmp_path, "drone.yaml", lambda content: content.update(mass=0.957))
    moved = other(tmp_path, "track.yaml", lambda content: content["gates"][2]["position"].__setitem__(1, -5.0))
    before = (out / "training.npz").read_bytes()
    for options, sentence in (
        (("--seed", "1"), "'seed' 0, which is now 1"),
        (("--vehicle", heavier), "'vehicle.mass' 0.87, which is now 0.957"),
        (("--track", moved), r"'track.gates\[2\].position' \[9.2, -4.0, 1.2\], which is now \[9.2, -5.0, 1.2\]"),
        (("--start-from", "shipped"), "'start_from"),
    ):
        with pytest.raises(UsageError, match=sentence) as caught:
            train(tiny_configuration, out, "--interactions", "384", *options)
        assert "\n" not in str(caught.value) and str(out) in str(caught.value)
    with pytest.raises(UsageError, match="has 256 interactions already; give more with --interactions"):
        train(tiny_configuration, out)
    assert (out / "training.npz").read_bytes() == before

    rewrite(tiny_configuration, "policy", final_races=4)
    capsys.readouterr()
    assert train(tiny_configuration, out, "--interactions", "384") == 0
    text = capsys.readouterr().out
    assert "changed: 'final_races' from 2 to 4" in text and "min left" in text and "best: " in text
    assert "prolonged: after 0.0 M interactions all schedules stay at their end" in text
    rows = log_of(out)
    assert [row["interactions"] for row in rows] == [64, 128, 192, 256, 320, 384]
    end = ppo.own_settings(job.read_settings(tiny_configuration)).sigma[1]
    assert rows[3]["sigma"] > 1.3 * end
    assert [row["sigma"] for row in rows[4:]] == pytest.approx([end, end])
    assert provenance_of(out)["sittings"] == [
        {"begin": 0, "end": 256, "changes": {}},
        {"begin": 256, "end": 384, "changes": {"final_races": [2, 4]}},
    ]
    rewrite(tiny_configuration, "policy", agents=8)
    with pytest.raises(UsageError, match="'agents' 4, which is now 8"):
        train(tiny_configuration, out, "--interactions", "512")


def test_what_does_not_matter_may_change_from_sitting_to_sitting():
    before = {"agents": 4, "rewards": {"crash": [2.0, 10.0]}, "track": {"gates": [{"yaw_deg": 0.0}]}, "seed": 0}
    now = {"agents": 4, "rewards": {"crash": [2.0, 7.0]}, "track": {"gates": [{"yaw_deg": 0.0}, {"yaw_deg": 9.0}]}}
    found = sittings.changes(before, now)
    assert found["rewards.crash"] == [[2.0, 10.0], [2.0, 7.0]]
    assert found["seed"] == [0, None] and found["track.gates[1].yaw_deg"] == [None, 9.0]
    sittings.require_same("file", before, now, ("agents", "rewards.cras", "track.gate"))
    for fixed in ("rewards", "track", "rewards.crash", "seed"):
        with pytest.raises(UsageError, match=f"'{fixed}"):
            sittings.require_same("file", before, now, (fixed,))


def test_schedules_stretch_with_the_interactions_and_stay_as_they_were_for_the_shipped_ones():
    settings = job.read_settings(FOLDER)
    shipped, short = Plan(settings.interactions), Plan(settings.interactions // 10)
    for updates in (0, 100, 305, 306, 457, 612, 1220, 1500):
        at, tenth = schedule_at(settings, shipped, updates), schedule_at(settings, short, 0.1 * updates)
        for first, second in zip(jax.tree.leaves(at), jax.tree.leaves(tenth), strict=True):
            assert float(first) == pytest.approx(float(second), rel=1e-4, abs=1e-6)
        interactions = updates * float(settings.batch)
        share = float(share_at(settings, shipped, updates))
        assert share == pytest.approx(min(interactions / 40000000, 1.0), rel=1e-6)
        assert float(at.difficulty) == pytest.approx(np.clip((interactions - 10000000) / 10000000, 0.0, 1.0), abs=1e-6)
        assert float(at.learning_rate_cap) == pytest.approx(1.0e-3 * 0.25**share, rel=1e-5)


def test_a_training_whose_randomisation_begins_at_its_end_stays_without():
    settings = replace(job.read_settings(FOLDER), difficulty_from=1.0, difficulty_full=2.0)
    for updates in (0, 1220, 5000):  # the last one beyond the schedule, as in the last update of a training
        assert schedule_at(settings, Plan(settings.interactions), updates).difficulty == 0.0


@pytest.mark.parametrize("algorithm", ["ppo", pytest.param("backpropagation", marks=pytest.mark.slow)])
def test_terms_of_the_reward_are_logged_and_printed_and_add_up_to_it(tiny_configuration, tmp_path, algorithm, capsys):
    content = yaml.safe_load((tiny_configuration / "training.yaml").read_text())
    rewards = {"progress": [1.0, 1.0], "rates": [1e-3, 1e-3], "smoothness": [0.1, 0.1]}
    content["policy"] |= {"rewards": rewards, "algorithm": algorithm, "interactions": 64}
    if algorithm == "backpropagation":
        del content["policy"]["ppo"]
    (tiny_configuration / "training.yaml").write_text(yaml.safe_dump(content))
    assert train(tiny_configuration, tmp_path / "out") == 0
    row = log_of(tmp_path / "out")[-1]
    terms = {name: row[f"{name}_reward_per_s"] for name in rewards}
    assert row["reward_per_s"] == pytest.approx(sum(terms.values()), rel=1e-4) and terms["rates"] < 0.0
    printed = capsys.readouterr().out
    assert f"reward {row['reward_per_s']:.2f} /s: " in printed and f"rates {terms['rates']:+.3g}" in printed


def test_progress_along_a_lap_that_is_not_given_is_refused(tiny_configuration, tmp_path):
    rewrite(tiny_configuration, "policy", rewards={"pace": [13.0, 13.0]})
    with pytest.raises(UsageError, match="reward 'pace' of .* and give its --out as --guide"):
        train(tiny_configuration, tmp_path / "out")


@pytest.fixture
def drawn(tmp_path, draw_picture):
    """Return a function: ticks of passages (2, 22), a guide -> the picture of a training, in blue, green and red."""
    track = configuration.load(Track, FOLDER / "track.yaml")
    lines, thrusts = np.full((2, 50, 3), np.nan), np.full((2, 50), np.nan)
    lines[:, :40], thrusts[:, :40] = np.linspace(track.start, track.positions[0], 40), np.linspace(10.0, 35.0, 40)
    rows = [{"interactions": 0, "finish_rate": 0.0, "median_lap_s": float("nan")}]
    rows += [{"interactions": 10**6, "finish_rate": 0.5, "median_lap_s": 6.2, "kl": 0.01, "learning_rate": 1e-4}]

    def draw(passage_ticks, guide=None):
        path, margins = tmp_path / "progress.png", np.zeros((2, 22))
        draw_picture(path, rows, trial.Trial(passage_ticks, margins, lines[:, 39], lines, thrusts), track, guide)
        assert list(tmp_path.iterdir()) == [path]
        return cv2.imread(str(path)).astype(int)

    return draw


def pixels(image, color, within) -> int:
    return np.sum(np.abs(image - color).sum(axis=-1) < within)


FINISHED = np.tile(np.arange(22), (2, 1))


def test_the_picture_has_the_curves_the_lines_and_the_ends_of_crashed_races(drawn):
    image, one_crashed = drawn(FINISHED), np.where([[False], [True]], -1, FINISHED)
    assert image.shape == (810, 1800, 3)
    for half in np.array_split(image[:, 700:], 2, axis=1):  # by speed and by thrust
        assert pixels(half, (148, 87, 51), 60) > 20  # viridis, of the lines
    red = (29, 24, 203)
    assert pixels(drawn(one_crashed), red, 30) > pixels(image, red, 30) + 20


def test_the_picture_has_the_time_optimal_lap_that_the_training_follows(drawn):
    angle = np.linspace(0.0, 2.0 * np.pi, 8 * 20).reshape(8, 20)
    circle = np.stack([6.0 * np.cos(angle), 6.0 * np.sin(angle), 2.0 + 0.0 * angle], axis=-1)
    guide = Guide(circle, circle, circle, angle, {})
    assert pixels(drawn(FINISHED, guide), (0, 0, 0), 90) > pixels(drawn(FINISHED), (0, 0, 0), 90) + 300


def test_an_unreadable_checkpoint_is_refused_in_one_sentence(tiny_configuration, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "training.npz").write_bytes(b"torn")
    with pytest.raises(UsageError, match="not a readable checkpoint"):
        train(tiny_configuration, tmp_path / "out")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"rewards": {"speed": [1, 1]}}, "unknown reward 'speed'"),
        ({"steps": 15}, "'ppo.minibatch' 32 must divide"),
        ({"algorithm": "backpropagation"}, "does not read the section 'ppo'; remove it"),
        ({"ppo": None}, "lacks its section 'ppo'"),
        ({"epoch": 3}, "unknown key 'epoch'"),
        ({"difficulty_from": 10000000}, "must be from 0.0 to 1.0"),
        ({"difficulty_from": 0.5, "difficulty_full": 0.25}, "shares of the training"),
        ({"fine_tuning": {"interactions": 1, "critic_first": 0, "schedule_share": 2.0}}, "must be from 0.0 to 1.0"),
        ({"fine_tuning": {"interactions": 6, "critic_first": 20, "schedule_share": 1.0}}, "less than 'interactions'"),
    ],
)
def test_bad_settings_are_refused_in_one_sentence(tiny_configuration, tmp_path, change, sentence):
    path = tiny_configuration / "training.yaml"
    content = yaml.safe_load(path.read_text())
    content["policy"] |= change
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(UsageError, match=sentence):
        train(tiny_configuration, tmp_path / "out")


def test_a_vehicle_that_its_firmware_does_not_take_is_refused(tiny_configuration, tmp_path):
    path = tiny_configuration / "drone.yaml"
    path.write_text(path.read_text().replace("dterm_lpf1_static_hz: 70", "dterm_lpf1_static_hz: 20000"))
    with pytest.raises(UsageError, match="dterm_lpf1_static_hz is 20000, and the firmware takes 0 to 1000"):
        train(tiny_configuration, tmp_path / "out")


def test_the_exported_actor_gives_the_actions_of_the_trained_one(tmp_path):
    actor = networks.make_actor_and_critic(jax.random.PRNGKey(0), SIZE, learner.CRITIC_SIZE)["actor"]
    actor[-1] = (actor[-1][0] * 300.0, actor[-1][1])  # some actions beyond the limits
    export.write_actor(tmp_path / "pilot.onnx", actor, SIZE)
    inputs = np.random.default_rng(0).normal(size=(200, SIZE)).astype(np.float32)
    expected = np.clip(np.asarray(networks.apply(actor, inputs)), -1, 1)
    onboard = Actor(tmp_path / "pilot.onnx")
    np.testing.assert_allclose([onboard.act(row) for row in inputs], expected, atol=1e-5)
    assert np.abs(expected).max() == 1


def test_advantages_end_at_a_crash_and_continue_after_a_timeout():
    settings = ppo.own_settings(job.read_settings(FOLDER))
    flags = {name: jnp.zeros((3, 1), bool) for name in ("done", "timeout", "passed", "crashed", "missed")}
    outcome = environment.Outcome(reward=jnp.ones((3, 1)), terms={}, margin=jnp.zeros((3, 1)), **flags)
    values, last = jnp.full((3, 1), 2.0), jnp.array([7.0])
    reward, discount = settings.reward_scale, settings.discount

    def advantages_with(step, *names):
        marked = {name: flag.at[step, 0].set(True) for name, flag in flags.items() if name in names}
        return np.asarray(ppo.advantages(settings, outcome._replace(**marked), values, last, 0.0))[:, 0]

    np.testing.assert_allclose(
        advantages_with(2), [reward + 2 * discount - 2] * 2 + [reward + 7 * discount - 2], rtol=1e-5
    )
    np.testing.assert_allclose(advantages_with(1, "done")[1], reward - 2, rtol=1e-5)
    np.testing.assert_allclose(advantages_with(1, "timeout")[1], reward + 2 * discount - 2, rtol=1e-5)


def test_of_equal_trials_the_last_is_the_best_as_its_policy_is_exported():
    trials = [{"difficulty": 1.0, "finish_rate": 1.0, "mean_lap_s": 5.641, "passages": 22.0, "races": 512}] * 2
    rows = [trial | {"interactions": number} for number, trial in enumerate(trials)]
    assert training.best_of(rows)["interactions"] == 1
    assert training.best_of([*rows, rows[0] | {"mean_lap_s": 5.642, "interactions": 2}])["interactions"] == 1
