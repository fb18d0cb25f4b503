"""Is a name worth more than an equation? On accounts whose truth is known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from swift_ros.configuration import configuration_folder, load
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution import model_comparison
from swift_sim_bridge.gap.attribution.model_comparison import Explanation
from swift_sim_bridge.gap.discovery import equation_search
from swift_sim_bridge.gap.effects import catalogue
from swift_sim_bridge.gap.effects.injection import file_values
from swift_sim_bridge.gap.inference import sensitivity
from swift_sim_bridge.gap.residuals.channels import Channel

NOISE = np.random.default_rng(1).standard_normal((500, 1))
NAMED = Explanation(("body_drag",), {}, (), 500.0 + 31.0, 31.0, 3, 0.0, [NOISE])
WAVE = 0.4 * np.sin(np.arange(500))[:, None]
VEHICLE = load(Vehicle, configuration_folder() / "drone.yaml")
NAMES = ("com_offset", "drag_center", "thrust_coefficient")


def test_a_name_is_open_where_an_equation_as_short_explains_as_much_and_says_something_else():
    other = replace(NAMED, keys=(), loss=498.0 + 63.0, cost=63.0, rest=[NOISE + WAVE])
    less = replace(other, loss=520.0 + 63.0)
    assert model_comparison._open(NAMED, other, 0.0)
    assert not model_comparison._open(NAMED, replace(other, rest=[NOISE]), 0.0)  # the same in other words
    assert not model_comparison._open(NAMED, replace(other, numbers=4), 0.0)
    assert not model_comparison._open(NAMED, less, 0.0) and model_comparison._open(
        NAMED, less, 20.0
    )  # of so much no simulator is sure
    assert not model_comparison._open(NAMED, other, 30.0)  # and by so little it says nothing else
    cheaper = replace(other, loss=520.0, numbers=4, rest=[-NOISE])
    assert model_comparison._open(NAMED, cheaper, 0.0)  # whatever it says


def test_a_name_gives_way_to_an_equation_that_costs_less_or_is_no_longer_and_explains_more():
    other = replace(NAMED, keys=(), loss=480.0 + 63.0, cost=63.0)
    assert other.loss > NAMED.loss and model_comparison._clearly(other, NAMED, 0.0)
    assert not model_comparison._clearly(other, NAMED, 10.0)  # of so much the simulator is not sure
    assert not model_comparison._clearly(replace(other, numbers=4), NAMED, 0.0)
    assert model_comparison._clearly(replace(other, numbers=4, loss=440.0 + 47.0, cost=47.0), NAMED, 0.0)


def test_an_equation_that_in_truth_leaves_more_is_no_better_whatever_the_pipeline_makes_of_a_strong_name():
    other = replace(NAMED, keys=(), loss=400.0, numbers=9, rest=[1.2 * NOISE])
    assert not model_comparison._clearly(other, NAMED, 0.0) and not model_comparison._open(NAMED, other, 0.0)
    made = replace(NAMED, by_pipeline=200.0)  # so much of what it explains may be the pipeline's own
    assert model_comparison._clearly(other, made, 0.0) and model_comparison._open(made, other, 0.0)


@pytest.mark.parametrize("names", [NAMES, NAMES[:2]])
@pytest.mark.parametrize(
    ("explains", "numbers", "kept"), [(60.0, 3, False), (20.0, 3, True), (60.0, 9, True), (500.0, 9, False)]
)
def test_names_for_what_one_short_equation_explains_are_neighbours_of_a_cause_without_a_name(
    names, explains, numbers, kept, monkeypatch
):
    """None of them can be missed beside the others, so that no trial without one of them gives it away."""

    def explain(evidence, vehicle, keys, values, nothing):
        loss = 1e5 if 0 < len(keys) < len(names) else 1000.0 if keys else 1000.0 - explains
        return Explanation(tuple(keys), {}, (), loss, 50.0, 9 if keys else numbers, 0.0, [NOISE])

    monkeypatch.setattr(model_comparison, "account", explain)
    monkeypatch.setattr(model_comparison, "squares", lambda evidence, lines: 1e5)
    monkeypatch.setattr(model_comparison, "possible", lambda evidence, effect, values: True)
    monkeypatch.setattr(model_comparison.estimate, "residuals_at", lambda evidence, vehicle: [])
    evidence = SimpleNamespace(effects=[SimpleNamespace(key=key, retimes=False) for key in names])
    best = model_comparison.best_explanation(evidence, None, list(names), {}, lambda text: None)
    assert best.keys == (names if kept else ())


def test_a_draught_as_wide_as_the_whole_air_or_far_from_the_way_is_none():
    wide, place = catalogue.draught(), np.array([2.0, 0.0, 0.0, 1.0, 2.0, 1.0, 10.0])
    assert not model_comparison.possible(None, wide, {wide.key: place})
    assert model_comparison.possible(None, wide, {wide.key: np.append(place[:-1], 3.0)})
    astray = np.array([2.0, 0.0, 0.0, 1.0, 2.0, 2.9999, 3.0])  # as far from where it was sought as it may go
    assert not model_comparison.possible(None, wide, {wide.key: astray})


@pytest.mark.parametrize(("size", "made"), [(5.0, -96.0), (-5.0, 96.0), (0.1, 0.0)])
def test_what_the_pipeline_makes_is_neither_merit_nor_fault_of_a_name(size, made, monkeypatch):
    """Its product of 10 with a footprint of square 25 raises the squares of a name that goes the same way by 2 x 10 a
    step, and alone would lower them by 4."""
    sums = SimpleNamespace(samples=np.full(10, 50.0), matrix=np.full((10, 1, 1), 2.5))
    monkeypatch.setattr(model_comparison.estimate, "sums_at", lambda evidence, vehicle, some: sums)
    mass = next(one for one in catalogue.catalogue(VEHICLE) if one.key == "mass")
    evidence = SimpleNamespace(
        null_distribution=SimpleNamespace(slices={"mass": slice(0, 1)}, bias_gradient=np.array([1.0]))
    )
    values = {"mass": file_values(mass, VEHICLE) + size * sensitivity.parameter_steps((mass,))}
    assert model_comparison._made(evidence, VEHICLE, [mass], values) == pytest.approx((made, 4.0))


@pytest.mark.parametrize(
    ("quantity", "part", "name", "kind"),
    [
        ("specific_force", "y", "|v| v_y", "|v| v_*"),
        ("angular_acceleration", "x", "modelled turn x", "modelled turn *"),
        ("specific_force", "z", "v_xy^2", "v_xy^2"),
        ("specific_force", "x", "v_y", "v_y"),
        ("rotor_speed", "1", "Omega", "Omega"),
        ("angular_acceleration", "z", "omega_x omega_z", "omega_x omega_*"),
    ],
)
def test_a_quantity_along_each_channels_own_axis_is_one(quantity, part, name, kind):
    channel = Channel("force", quantity, part, f"{quantity} {part}", "m/s^2")
    term = equation_search.EquationTerm(channel, name, "", 1.0, 0.1, "", 0.0, 1.0, 90.0, 90.0)
    assert equation_search.axis_free_name(term) == kind
