"""The page of a gap report: it says what was left out, and shows where, when and how much, before and after."""

import numpy as np
import pytest
from report_example import FINDING, PARAMETERS, REPORT

from swift_sim_bridge.gap.report import figures
from swift_sim_bridge.gap.report import html as page
from swift_sim_bridge.gap.residuals.channels import Channel
from swift_sim_bridge.gap.residuals.rollout import Trajectories
from swift_sim_bridge.gap.validation.holdout import MODELS, HoldoutResult
from swift_sim_bridge.gap.validation.mismatch import Mismatch

T = np.arange(0.0, 20.0, 0.02)
CHANNELS = (
    Channel("motor", "rotor_speed", "1", "rotor 1 speed", "rad/s"),
    Channel("motor", "voltage", "", "voltage", "V"),
    Channel("force", "specific_force", "x", "specific force x", "m/s^2"),
    Channel("imu", "gyro", "x", "pose's less gyro's rate x", "rad/s"),
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


def proof() -> HoldoutResult:
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


def test_the_page_says_what_was_left_out_and_shows_every_picture(tmp_path):
    pictures = figures.draw((mismatch(),), proof(), tmp_path)
    assert list(pictures) == ["track.png", "time.png", "curves.png", "rollouts.png"]
    assert all((tmp_path / name).stat().st_size > 10_000 for name in pictures)
    html = page.html(REPORT, "drone.yaml", ["flight.csv: 20.0 s"], pictures, PARAMETERS)
    said = (
        "rotor drag",
        "The rotors drag.",
        "cannot tell it from: damaged propeller 2 (30%).",
        "one speed at two thrusts",
        "0.01 m",
        "0.21 m",
        "There voltage is 0.02 V off instead of 0.31 V.",
        "<th>repaired</th>",
        "<td>rotor 1 speed [rad/s]</td><td>40</td><td>39</td>",
        "6e-05 N/(rad/s m/s)",
        "drone.yaml",
        "flight.csv, 3.00 s to 3.50 s, gyro: stood still",
        "mass: 0.004 kg<",
        "leaves out mass (tentative)",
        "nothing &lt;to&gt; blow at",
        *pictures,
    )
    assert not [text for text in said if text not in html]
    assert "rotor 1 speed is" not in html  # it is hardly better


def test_what_a_repair_leaves_as_it_was_is_no_improvement():
    tired = {**REPORT["improvement"]["held_out"], "one_step_rmse": {"before": 0.151, "after": 0.150}}
    tired["rollout_rmse_m"] = {"0.5": {"before": 0.0061, "after": 0.0061, "knn": 0.01, "gp": 0.01}}
    (said,) = page.improvements({"improvement": {"held_out": tired, "left": {}}})
    assert said == "On parts of the flights that no fit has seen, voltage is 0.02 V off instead of 0.31 V."


def test_what_there_is_is_drawn_of_several_flights_without_a_pose_and_without_findings(tmp_path):
    pictures = figures.draw(
        (mismatch(repaired=False), mismatch(repaired=False, p_world=False)), HoldoutResult(), tmp_path
    )
    assert list(pictures) == ["track_1.png", "time_1.png", "curves_1.png", "time_2.png", "curves_2.png"]


@pytest.mark.parametrize(
    "time, regime, told",
    [
        ([[0.0, 20.0]], "", "throughout"),
        ([[0.0, 20.0]], "most where the speed is above 8 m/s", "most where the speed is above 8 m/s"),
        ([[12.0, 13.0]], "", "at 12.0 to 13.0 s"),
        ([[0.0, 20.0], [4.0, 5.0], [12.0, 13.0]], "", "at 4.0 to 5.0 s, 12.0 to 13.0 s"),
    ],
)
def test_the_page_says_when_a_finding_shows_unless_it_always_does(time, regime, told):
    finding = FINDING | {"where": {"time": time, "segments": [], "regime": regime}}
    report = REPORT | {"findings": [finding], "flights": [[0.0, 20.0], [0.0, 30.0]]}
    assert f"  where: {told}\n" in page.text(report)
    assert f"Shows {told}." in page.html(report, "drone.yaml", [], {}, PARAMETERS)


def test_what_is_certain_is_named_also_beside_what_is_not():
    certain = FINDING | {"verdict": "confirmed", "effect": "mass"}
    told = page.headline(REPORT | {"findings": [FINDING, certain]})
    assert told == (
        "The simulation leaves something out that several effects could be. It certainly leaves out mass. "
        "Probably it leaves out either rotor drag or damaged propeller 2."
    )
    guess = {**FINDING, "verdict": "tentative", "alternatives": []}
    told = page.headline({"verdict": "tentative", "findings": [guess, guess | {"effect": "accel_bias"}]})
    assert told == (
        "The simulation leaves something out; what it is, is not certain yet. Probably it leaves out rotor "
        "drag and accel bias."
    )


def test_an_equation_is_printed_with_its_terms_and_their_units():
    terms = {
        "voltage: 1": {"value": 0.5, "unit": "V", "interval95": [0.4, 0.6]},
        "specific force x: |v| v_x": {"value": -0.01, "unit": "1/m", "interval95": [-0.02, -0.005]},
    }
    nameless = FINDING | {"verdict": "unknown", "effect": None, "parameters": terms, "alternatives": []}
    lines = page.text(REPORT | {"verdict": "unknown", "findings": [nameless]}).splitlines()
    assert "  voltage: 0.5 V (0.4 .. 0.6)" in lines
    assert "  specific force x: -0.01 1/m (-0.02 .. -0.005) times |v| v_x" in lines


def test_a_change_that_no_vehicle_could_have_is_not_offered_as_one_that_would_have_been_seen():
    found = {"ground_effect": {"k": 3767.0}, "mass": {"mass": 0.004}}
    html = page.html(REPORT | {"minimum_detectable": found}, "drone.yaml", [], {}, PARAMETERS)
    assert "k: none that could be" in html and "mass: 0.004 kg" in html
