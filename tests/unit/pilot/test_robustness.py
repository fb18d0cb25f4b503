"""What a pilot withstands: each disturbance reaches the episodes, and the table says what came of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.pilot import robustness, trial
from swift_sim_bridge.pilot.episodes import environment, randomization, starts
from swift_sim_bridge.pilot.episodes import world as worlds
from swift_sim_bridge.pilot.episodes.randomization import UNDISTURBED, Disturbance
from swift_sim_bridge.pilot.job import read_settings


@pytest.fixture(scope="module")
def world(repository):
    folder = repository / "config"
    settings = read_settings(folder)
    kinds = {"track.yaml": Track, "drone.yaml": Vehicle, "camera.yaml": Camera}
    files = (configuration.load(kind, folder / name) for name, kind in kinds.items())
    return worlds.make_world(*files, settings.environment, settings.estimate_errors)


def test_a_disturbance_comes_on_top_of_what_is_drawn(world):
    drawn = randomization.draw_episode(jax.random.PRNGKey(0), 50, jnp.float32(1.0), world.errors, world.settings)
    same = randomization.disturbed(drawn, UNDISTURBED)
    jax.tree.map(np.testing.assert_array_equal, same, drawn)
    by = Disturbance(mass=1.05, thrust=0.93, drag=2.0, error=3.0, delay_s=0.02, used_share=0.25)
    changed = randomization.disturbed(drawn, by)
    np.testing.assert_allclose(changed.mass_factor, 1.05 * drawn.mass_factor)
    np.testing.assert_allclose(changed.rotor_drag_factor, 2.0 * drawn.rotor_drag_factor)
    np.testing.assert_allclose(changed.error_scale, 3.0 * drawn.error_scale)
    np.testing.assert_allclose(changed.delay_ticks, drawn.delay_ticks + 2.0, rtol=1e-6)
    parameters = randomization.parameters_of(changed, world.parameters)
    thrust = world.parameters.rotors.thrust_coefficient * 0.93 * drawn.thrust_factor[:, None]
    np.testing.assert_allclose(parameters.rotors.thrust_coefficient, thrust, rtol=1e-6)


def test_an_episode_begins_with_the_disturbance(world):
    bank = starts.first_bank(world)
    by = Disturbance(*map(np.float32, Disturbance(delay_s=0.04, used_share=0.25)))
    conditions = environment.Conditions(jnp.float32(0.0), commands=7, by=by)
    agents = environment.reset(world, bank, jax.random.PRNGKey(0), 4, conditions)
    np.testing.assert_allclose(agents.flight.state.charge, 0.25 * world.vehicle.battery.capacity, rtol=1e-6)
    commands = jnp.arange(7.0)[None, :, None] * jnp.ones((4, 7, 4))
    np.testing.assert_allclose(environment.delayed_command(commands, agents.episode.delay_ticks), 4.0)


def test_the_first_row_is_flown_without_errors_and_each_other_one_with_another_disturbance(repository, monkeypatch):
    flown, races = [], 3
    ticks = np.broadcast_to(np.arange(1, 23) * 90, (races, 22))
    found = trial.Trial(ticks, np.full((races, 22), 0.2), np.zeros((races, 3)), np.zeros((1, 1, 3)), np.zeros((1, 1)))

    def compile_races(world, races):
        return lambda actor, key, difficulty, by: flown.append((float(difficulty), by)) or found

    monkeypatch.setattr(robustness.trial, "compile_races", compile_races)
    folder = repository / "config"
    files = robustness.Files(folder, folder / "models/pilot.onnx", folder / "track.yaml", folder / "drone.yaml")
    result = robustness.measure(files, races, seed=0, progress=lambda text: None)
    assert list(result) == list(robustness.DISTURBANCES) and list(result)[0] == robustness.IDEAL
    difficulties, disturbances = zip(*flown, strict=True)
    assert difficulties == (0.0, *[1.0] * (len(flown) - 1))
    assert len(set(disturbances[1:])) == len(flown) - 1
    assert result[robustness.IDEAL]["median_lap_s"] == pytest.approx(6.3)


def test_the_table_has_all_rows():
    row = {"finish_rate": 0.98, "races": 50, "median_lap_s": 6.1, "best_lap_s": 6.0, "mean_margin_m": 0.3}
    rows = robustness.table({"mass +5 %": row | {"lap_ratio": 1.1}, "drag x 2": row})
    assert rows[1:] == [
        ("mass +5 %", "49 of 50", "6.10", "1.100", "6.00", "0.30"),
        ("drag x 2", "49 of 50", "6.10", "-", "6.00", "0.30"),
    ]
