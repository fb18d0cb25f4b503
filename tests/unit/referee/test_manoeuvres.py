"""The proposed manoeuvres: the referee, which shares no code with the tool, flies the same figures."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from swift_sim_bridge.gap.attribution.evidence import SelectedEffect
from swift_sim_bridge.gap.effects import catalogue
from swift_sim_bridge.gap.report import content
from swift_sim_bridge.gap.validation import experiment_design as proposals
from swift_sim_bridge.referee.simulator import flight, manoeuvres, vehicles
from swift_sim_bridge.referee.simulator.instruments import LEAD_S
from swift_sim_bridge.referee.simulator.paths import TICK_S


def test_tool_and_referee_fly_the_same_figure_for_each_manoeuvre():
    t = np.arange(0.0, proposals.SIMULATED_S, TICK_S)
    figures = proposals.figures(t)
    assert set(figures) == set(manoeuvres.FIGURES)
    for name, (p, yaw, shake) in figures.items():
        path, recorded = manoeuvres.path(name, proposals.SIMULATED_S), slice(round(LEAD_S / TICK_S), None)
        np.testing.assert_allclose(path.p[recorded], p, atol=1e-9, err_msg=name)
        np.testing.assert_allclose(path.yaw[recorded], yaw, atol=1e-9, err_msg=name)
        rates = np.gradient(shake, TICK_S, axis=0)  # of small turns
        np.testing.assert_allclose(path.shake[recorded][1:-1], rates[1:-1], atol=0.1, err_msg=name)
        np.testing.assert_allclose(path.v[0], 0.0, atol=0.01, err_msg=name)


@pytest.mark.parametrize("name", manoeuvres.FIGURES)
def test_a_finding_of_the_report_has_id_and_duration_of_the_manoeuvre(name):
    effect = replace(catalogue.gusts(), layer="force")
    ambiguous = SelectedEffect(
        effect, np.array([3.0]), np.eye(1), 9.0, {effect.key: 0.5, "wind": 0.5}, {effect.key: np.array([3.0])}
    )
    evidence = SimpleNamespace(residual_models=[SimpleNamespace(channels=(), t=np.arange(9.0))], seconds=8)
    proposed = proposals.SeparatingManoeuvre(proposals.Manoeuvre(name, 15.0), 7.2)
    for manoeuvre, expected in ((proposed, (name, 15.0)), (None, None)):
        finding = content.finding(ambiguous, evidence, {effect.key: manoeuvre})
        assert manoeuvres.proposed_manoeuvre({"findings": [{"verdict": "confirmed"}, finding]}) == expected


@pytest.fixture(scope="module")
def flown():
    content = vehicles.draw_vehicle(np.random.default_rng(5), "test")
    paths = {name: manoeuvres.path(name, 10.0) for name in manoeuvres.FIGURES}
    with jax.enable_x64(True):
        truths = flight.fly([flight.Order(content, content, path, 1, 0.02, 0.5) for path in paths.values()])
    return {name: (path, truth) for (name, path), truth in zip(paths.items(), truths, strict=True)}


@pytest.mark.parametrize("name", manoeuvres.FIGURES)
def test_the_referee_s_pilot_stays_near_the_path_and_above_the_ground(flown, name):
    path, truth = flown[name]
    ticks = slice(round(LEAD_S / TICK_S), None)
    there = truth.p[:: len(truth.p) // len(path.p)][ticks]
    away = np.linalg.norm(there - path.p[ticks], axis=1)
    assert away.max() < 2.0  # torque has priority over thrust: doublets in a punch lift the vehicle
    assert there[:, 2].min() > 0.05
