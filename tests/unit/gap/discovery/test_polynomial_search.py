"""The search for an equation of the vehicle file, on a motion in closed form to whose residuals a force is added."""

from dataclasses import replace

import jax
import lissajous_flight
import numpy as np
import pytest
from known_motion import motion
from known_residuals import residual_model, vehicle
from lissajous_flight import flight

from swift_ros import geometry
from swift_ros.recording.flight_table import Samples
from swift_sim_bridge.gap.discovery import polynomial_search
from swift_sim_bridge.gap.inference.sensitivity import Linearisation, linearise, perturbed_variants
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals.filters import apply
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

NOISE = 0.3
PEAK = (1330, 300)  # rad/s, of a resonance of the motors and its reach


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def searched(force_y, share=1.0, known=(), refused=frozenset()):
    """Search in residuals that are noise and a force (n,) N along y, of the samples' velocities (n, 3) m/s."""
    one = residual_model()
    channels = [channel.id for channel in one.channels]
    residual = NOISE * np.random.default_rng(3).standard_normal((len(one.t), len(channels)))
    v = motion(one.recording.t)
    v_body = geometry.rotate_inverse(v.q_world_body, v.v_world)
    added = apply(one.filter.smooth, force_y(one.recording.t, v_body)[:, None])[:, 0] / vehicle().mass
    residual[:, channels.index("specific_force_y")] += added
    line = Linearisation(one.t, residual, np.zeros((0, *residual.shape)), one.good)
    residuals = polynomial_search.Residuals((one,), [line], (np.full(len(channels), NOISE),))
    return polynomial_search.search(residuals, vehicle(), share, known, refused=refused)


def test_a_planted_product_is_found_with_its_side_and_the_range_of_the_flight():
    (found,) = searched(lambda t, v: 0.02 * v[:, 0] * v[:, 2])
    assert found.name == "force_y: v_x v_z" and found.removed_share > 0.75  # of the error with its noise
    assert found.range[0] < -10.0 < 10.0 < found.range[1]


def test_a_simpler_product_that_fits_clearly_worse_does_not_win_though_it_removes_nearly_as_much():
    (found,) = searched(lambda t, v: 0.05 * np.linalg.norm(v, axis=1) ** 0.6 * v[:, 1])  # nearer to |v| v_y than to v_y
    assert found.product == "|v| v_y"


def test_another_product_joins_in_the_place_of_one_that_is_refused():
    def force(t, v):
        return 0.02 * v[:, 0] * v[:, 2] + 0.06 * v[:, 0]

    refused = frozenset({"force_y: v_x"})
    known = [one for one in searched(force) if one.name not in refused]
    assert [one.name for one in known] == ["force_y: v_x v_z"]
    first, *others = searched(force, known=known, refused=refused)
    assert first == known[0] and others and refused.isdisjoint(one.name for one in others)


def test_two_products_come_in_the_order_of_what_each_removes():
    first, second = searched(lambda t, v: 0.02 * v[:, 0] * v[:, 2] + 0.06 * v[:, 0])
    assert {first.name, second.name} == {"force_y: v_x v_z", "force_y: v_x"}
    assert first.removed_share > second.removed_share > 0.02


def test_more_of_the_flight_shows_a_weak_summand_beside_the_known_one():
    def force(t, v):
        return 0.01 * v[:, 0] * v[:, 2] + 0.015 * v[:, 0]

    known = searched(force, 0.5)
    assert [one.name for one in known] == ["force_y: v_x v_z"]
    strong, weak = searched(force, 1.0, known)
    assert strong == known[0] and weak.name == "force_y: v_x"


def test_the_range_is_that_of_the_whole_flight_also_where_a_part_is_searched():
    (half,), (whole,) = (searched(lambda t, v: 0.05 * v[:, 0] * v[:, 2], share) for share in (0.5, 1.0))
    assert half.name == whole.name and half.range == whole.range


def test_the_range_of_a_current_is_the_recorded_one_though_the_voltage_has_no_mean():
    table, file = flight(2), lissajous_flight.vehicle()
    current, voltage = table["current"].values, table["voltage"]
    lowered = Samples(voltage.t, voltage.values - 0.03 * current)
    one = ResidualModel(read_recording(replace(table, channels={**table.channels, "voltage": lowered}), file))
    line = linearise(one, perturbed_variants(file, ()))
    residuals = polynomial_search.Residuals((one,), [line], (np.full(len(one.channels), 0.02),))
    (found,) = (one for one in polynomial_search.search(residuals, file, 1.0) if one.side == "voltage")
    assert found.product == "current" and found.range[0] > 0.0
    assert found.range[0] < np.quantile(current, 0.01) and np.quantile(current, 0.99) < found.range[1]


def of_motors(losses: dict[str, float]) -> list[str]:
    """Return what the search finds in a flight whose motors lose speed by these products of up to 1."""
    lost = {product: {"coefficient": -most, "range": [0.0, 1.0]} for product, most in losses.items()}
    table, file = flight(2, equation={"rotor_speed": lost}), lissajous_flight.vehicle()
    one = ResidualModel(read_recording(table, file))
    line = linearise(one, perturbed_variants(file, ()))
    residuals = polynomial_search.Residuals((one,), [line], (np.full(len(one.channels), 5.0),))
    return [one.product for one in polynomial_search.search(residuals, file, 1.0) if one.side == "rotor_speed"]


def test_motors_that_lose_speed_from_a_command_on_show_a_bend():
    assert of_motors({"over(u,0.45)": 600.0})[0] in ("over(u,0.4)", "over(u,0.5)")


def test_motors_that_lose_speed_at_a_resonance_show_a_peak_of_the_speed_that_they_have():
    center, reach = PEAK
    product, *_ = of_motors({f"around(Omega,{center},{reach})": 100.0})
    assert product.startswith("around(Omega,")
    assert float(product[13:-1].split(",")[0]) == pytest.approx(center, abs=0.06 * center)


def test_each_rotor_gets_a_coefficient_of_its_own_where_they_differ_clearly():
    center, reach = PEAK
    found = of_motors({f"rotor_{i} around(Omega,{center},{reach})": 40.0 * i for i in (1, 2, 3, 4)})
    peaks = [one for one in found if "around" in one]
    assert [one.split()[0] for one in peaks[:4]] == ["rotor_1", "rotor_2", "rotor_3", "rotor_4"]
    assert len({one.split()[1] for one in peaks[:4]}) == 1


def test_each_rotor_gets_a_peak_at_its_own_speed_in_exchange_for_the_one_that_they_share():
    centers = {i: PEAK[0] + 80 * (i - 2.5) for i in (1, 2, 3, 4)}
    found = of_motors({f"rotor_{i} around(Omega,{center:.0f},200)": 120.0 for i, center in centers.items()})
    own = {int(one[6]): float(one.split("(Omega,")[1].split(",")[0]) for one in found if one.startswith("rotor_")}
    assert set(own) == set(centers)
    assert [own[i] for i in sorted(own)] == pytest.approx([centers[i] for i in sorted(own)], abs=45.0)


def test_a_peak_at_a_speed_that_no_rotor_reached_is_not_offered():
    found = of_motors({"over(Omega,1300)": 0.3})
    fastest = np.quantile(flight(2)["rotor_speed"].values, 0.995, axis=0).max()
    peaks = [float(one.split("(Omega,")[1].split(",")[0]) for one in found if "around(Omega" in one]
    assert all(peak < fastest for peak in peaks)


def test_thrust_that_each_rotor_loses_is_one_summand_of_force_and_moments():
    loss = {"thrust over(mu,0.04)": {"coefficient": -3.0, "range": [0.0, 1.0]}}
    table, file = flight(2, equation={"rotor_thrust": loss}), lissajous_flight.vehicle()
    one = ResidualModel(read_recording(table, file))
    line = linearise(one, perturbed_variants(file, ()))
    residuals = polynomial_search.Residuals((one,), [line], (np.std(line.residual, axis=0) / 4.0,))
    plain, at_rotors = (polynomial_search.search(residuals, file, 1.0, at_rotors=one) for one in (False, True))
    (strong,) = (one for one in at_rotors if one.removed_share > 0.05)
    assert strong.name.startswith("rotor_thrust: thrust over(mu,0.0") and strong.removed_share > 0.5
    assert {one.side for one in plain if one.removed_share > 0.05} == {"force_z", "moment_x", "moment_y"}


def test_a_coefficient_that_flips_between_the_halves_of_the_flight_is_not_kept():
    assert searched(lambda t, v: np.where(t < 6.0, 0.02, -0.02) * v[:, 0] * v[:, 2]) == []


def test_a_force_that_follows_the_heading_is_not_the_vehicle_s():
    q = motion(residual_model().recording.t).q_world_body
    north = geometry.rotate_inverse(q, np.broadcast_to([0.0, 1.0, 0.0], (len(q), 3)))
    found = searched(lambda t, v: 0.5 * north[:, 1] + 0.02 * v[:, 0] * v[:, 2])
    assert "force_y: v_x v_z" in [one.name for one in found]
    assert not any(world in one.product for one in found for world in ("north", "east"))


def test_noise_alone_gives_no_equation():
    assert searched(lambda t, v: np.zeros(len(t))) == []


def test_a_force_at_a_place_is_found_where_the_place_is_offered():
    one = residual_model()
    near = "near(1.000,-0.500,0.000,4.000)"
    apart = np.sum((motion(one.recording.t).p_world - [1.0, -0.5, 0.0]) ** 2, axis=1)
    weight = np.maximum(1.0 - apart / 16.0, 0.0) ** 2
    channels = [channel.id for channel in one.channels]
    residual = NOISE * np.random.default_rng(4).standard_normal((len(one.t), len(channels)))
    added = apply(one.filter.smooth, 3.0 * weight[:, None])[:, 0] / vehicle().mass
    residual[:, channels.index("specific_force_z")] += added
    line = Linearisation(one.t, residual, np.zeros((0, *residual.shape)), one.good)
    residuals = polynomial_search.Residuals((one,), [line], (np.full(len(channels), NOISE),), (near,))
    found = polynomial_search.search(residuals, vehicle(), 1.0)
    assert found[0].side == "force_z" and found[0].product.startswith(near)
