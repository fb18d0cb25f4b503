"""What a report says beside its findings: values before, shifts that rows alone can make, and what to do next."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from report_example import FINDING, REPORT

from swift_ros.configuration import configuration_folder, load
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.effects.catalogue import catalogue
from swift_sim_bridge.gap.report import changes, next_steps

VEHICLE = load(Vehicle, configuration_folder() / "drone.yaml")
EFFECTS = {effect.key: effect for effect in catalogue(VEHICLE)}
INPUTS = next_steps.Inputs(Path("drone.yaml"), [Path("flight.csv")], Path("runs/gap"))


class Recorded:
    """A recording with some channels, as the steps need it."""

    rotor_speed_modelled = skips_commands = False
    driven, stand_ins = None, frozenset()
    v_world = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 6.4]])
    motor_record = SimpleNamespace(command=np.array([[0.2, 0.69]]))

    def __init__(self, *missing: str):
        self.missing = missing

    def has(self, channel: str) -> bool:
        return channel not in self.missing


def diagnosis(*keys: str, missing: tuple[str, ...] = ()):
    """A diagnosis that selected these effects in a recording without the missing channels."""
    model = SimpleNamespace(recording=Recorded(*missing))
    selected = [SimpleNamespace(effect=EFFECTS[key]) for key in keys]
    return SimpleNamespace(selected=selected, own_effects=(), evidence=SimpleNamespace(residual_models=(model,)))


def found(key: str, *values: float, verdict: str = "confirmed") -> dict:
    """A finding of an effect with these values."""
    effect = EFFECTS[key]
    parameters = {
        one.name: {"value": value, "unit": one.unit, "interval95": [value, value]}
        for one, value in zip(effect.parameters, values, strict=True)
    }
    named = {"effect": effect.id, "variant": effect.variant, "parameters": parameters, "verdict": verdict}
    return FINDING | named | {"alternatives": [], "separating_manoeuvre": None}


def table(rate_hz: float) -> FlightTable:
    t = np.arange(0.0, 10.0, 1.0 / rate_hz)
    channels = ("p_world", "q_world_body", "gyro_body", "specific_force_body")
    return FlightTable("flight.csv", {name: Samples(t, np.zeros((len(t), 4))) for name in channels})


def completed(finding: dict, key: str, rate_hz: float = 100.0) -> dict:
    report = changes.with_changes(REPORT | {"findings": [finding]}, diagnosis(key), VEHICLE, [table(rate_hz)])
    (one,) = report["findings"]
    assert report["recordings"][0]["rows_per_second"]["gyro_body"] == pytest.approx(rate_hz)
    return one


def test_a_value_before_is_that_of_the_file_and_absent_where_the_file_lacks_the_term():
    mass = completed(found("mass", 0.93), "mass")["parameters"]["mass"]
    assert (mass["was"], mass["key"]) == (VEHICLE.mass, "mass")
    drag = completed(found("linear_drag", 0.1, 0.2, 0.3), "linear_drag")["parameters"]
    assert (drag["c[1]"]["was"], drag["c[1]"]["key"]) == (None, "terms.linear_drag.c[1]")


@pytest.mark.parametrize(
    "rate_hz, delay_s, is_short", [(100.0, 0.0012, True), (100.0, -0.02, False), (1000.0, 0.0012, False)]
)
def test_a_shift_below_one_row_is_marked_with_the_rate_that_would_show_it(rate_hz, delay_s, is_short):
    caution = completed(found("time_offset", delay_s), "time_offset", rate_hz)["caution"]
    assert bool(caution) == is_short
    if is_short:
        assert "1.2 ms is shorter than a row of the recording (10 ms)" in caution and "830 rows a second" in caution


def steps(findings: list[dict], *keys: str, missing: tuple[str, ...] = ()) -> list[dict]:
    return next_steps.next_steps(REPORT | {"findings": findings}, diagnosis(*keys, missing=missing), VEHICLE, INPUTS)


def test_a_confirmed_change_is_flown_at_once_and_a_tentative_one_is_tested_before():
    sure, *_ = steps([found("mass", 0.93)], "mass")
    assert sure["kind"] == "use" and sure["commands"][0] == "swiftros race --vehicle runs/gap/vehicle.yaml"
    unsure, *_ = steps([found("mass", 0.93, verdict="tentative")], "mass")
    assert unsure["commands"][0].startswith("swiftros gap ANOTHER_FLIGHT --vehicle runs/gap/vehicle.yaml")
    assert unsure["text"].endswith(
        "It was found at speeds up to 6 m/s and motor commands up to 0.69: beyond, it extrapolates."
    )
    assert "beyond" not in sure["text"]


def test_the_vehicle_is_checked_and_the_manoeuvre_is_that_of_the_effect():
    finding = found("damaged_propeller[2]", 0.1, verdict="tentative")
    texts = {step["kind"]: step for step in steps([finding], "damaged_propeller[2]")}
    assert texts["check"]["text"].startswith("Replace the propeller of rotor 2")
    assert EFFECTS["damaged_propeller[2]"].manoeuvre in texts["fly"]["text"]
    assert texts["fly"]["commands"] == ["swiftros gap flight.csv NEW_FLIGHT --vehicle drone.yaml"]


def test_the_channel_to_record_first_is_the_one_that_makes_most_testable():
    missing = ("voltage", "single_rotor_speeds", "gate_observations")
    texts = [step["text"] for step in steps([], missing=missing) if step["kind"] == "record"]
    assert "each rotor's own speed" in texts[0] and "com offset" in texts[0]
    assert "the pack's voltage" in texts[1] and not any("images" in text for text in texts)


def test_without_findings_the_file_is_kept():
    first, *rest = steps([])
    assert first["text"] == "Keep drone.yaml: no value in it changes." and not rest


def test_an_equation_without_a_name_is_a_repaired_file_to_be_tested():
    unnamed = {"effect": None, "variant": "", "verdict": "unknown", "in_repair": True}
    first, *_ = steps([FINDING | unnamed | {"parameters": {}, "alternatives": []}])
    assert first["text"].startswith("Simulate with the repaired vehicle file") and len(first["commands"]) == 3
