"""The equation search on residuals whose equation is known."""

import re
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from swift_sim_bridge import units
from swift_sim_bridge.gap.discovery import equation_search, equation_text, feature_library
from swift_sim_bridge.gap.discovery.equation_search import EquationTerm, cause_layer, is_mirrored
from swift_sim_bridge.gap.discovery.feature_library import FeatureLibrary
from swift_sim_bridge.gap.discovery.features import Features
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.residuals.channels import Channel, vector

ROWS, RATE = 1500, 50
FORCE = (*vector("force", "specific_force", "specific force", "m/s^2")[::2],)
ACCELEROMETER = vector("imu", "accelerometer", "accelerometer vs pose,", "m/s^2")[2]
YAW_ACCELERATION = vector("moment", "angular_acceleration", "angular acceleration", "rad/s^2")[2]
NONE = np.array([], int)
VOLTAGE = Channel("motor", "voltage", "", "voltage", "V")


def quantities(rng) -> Features:
    v = np.cumsum(rng.standard_normal((ROWS, 2)), axis=0) / 8.0
    values = np.column_stack([np.ones(ROWS), v, np.abs(v[:, 0]) * v[:, 0], rng.standard_normal((ROWS, 6))])
    return Features(
        ("1", "v_x", "v_z", "|v_x| v_x", *(f"noise {i}" for i in range(6))),
        ("", "m/s", "m/s", "m^2/s^2", *[""] * 6),
        values,
    )


def line_of(residual) -> Linearisation:
    sensitivity, good = np.zeros((0, *residual.shape)), np.ones(len(residual), bool)
    return Linearisation(np.arange(len(residual)) / RATE, residual, sensitivity, good)


def search(
    coefficient: float,
    seed: int = 0,
    layer: str = "force",
    bias: float = 0.0,
    feature: int = 3,
    inflation: float = 1.0,
    steady: bool = False,
    scatter: float = 0.0,
    threshold: float = 30.0,
    hidden: tuple[int, ...] = (),
) -> tuple[EquationTerm, ...]:
    """Search in unit noise plus a coefficient times a feature, a part of which is bias of the pipeline.

    inflation: variance inflation of the feature |v_x| v_x.
    steady: search for weaker terms that every part of the flight shows.
    scatter: standard deviation of the coefficient over the seconds, as a share of it.
    threshold: of the gain; that of a steady term is half.
    hidden: channels whose size the commands leave open.
    """
    rng = np.random.default_rng(seed)
    own = quantities(rng)
    residual = rng.standard_normal((ROWS, 2))
    factor = np.repeat(1.0 + scatter * rng.standard_normal(ROWS // RATE), RATE)
    residual[:, 0] += coefficient * own.values[:, feature] * factor
    count = own.values.shape[1]
    bias_gradient = bias * own.values.T @ own.values[:, feature] * RATE / ROWS
    inflations = np.where(np.arange(count) == 3, inflation, 1.0)
    library = FeatureLibrary(
        ([own, own],), ([bias_gradient, np.zeros(count)],), [inflations, inflations], threshold, threshold / 2
    )
    channels = tuple(replace(channel, layer=layer) for channel in FORCE)
    residual_models = (SimpleNamespace(channels=channels, open_columns=np.array(hidden, int)),)
    return equation_search.search_equations(library, residual_models, [line_of(residual)], (np.ones(2),), steady=steady)


def test_a_planted_term_is_found_with_channel_feature_coefficient_and_unit():
    (term,) = search(0.05)
    assert (term.channel.id, term.name) == ("specific_force_x", "|v_x| v_x")
    assert term.value == pytest.approx(0.05, abs=4 * term.error) and term.unit == "1/m"
    assert "1/m) |v_x| v_x" in equation_text.equation((term,)) and cause_layer((term,)) == "force"


def test_a_channel_whose_size_the_commands_leave_open_shows_no_term():
    assert search(0.05, hidden=(1,)) and not search(0.05, hidden=(0,))


def test_the_largest_gain_wins_among_features_above_their_threshold_whatever_their_variance_inflation():
    (term,) = search(0.2, inflation=1.2)
    assert term.name == "|v_x| v_x"
    assert search(0.008) != ()
    assert search(0.008, inflation=9.0) == ()  # as large in reference flights


def test_an_axis_takes_the_tied_feature_of_another_axis_but_its_own_where_it_is_distinct():
    """Along x the residual is clearly quadratic in the speed; along z, with little of it, a linear one fits as well."""
    rng = np.random.default_rng(5)
    speed, angle = 10.0 + 2.0 * rng.standard_normal(ROWS), rng.uniform(-np.pi, np.pi, ROWS)
    v = speed[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    own = Features(
        ("v_x", "v_z", "|v| v_x", "|v| v_z"),
        ("m/s",) * 2 + ("m^2/s^2",) * 2,
        np.concatenate([v, speed[:, None] * v], axis=1),
    )
    library = FeatureLibrary(([own, own],), ([np.zeros(4)] * 2,), [np.ones(4)] * 2, 30.0, 15.0)
    noise, residual_models = rng.standard_normal((ROWS, 2)), (SimpleNamespace(channels=FORCE, open_columns=NONE),)

    def names(x: float, z: float) -> list[str]:
        line = line_of(noise + own.values[:, 2:] * [x, z])
        terms = equation_search.search_equations(library, residual_models, [line], (np.ones(2),))
        return [term.name for term in terms]

    assert names(0.0, 0.004) == ["v_z"] and names(0.02, 0.0) == ["|v| v_x"]
    assert names(0.02, 0.004) == ["|v| v_x", "|v| v_z"]
    assert names(0.0, 0.0015) == []
    assert names(0.02, 0.0015) == ["|v| v_x", "|v| v_z"]  # a repeated feature has a lower threshold


def term_of(channel: Channel, value: float, gain: float, name: str = "thrust") -> EquationTerm:
    return EquationTerm(channel, name, "m/s^2", value, 0.02 * abs(value), "", 0.0, 1.0, gain, gain)


def test_the_cause_is_in_the_first_layer_with_more_than_leakage_or_an_echo():
    charge, turn = term_of(VOLTAGE, -8e-5, 260.0, "charge"), term_of(YAW_ACCELERATION, 0.24, 29e3, "modelled turn z")
    assert cause_layer((charge, turn)) == "moment" and cause_layer((charge,)) == "motor"
    assert cause_layer((charge, turn), {"imu"}) == "imu"  # a selected effect may have absorbed a part of it
    force, error = term_of(FORCE[1], 30.0, 600.0), term_of(ACCELEROMETER, -30.0, 200.0)
    assert cause_layer((force, replace(error, value=4.0))) == "force"  # an echo: both filters smooth it differently
    assert cause_layer((force, error)) == "imu"
    assert cause_layer((force, replace(error, name="v_z", value=4.0))) == "imu"  # another feature is no echo


def test_an_error_of_the_accelerometer_is_one_number_in_force_and_pose():
    force, error = term_of(FORCE[1], 30.0, 600.0), term_of(ACCELEROMETER, -29.0, 200.0)
    assert is_mirrored(error, (force, error)) and not is_mirrored(force, (force, error))
    assert not is_mirrored(replace(error, value=29.0), (force, error))
    assert not is_mirrored(replace(error, name="1"), (force, error))
    assert not is_mirrored(error, (replace(force, channel=FORCE[0]), error))


def test_noise_gives_no_equation():
    assert all(search(0.0, seed) == () for seed in range(5))


def test_a_weaker_term_is_found_only_if_every_part_of_the_flight_shows_it():
    found = partial(search, 0.01, threshold=80.0)
    for seed in (0, 1):
        assert not found(seed) and found(seed, steady=True)
    assert found(1, scatter=1.0) and not found(1, scatter=1.0, steady=True)  # a gain of chance, as large as it is
    assert not any(search(0.0, seed, steady=True) for seed in range(20))


def test_a_term_that_is_bias_of_the_pipeline_or_needs_its_subtraction_is_rejected():
    (term,) = search(0.5, bias=-0.5, feature=4)
    assert term.name == "noise 0" and term.value == pytest.approx(1.0, abs=4 * term.error)
    assert search(0.5, bias=0.5, feature=4) == () and search(0.0, bias=0.5, feature=4) == ()
    assert search(0.5, bias=1.0, feature=4) == ()  # of opposite signs with and without the bias


def test_odometry_has_a_term_only_if_it_explains_much_of_its_drift():
    assert search(0.012) != () and search(0.012, layer="vio") == ()  # random drift may be correlated as much
    (term,) = search(0.05, layer="vio")
    assert cause_layer((term,)) == "vio" and term.name == "|v_x| v_x"


def test_the_unit_of_a_coefficient_follows_from_channel_and_feature():
    assert units.ratio("rad/s^2", "m/s") == "rad/(s m)" and units.ratio("V", "A s") == "V/(A s)"
    assert units.ratio("m/s", "m/s") == "" and units.product("rad/s", "m/s") == "rad m/s^2"


@pytest.mark.parametrize(("component", "size"), [("up_z", 3.0), ("thrust_z", 0.3)])
def test_an_unknown_force_at_one_place_is_described_with_the_place(component, size):
    rng, t = np.random.default_rng(4), np.arange(ROWS) / RATE
    path = 8.0 * np.stack([np.cos(0.8 * t), np.sin(0.8 * t), 0.1 * np.sin(0.5 * t)], axis=1)
    yaw = 0.3 * t
    turned = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(ROWS)]), np.tile([0.0, 0.0, 1.0], (ROWS, 1))
    thrust = 10.0 + 5.0 * np.sin(9.0 * t)
    names = ("east_x", "north_x", "up_x", "thrust"), ("east_z", "north_z", "up_z", "thrust")
    kinds = ("", "", "", "m/s^2")
    own = [Features(some, kinds, np.column_stack([axes, thrust])) for some, axes in zip(names, turned, strict=True)]
    library = FeatureLibrary((own,), ([np.zeros(4)] * 2,), [np.ones(4)] * 2, 80.0, 40.0)
    recording, rows = SimpleNamespace(p_world=path), SimpleNamespace(rows=np.arange(ROWS))
    (one,) = residual_models = (SimpleNamespace(channels=FORCE, recording=recording, filter=rows, open_columns=NONE),)
    noise, center, sigmas = 0.5 * rng.standard_normal((ROWS, 2)), np.array([8.0, 0.0, 0.0]), (np.full(2, 0.5),)
    weight = np.maximum(1.0 - np.sum((path - center) ** 2, axis=1) / 2.2**2, 0.0) ** 2
    force = size * (thrust if component == "thrust_z" else 1.0)
    line = line_of(noise + np.outer(weight * force, [0.0, 1.0]))
    with_local = feature_library.with_local_features
    assert with_local(library, residual_models, [line_of(noise)], sigmas) is library
    assert with_local(library, (one, one), [line] * 2, sigmas * 2) is library  # recordings need not share a world
    wider = with_local(library, residual_models, [line], sigmas)
    (term,) = equation_search.search_equations(wider, residual_models, [line], sigmas)
    assert term.channel == FORCE[1] and term.value == pytest.approx(size, rel=0.15)
    radius, x, y, z = re.fullmatch(rf"{component} within (.*) m of \((.*), (.*), (.*)\)", term.name).groups()
    assert float(radius) == pytest.approx(2.2, abs=0.4)
    assert np.linalg.norm(np.array([x, y, z], float) - center) < 0.4


@pytest.mark.parametrize(
    ("channel", "name", "expected"),
    [
        ("specific_force_y", "|v| v_y", "|v| v_*"),
        ("angular_acceleration_x", "modelled turn x", "modelled turn *"),
        ("specific_force_z", "v_xy^2", "v_xy^2"),
        ("specific_force_x", "v_y", "v_y"),
        ("rotor_speed_1", "Omega", "Omega"),
        ("angular_acceleration_z", "omega_x omega_z", "omega_x omega_*"),
    ],
)
def test_a_feature_along_the_axis_of_each_channel_has_one_name(channel, name, expected):
    quantity, _, part = channel.rpartition("_")
    term = EquationTerm(
        Channel("force", quantity, part, channel, "m/s^2"), name, "", 1.0, 0.1, "", 0.0, 1.0, 90.0, 90.0
    )
    assert equation_search.axis_free_name(term) == expected
