"""What no effect and no product of quantities explains: it is unknown, in its layer, and names there are not certain.

The logs come from a second, plain implementation of motors and battery.
"""

from dataclasses import replace
from functools import cache

import jax
import numpy as np
import pytest
from motor_log import VEHICLE, T, log, resonance, worn_plug

from swift_ros.recording.flight_table import Samples
from swift_sim_bridge.gap import api
from swift_sim_bridge.gap.attribution.unexplained import curve_gain
from swift_sim_bridge.gap.inference.sensitivity import linearise, perturbed_variants
from swift_sim_bridge.gap.pipeline import references
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.report.html_findings import findings
from swift_sim_bridge.gap.report.terminal import terminal_text
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.validation import localization

ROTORS = {f"rotor_speed_{i}" for i in (1, 2, 3, 4)}


def diagnosis_of(table, vehicle=VEHICLE):
    """Return the diagnosis of a log, with few reference flights."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(references, "REFERENCE_FLIGHTS", 12)
        return api.diagnose([table], vehicle, lambda text: None, validate=False)


@cache
def shaken():
    """Return the diagnosis of rotors that lack speed where their arms resonate."""
    return diagnosis_of(log(3, lost=resonance))


def verdicts(report: dict) -> dict:
    return {one["effect"]: one["verdict"] for one in report["findings"]}


def test_a_resonance_is_unknown_and_the_motor_map_that_imitates_it_is_not_confirmed():
    report = shaken().report
    assert report["verdict"] == "unknown" and verdicts(report) == {"motor_map": "tentative", None: "unknown"}
    (left,) = (one for one in report["findings"] if "unexplained" in one)
    assert left["layer"] == "motor" and set(left["channels"]) <= ROTORS
    assert all(0.1 < share < 0.5 for share in left["unexplained"].values())
    assert "what is left follows curves over Omega." in left["sentence"]


def test_a_bent_throttle_curve_is_a_confirmed_motor_map():
    motor = VEHICLE.motor
    bent = [c * (0.97 if i == 4 else 1.0) for i, c in enumerate(motor.map.coefficients)]
    file = replace(VEHICLE, motor=replace(motor, map=replace(motor.map, coefficients=tuple(bent))))
    assert verdicts(diagnosis_of(log(8), file).report) == {"motor_map": "confirmed"}


def test_a_supply_that_drops_with_the_current_is_no_confirmed_motor_map():
    report = diagnosis_of(log(6, lost=lambda speed, current: 1.5 * current)).report
    assert report["verdict"] == "unknown" and verdicts(report).get("motor_map", "tentative") == "tentative"
    (equation,) = (one for one in report["findings"] if one["effect"] is None)
    assert "current" in {entry["quantity"] for entry in equation["parameters"].values()}


def test_a_plug_that_opens_at_random_is_unknown_although_no_quantity_describes_it():
    report = diagnosis_of(log(4, resistance=worn_plug(4))).report
    (left,) = report["findings"]
    assert (report["verdict"], left["layer"], left["channels"]) == ("unknown", "motor", ["voltage"])
    assert left["unexplained"]["voltage"] > 0.5 and not left["equation"]
    assert "follows no quantity of the recording." in left["sentence"]


@pytest.mark.parametrize(("depth", "expected"), [(0.0, {"battery_sag": "confirmed"}), (4e-4, {None: "unknown"})])
def test_a_resistance_that_changes_slowly_by_half_a_percent_is_unknown_and_a_constant_one_is_confirmed(depth, expected):
    """What it leaves is less than two thousandths of the squares that the battery sag removes."""
    changing = 0.07 + depth * np.sin(2.0 * np.pi * T / 3.0)
    found = verdicts(diagnosis_of(log(4, resistance=changing, noise_v=0.005)).report)
    assert {"battery_sag": "tentative"} | expected == found


def test_a_plug_that_opens_with_the_current_is_no_confirmed_battery_sag():
    """The fitted resistance gives the measured voltage only from a pack fuller than full."""
    current = log(4)["current"].values
    report = diagnosis_of(log(4, resistance=0.012 + 6e-5 * current**2)).report
    assert verdicts(report)["battery_sag"] == "tentative"


def test_terminal_and_page_say_what_is_left_and_when():
    found = shaken()
    report = localization.locate_findings(found, VEHICLE)
    (left,) = (one for one in report["findings"] if "unexplained" in one)
    assert set(left["channels"]) <= ROTORS and "removes" not in left and left["where"]["time"]
    for text in (terminal_text(report), findings(report)):
        assert "Neither an effect of the catalogue nor an equation explains" in text
        assert left["in_repair"] and "describes a part of it by an equation: rotor speed" in text
    assert "This equation describes it" not in findings(report)


def test_what_the_pack_gave_before_the_first_row_changes_no_residual():
    table = log(1)
    transient = 0.1 * np.exp(-T / VEHICLE.battery.rc_time)
    loaded = Samples(T, table["voltage"].values + transient)
    voltages = []
    with jax.enable_x64(True):
        for one in (table, replace(table, channels={**table.channels, "voltage": loaded})):
            residual_model = ResidualModel(read_recording(one, VEHICLE))
            line = linearise(residual_model, perturbed_variants(VEHICLE, ()))
            voltages.append(line.residual[:, residual_model.columns["pack"].start])
    assert np.abs(voltages[1] - voltages[0]).max() < 0.01 * transient.max()


def test_a_curve_explains_a_function_of_its_quantity_and_hardly_anything_of_noise():
    rng = np.random.default_rng(2)
    quantity, noise = rng.uniform(-1.0, 1.0, 2000), rng.standard_normal(2000)
    assert curve_gain(quantity, noise) < 30.0
    assert curve_gain(quantity, noise + np.cos(9.0 * quantity)) == pytest.approx(0.5 * 2000, rel=0.25)
