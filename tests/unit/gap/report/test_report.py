"""The report in the terminal and as a page: the missing effects, where they are visible, and the errors."""

import numpy as np
import pytest
from report_example import FINDING, PARAMETERS, REPORT

from swift_sim_bridge.gap.report import figures, sentences
from swift_sim_bridge.gap.report.html import html_page
from swift_sim_bridge.gap.report.terminal import terminal_text
from swift_sim_bridge.gap.residuals.channels import Channel
from swift_sim_bridge.gap.residuals.rollout import Trajectories
from swift_sim_bridge.gap.validation.holdout import MODELS, HoldoutResult
from swift_sim_bridge.gap.validation.mismatch import Mismatch

T = np.arange(0.0, 20.0, 0.02)
CHANNELS = (
    Channel("motor", "rotor_speed", "1", "rotor 1 speed", "rad/s"),
    Channel("motor", "voltage", "", "voltage", "V"),
    Channel("force", "specific_force", "x", "specific force x", "m/s^2"),
    Channel("imu", "gyro", "x", "gyro vs pose, x", "rad/s"),
)
NOISE = np.array([5.0, 0.02, 0.3, 0.02])
TIMES = 12.0  # the noise, by which the force is off in the middle of the flight
ROLLOUT = {"before": 0.21, "after": 0.01, "knn": 0.08, "gp": 0.07}


def mismatch(repaired: bool = True, p_world: bool = True) -> Mismatch:
    """A flight round a circle whose force is off from 8 s to 12 s, and whose motion capture paused at 3 s."""
    rng = np.random.default_rng(4)
    after, before = (NOISE * rng.standard_normal((len(T), len(CHANNELS))) for _ in range(2))
    before[(T > 8.0) & (T < 12.0), 2] += TIMES * NOISE[2]
    for residual in (before, after):
        residual[(T > 3.0) & (T < 3.4)] = np.nan
    path = np.stack([np.cos(T), np.sin(T), 1.0 + 0.0 * T], axis=1) if p_world else None
    return Mismatch("flight.csv", T, path, CHANNELS, NOISE, before, after if repaired else None)


def holdout() -> HoldoutResult:
    """Eight rollouts straight ahead, each model off by its share."""
    steps = np.linspace(0.0, 1.0, 11)[:, None, None] * np.ones((8, 3)) + np.arange(8)[:, None]
    flown = np.stack([steps * (1.0 + ROLLOUT[name]) for name in MODELS])
    return HoldoutResult(REPORT["improvement"]["held_out"], (Trajectories(np.stack([steps] * len(MODELS)), flown),))


def test_the_mismatch_is_located_in_layer_and_time_in_multiples_of_the_noise():
    one = mismatch()
    layers = one.layers(one.before)
    assert list(layers) == ["motor", "battery", "force", "imu"]
    wrong = (T > 8.5) & (T < 11.5)
    assert np.nanmean(layers["force"][wrong]) == pytest.approx(TIMES, rel=0.05)
    assert np.nanmean(layers["force"][~wrong & (T < 7.5)]) == pytest.approx(1.0, abs=0.1)
    assert np.nanmax(layers["motor"]) < 2.5 and np.nanmax(one.worst(one.after)) < 2.5
    assert np.isnan(one.worst(one.before)[(T > 3.05) & (T < 3.35)]).all()


def test_the_page_describes_the_missing_effect_and_shows_every_picture(tmp_path):
    pictures = figures.draw((mismatch(),), holdout(), tmp_path)
    assert list(pictures) == ["track.png", "time.png", "curves.png", "rollouts.png"]
    assert all((tmp_path / name).stat().st_size > 10_000 for name in pictures)
    html = html_page(REPORT, "drone.yaml", ["flight.csv: 20.0 s"], pictures, PARAMETERS)
    texts = (
        "rotor drag",
        "The rotors drag.",
        "cannot distinguish it from: damaged propeller 2 (30%).",
        "one speed at two thrusts",
        "0.01 m",
        "0.21 m",
        "There, the error of voltage changes from 0.31 V to 0.02 V.",
        "<th>repaired</th>",
        "<td>rotor 1 speed [rad/s]</td><td>40</td><td>39</td>",
        "6e-05 N/(rad/s m/s)",
        "drone.yaml",
        "flight.csv, 3.00 s to 3.50 s, gyro: stood still",
        "mass: 0.004 kg<",
        "finds mass (tentative)",
        "nothing &lt;to&gt; blow at",
        *pictures,
    )
    assert not [text for text in texts if text not in html]
    assert "error of rotor 1 speed" not in html  # it hardly changes


def test_an_error_that_the_repair_does_not_change_is_no_improvement():
    unchanged = {**REPORT["improvement"]["held_out"], "one_step_rmse": {"before": 0.151, "after": 0.150}}
    unchanged["rollout_rmse_m"] = {"0.5": {"before": 0.0061, "after": 0.0061, "knn": 0.01, "gp": 0.01}}
    (sentence,) = sentences.improvements(REPORT | {"improvement": {"held_out": unchanged, "left": {}}})
    assert sentence == (
        "On parts of the flights that no fit has used, the error of voltage changes from 0.31 V to 0.02 V."
    )


def test_several_flights_without_findings_are_drawn_also_if_one_has_no_pose(tmp_path):
    pictures = figures.draw(
        (mismatch(repaired=False), mismatch(repaired=False, p_world=False)), HoldoutResult(), tmp_path
    )
    assert list(pictures) == ["track_1.png", "time_1.png", "curves_1.png", "time_2.png", "curves_2.png"]


@pytest.mark.parametrize(
    "time, regime, expected",
    [
        ([[0.0, 20.0]], "", "throughout"),
        ([[0.0, 20.0]], "most where the speed is above 8 m/s", "most where the speed is above 8 m/s"),
        ([[12.0, 13.0]], "", "at 12.0 to 13.0 s"),
        ([[0.0, 20.0], [4.0, 5.0], [12.0, 13.0]], "", "at 4.0 to 5.0 s, 12.0 to 13.0 s"),
    ],
)
def test_the_report_states_when_a_finding_is_visible(time, regime, expected):
    finding = FINDING | {"where": {"time": time, "segments": [], "regime": regime}}
    report = REPORT | {"findings": [finding], "flights": [[0.0, 20.0], [0.0, 30.0]]}
    assert f"  where: {expected}\n" in terminal_text(report)
    assert f"Visible {expected}." in html_page(report, "drone.yaml", [], {}, PARAMETERS)


def test_the_headline_names_confirmed_and_probable_effects():
    confirmed = FINDING | {"verdict": "confirmed", "effect": "mass"}
    headline = sentences.headline(REPORT | {"findings": [FINDING, confirmed]})
    assert headline == (
        "The simulation lacks an effect, and several effects could explain it. Confirmed: mass. "
        "Probable: either rotor drag or damaged propeller 2."
    )
    tentative = {**FINDING, "verdict": "tentative", "alternatives": []}
    findings = [tentative, tentative | {"effect": "accel_bias"}]
    assert sentences.headline({"verdict": "tentative", "findings": findings}) == (
        "The simulation lacks an effect, which is identified with low confidence. Probable: rotor drag and accel bias."
    )


def test_an_equation_is_printed_with_its_terms_and_their_units():
    terms = {
        "voltage: 1": {"value": 0.5, "unit": "V", "interval95": [0.4, 0.6], "channel": "voltage", "quantity": "1"},
        "specific_force_x: |v| v_x": {
            "value": -0.01,
            "unit": "1/m",
            "interval95": [-0.02, -0.005],
            "channel": "specific_force_x",
            "quantity": "|v| v_x",
        },
    }
    equation = FINDING | {"verdict": "unknown", "effect": None, "parameters": terms, "alternatives": []}
    lines = terminal_text(REPORT | {"verdict": "unknown", "findings": [equation]}).splitlines()
    assert "  voltage: 0.5 V (0.4 .. 0.6)" in lines
    assert "  specific force x: -0.01 1/m (-0.02 .. -0.005) times |v| v_x" in lines


def test_a_change_beyond_the_physical_range_is_not_listed_as_detectable():
    found = {"ground_effect": {"k": 3767.0}, "mass": {"mass": 0.004}}
    html = html_page(REPORT | {"minimum_detectable": found}, "drone.yaml", [], {}, PARAMETERS)
    assert "k: no physical change" in html and "mass: 0.004 kg" in html
