"""What no effect of the catalogue explains: an equation in known quantities, a place, or air that wanders."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from swift_sim_bridge.gap.attribution import wind as air
from swift_sim_bridge.gap.discovery import equation_search, equation_text, units
from swift_sim_bridge.gap.discovery.features import Features
from swift_sim_bridge.gap.inference import gust_correlation, local_wind_search
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.nominal import phase_surrogates
from swift_sim_bridge.gap.residuals.channels import Channel, vector

ROWS, RATE = 1500, 50
FORCE = (*vector("force", "specific_force", "specific force", "m/s^2")[::2],)
FELT = vector("imu", "accelerometer", "pose's less accelerometer's force", "m/s^2")[2]
TURN, VOLTS = (
    vector("moment", "angular_acceleration", "angular acceleration", "rad/s^2")[2],
    Channel("motor", "voltage", "", "voltage", "V"),
)


def quantities(rng) -> Features:
    v = np.cumsum(rng.standard_normal((ROWS, 2)), axis=0) / 8.0
    values = np.column_stack([np.ones(ROWS), v, np.abs(v[:, 0]) * v[:, 0], rng.standard_normal((ROWS, 6))])
    return Features(
        ("1", "v_x", "v_z", "|v_x| v_x", *(f"noise {i}" for i in range(6))),
        ("", "m/s", "m/s", "m^2/s^2", *[""] * 6),
        values,
    )


def line_of(residual, columns=None) -> Linearisation:
    columns = np.zeros((0, *residual.shape)) if columns is None else columns
    return Linearisation(np.arange(len(residual)) / RATE, residual, columns, np.ones(len(residual), bool))


def found(
    strength: float, seed: int = 0, layer: str = "force", made: float = 0.0, feature: int = 3, scatter: float = 1.0
):
    """Search in noise that goes by a feature with this strength, of which the pipeline itself makes so much; scatter:
    how much more than noise twins show of the fourth feature."""
    rng = np.random.default_rng(seed)
    own = quantities(rng)
    residual = rng.standard_normal((ROWS, 2))
    residual[:, 0] += strength * own.values[:, feature]
    count = own.values.shape[1]
    artefact = made * own.values.T @ own.values[:, feature] * RATE / ROWS
    copies = np.where(np.arange(count) == 3, scatter, 1.0)
    known = equation_search.FeatureLibrary(([own, own],), ([artefact, np.zeros(count)],), [copies, copies], 30.0)
    residual_models = (SimpleNamespace(channels=tuple(replace(channel, layer=layer) for channel in FORCE)),)
    return equation_search.search(known, residual_models, [line_of(residual)], (np.ones(2),))


def test_what_is_left_comes_back_with_channel_quantity_size_and_unit():
    (term,) = found(0.05)
    assert (term.channel.name, term.name) == ("specific force x", "|v_x| v_x")
    assert term.value == pytest.approx(0.05, abs=4 * term.error) and term.unit == "1/m"
    assert "1/m) |v_x| v_x" in equation_text.equation((term,)) and equation_search.cause_layer((term,)) == "force"


def test_of_quantities_beyond_chance_the_one_that_explains_most_stands_however_twins_scatter_by_it():
    (term,) = found(0.2, scatter=1.2)
    assert term.name == "|v_x| v_x"
    assert found(0.008) != () and found(0.008, scatter=9.0) == ()  # which twins show as large is none


def test_axes_go_by_one_quantity_unless_one_of_them_tells_another():
    """Along x it is plain that drag goes by the square of the speed; along z, where little of it is, it might not."""
    rng = np.random.default_rng(5)
    speed, angle = 10.0 + 2.0 * rng.standard_normal(ROWS), rng.uniform(-np.pi, np.pi, ROWS)
    v = speed[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    own = Features(
        ("v_x", "v_z", "|v| v_x", "|v| v_z"),
        ("m/s",) * 2 + ("m^2/s^2",) * 2,
        np.concatenate([v, speed[:, None] * v], axis=1),
    )
    known = equation_search.FeatureLibrary(([own, own],), ([np.zeros(4)] * 2,), [np.ones(4)] * 2, 30.0)
    noise, residual_models = rng.standard_normal((ROWS, 2)), (SimpleNamespace(channels=FORCE),)

    def goes(x: float, z: float) -> list[str]:
        line = line_of(noise + own.values[:, 2:] * [x, z])
        return [term.name for term in equation_search.search(known, residual_models, [line], (np.ones(2),))]

    assert goes(0.0, 0.004) == ["v_z"] and goes(0.02, 0.0) == ["|v| v_x"]
    assert goes(0.02, 0.004) == ["|v| v_x", "|v| v_z"]
    assert goes(0.0, 0.0015) == [] and goes(0.02, 0.0015) == ["|v| v_x", "|v| v_z"]  # one of a few, not of all features


def term_of(channel: Channel, value: float, lowers: float, name: str = "thrust") -> equation_search.EquationTerm:
    return equation_search.EquationTerm(channel, name, "m/s^2", value, 0.02 * abs(value), "", 0.0, 1.0, lowers, lowers)


def test_the_cause_lies_in_the_first_layer_that_holds_more_than_a_trace_or_an_echo_of_it():
    volts, turn = term_of(VOLTS, -8e-5, 260.0, "charge"), term_of(TURN, 0.24, 29e3, "modelled turn z")
    assert equation_search.cause_layer((volts, turn)) == "moment" and equation_search.cause_layer((volts,)) == "motor"
    assert equation_search.cause_layer((volts, turn), {"imu"}) == "imu"  # where a name may have taken a part of it
    pushed, error = term_of(FORCE[1], 30.0, 600.0), term_of(FELT, -30.0, 200.0)
    assert (
        equation_search.cause_layer((pushed, replace(error, value=4.0))) == "force"
    )  # by a push too short to be followed alike
    assert equation_search.cause_layer((pushed, error)) == "imu"
    assert (
        equation_search.cause_layer((pushed, replace(error, name="v_z", value=4.0))) == "imu"
    )  # another quantity is no echo


def test_the_accelerometers_own_error_in_force_and_pose_is_one_number():
    pushed, error = term_of(FORCE[1], 30.0, 600.0), term_of(FELT, -29.0, 200.0)
    assert equation_search.is_mirrored(error, (pushed, error)) and not equation_search.is_mirrored(
        pushed, (pushed, error)
    )
    assert not equation_search.is_mirrored(replace(error, value=29.0), (pushed, error))
    assert not equation_search.is_mirrored(replace(error, name="1"), (pushed, error))
    assert not equation_search.is_mirrored(error, (replace(pushed, channel=FORCE[0]), error))


def test_noise_calls_for_no_equation():
    assert all(found(0.0, seed) == () for seed in range(5))


def test_what_only_the_pipeline_makes_or_only_its_lack_calls_for_is_no_term():
    (term,) = found(0.5, made=-0.5, feature=4)
    assert term.name == "noise 0" and term.value == pytest.approx(1.0, abs=4 * term.error)
    assert found(0.5, made=0.5, feature=4) == () and found(0.0, made=0.5, feature=4) == ()
    assert found(0.5, made=1.0, feature=4) == ()  # with what it makes more than none, without it less


def test_odometry_goes_by_a_quantity_only_where_that_is_much_of_its_wandering():
    assert found(0.012) != () and found(0.012, layer="vio") == ()  # a drift may show as much by chance
    (term,) = found(0.05, layer="vio")
    assert equation_search.cause_layer((term,)) == "vio" and term.name == "|v_x| v_x"


def test_units_of_coefficients_follow_from_what_they_join():
    assert units.ratio("rad/s^2", "m/s") == "rad/(s m)" and units.ratio("V", "A s") == "V/(A s)"
    assert units.ratio("m/s", "m/s") == "" and units.product("rad/s", "m/s") == "rad m/s^2"


def wind_and_path(rng):
    """What winds do to three residuals, and where the vehicle was: a ring, flown again and again."""
    t = np.arange(ROWS) / RATE
    path = 8.0 * np.stack([np.cos(0.8 * t), np.sin(0.8 * t), 0.1 * np.sin(0.5 * t)], axis=1)
    return 0.4 * np.eye(3)[:, None, :] + 0.05 * rng.standard_normal((3, ROWS, 3)), path


def test_a_draught_is_found_where_it_blows():
    rng = np.random.default_rng(1)
    wind, path = wind_and_path(rng)
    center, velocity = np.array([8.0, 0.0, 0.0]), np.array([0.0, 2.0, 0.0])
    share = np.maximum(1.0 - np.sum((path - center) ** 2, axis=1) / 2.2**2, 0.0) ** 2
    residual = 0.1 * rng.standard_normal((ROWS, 3)) - np.einsum("i,imc->mc", velocity, wind) * share[:, None]
    place = local_wind_search.search(line_of(residual), wind, path, np.full(3, 0.1))
    assert np.linalg.norm(place.center - center) < 1.5 and place.velocity == pytest.approx(velocity, abs=0.5)


def test_what_pushes_at_one_place_and_has_no_name_comes_back_with_the_place():
    rng = np.random.default_rng(4)
    _, path = wind_and_path(rng)
    yaw = 0.3 * np.arange(ROWS) / RATE
    turned = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(ROWS)]), np.tile([0.0, 0.0, 1.0], (ROWS, 1))
    names = ("east_x", "north_x", "up_x"), ("east_z", "north_z", "up_z")
    own = [Features(some, ("",) * 3, values) for some, values in zip(names, turned, strict=True)]
    known = equation_search.FeatureLibrary((own,), ([np.zeros(3)] * 2,), [np.ones(3)] * 2, 80.0)
    (one,) = residual_models = (
        SimpleNamespace(
            channels=FORCE, recording=SimpleNamespace(p_world=path), filter=SimpleNamespace(rows=np.arange(ROWS))
        ),
    )
    noise, center = 0.5 * rng.standard_normal((ROWS, 2)), np.array([8.0, 0.0, 0.0])
    share = np.maximum(1.0 - np.sum((path - center) ** 2, axis=1) / 2.2**2, 0.0) ** 2
    lifted = line_of(noise + np.outer(share, [0.0, 3.0])), (np.full(2, 0.5),)
    assert equation_search.with_local_features(known, residual_models, [line_of(noise)], lifted[1]) is known
    assert (
        equation_search.with_local_features(known, (one, one), [lifted[0]] * 2, lifted[1] * 2) is known
    )  # whose world is which?
    wider = equation_search.with_local_features(known, residual_models, [lifted[0]], lifted[1])
    (term,) = equation_search.search(wider, residual_models, [lifted[0]], lifted[1])
    assert term.channel == FORCE[1] and term.value == pytest.approx(3.0, rel=0.15)
    name, radius, x, y, z = re.fullmatch(r"(up_z) within (.*) m of \((.*), (.*), (.*)\)", term.name).groups()
    assert 1.0 < float(radius) < 3.5 and np.linalg.norm(np.array([x, y, z], float) - center) < 1.5


def test_gusts_are_told_from_noise_by_what_the_next_half_second_still_feels():
    rng = np.random.default_rng(2)
    wind, _ = wind_and_path(rng)
    noise = 0.2 * rng.standard_normal((ROWS, 3))
    white = gust_correlation.agreement(line_of(noise), wind, np.full(3, 0.2))
    keep, air = np.exp(-1.0 / (2.0 * RATE)), np.zeros((ROWS, 3))
    for i in range(1, ROWS):
        air[i] = keep * air[i - 1] + np.sqrt(1.0 - keep**2) * rng.standard_normal(3)
    gusty = gust_correlation.agreement(line_of(noise - np.einsum("mi,imc->mc", air, wind)), wind, np.full(3, 0.2))
    assert abs(white.deviations) < 4.0 < 5.0 < gusty.deviations
    assert gusty.product == pytest.approx(3 * 0.78, rel=0.6)


def test_what_no_twin_flies_is_noise_of_the_recordings_own_colour():
    rng = np.random.default_rng(3)
    column = np.cumsum(rng.standard_normal((ROWS, 1)), axis=0)[None]
    noise = np.convolve(rng.standard_normal(ROWS + 9), np.ones(10) / 10.0, "valid")[:, None]
    own = line_of(
        np.concatenate([np.zeros((ROWS, 1)), noise - 3.0 * column[0]], axis=1),
        np.concatenate([np.zeros((1, ROWS, 1)), column], axis=2),
    )
    twin, *_ = phase_surrogates.with_surrogate_channels(
        [line_of(np.zeros((ROWS - 7, 1)), np.zeros((1, ROWS - 7, 1)))], own, [np.ones((ROWS, 1))] * 2, 0
    )
    drawn = twin.residual[:, 1]
    assert drawn.std() == pytest.approx(noise.std(), rel=0.1)
    assert np.corrcoef(drawn[1:], drawn[:-1])[0, 1] == pytest.approx(0.9, abs=0.1)
    assert twin.sensitivity.shape == (1, ROWS - 7, 2)


def test_what_scatters_more_at_some_time_of_the_way_is_weighed_less_there():
    rng, lines = np.random.default_rng(3), []
    for shift in range(12):
        residual = rng.standard_normal((ROWS, 2))
        residual[200:220, 0] *= 1.0 + 4.0 * rng.random()  # in the wake, by chance
        lines.append(replace(line_of(residual), t=(np.arange(ROWS) + shift) / RATE))
    rough = air.local_sigma(lines, np.array([0.5, 2.0]), lines[0].t)
    assert np.median(rough, axis=0) == pytest.approx([0.5, 2.0], rel=0.05)
    assert rough[205:215, 0].min() > 1.0 and rough[205:215, 1].max() < 3.0 and np.all(rough >= [0.5, 2.0])
