"""The catalogue of effects: complete, in a fixed order, and consistent with the terms that it describes."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from swift_ros import configuration
from swift_ros.configuration import build
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import known_terms, refuse_unknown_terms
from swift_sim_bridge.gap.effects.catalogue import all_effects, catalogue, draught, gusts, not_identified, payload
from swift_sim_bridge.gap.effects.injection import file_values, idle_terms, inject
from swift_sim_bridge.gap.recording.channel_names import NAMES_WITH_COLUMNS
from swift_sim_bridge.physics.state import parameters_from_vehicle
from swift_sim_bridge.physics.terms.registry import PHYSICS
from swift_sim_bridge.sensors.terms import sensor_terms

CONFIG = Path(__file__).resolve().parents[4] / "config"
FILES = [CONFIG / "drone.yaml", *sorted((CONFIG / "vehicles").glob("*.yaml"))]
COLUMNS = " ".join(
    (
        "mass inertia com_offset thrust_axis_tilt thrust_coefficient torque_coefficient motor_time_constant",
        "motor_asymmetry motor_map rotor_gain damaged_propeller[1] damaged_propeller[2] damaged_propeller[3]",
        "damaged_propeller[4] battery_sag axial_inflow translational_lift rotor_gyroscopic rotor_drag",
        "linear_drag body_drag lift_cross flapping_moment ground_effect vortex_ring drag_center wind",
        "gyro_bias gyro_scale imu_lever_arm marker_offset accel_bias accel_scale time_offset clock_drift",
        "frame_misalignment map_tilt vio_scale vio_drift command_latency command_jitter dropped_commands",
        "rate_scale throttle_curve rate_loop_p rate_loop_i rate_loop_d camera_extrinsic camera_focal",
        "rolling_shutter processing_latency gate_displaced[1] gate_displaced[2] map_scale",
    )
).split()
SEPARATE = ["payload", "gust", "local_draught"]  # effects with a search of their own
LATER = ["propeller_stall"]  # effects that joined after the order was fixed: they come last


def shipped(path: Path = FILES[0]) -> Vehicle:
    return configuration.load(Vehicle, path)


def keys(effects) -> list[str]:
    return [effect.key for effect in effects]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_order_of_the_catalogue_is_fixed(path):
    vehicle = shipped(path)
    found = keys(catalogue(vehicle, gates=2))
    assert found == [key for key in [*COLUMNS, *LATER] if key in found]
    missing = {key for key in COLUMNS if key not in found}
    gains = {"rate_loop_p", "rate_loop_i", "rate_loop_d"}
    assert missing <= {"drag_center", "wind", *gains}
    assert bool(missing & gains) == ("pid" not in vehicle.controller)
    assert keys(all_effects(vehicle, gates=2)) == [
        key for key in [*COLUMNS, *SEPARATE, *LATER] if key not in missing & gains
    ]


def test_the_shipped_vehicle_has_every_effect():
    assert keys(catalogue(shipped(), gates=2)) == [*COLUMNS, *LATER]


def test_without_a_map_there_are_no_effects_of_the_map():
    assert keys(catalogue(shipped())) == [*COLUMNS[:-3], *LATER]


def test_wind_and_drag_centre_need_a_drag_in_the_vehicle_file():
    bare = keys(catalogue(replace(shipped(), terms={})))
    inflow = keys(catalogue(replace(shipped(), terms={"axial_inflow": {"k_z": 0.0}})))
    assert not {"drag_center", "wind"} & set(bare)
    assert "wind" in inflow and "drag_center" not in inflow


def test_every_effect_starts_between_its_bounds_and_changes_only_its_parameters():
    vehicle = shipped()
    for effect in (*all_effects(vehicle, gates=2), payload((0.0, 0.01, 0.0)), gusts(), draught((1.0, 2.0, 3.0), 2.0)):
        start = file_values(effect, vehicle)
        low, high, step = (np.array([getattr(p, name) for p in effect.parameters]) for name in ("low", "high", "step"))
        assert np.all(low <= start) and np.all(start <= high) and np.all(step > 0), effect.key
        changed = inject(vehicle, effect, start + step)
        assert file_values(effect, changed) == pytest.approx(start + step), effect.key
        assert effect.sentence and effect.equation and effect.manoeuvre
        assert effect.channels and set(effect.channels) <= set(NAMES_WITH_COLUMNS), effect.key


@pytest.mark.parametrize("name", known_terms())
def test_a_term_has_a_valid_example_and_idle_entry_and_the_unit_of_each_coefficient(name):
    term, vehicle = known_terms()[name], shipped()
    for entry in (term.idle, term.example):
        vehicle_with_term = replace(vehicle, terms={**vehicle.terms, name: entry})
        parameters_from_vehicle(vehicle_with_term)
        sensor_terms(vehicle_with_term)
    names = [one.name for one in fields(term.coefficients)]
    assert set(term.idle) <= set(names)
    if name not in ("gate_displaced", "gust", "equation"):  # mappings; scale of a standard profile
        assert set(term.example) == set(names)
        assert all(np.all(np.asarray(value, dtype=float) != 0) for value in term.example.values())
    for coefficient in names if name not in ("gate_displaced", "equation") else ():
        count = np.size(getattr(build(term.coefficients, term.example, name), coefficient))
        assert isinstance(term.unit(name, coefficient, vehicle, (count - 1,)), str)


def test_every_term_is_identified_or_known_not_to_be_or_has_no_effect():
    effects = {parameter.path[1] for e in all_effects(shipped(), 1) for parameter in e.parameters if e.idle}
    without = {
        "aerodynamic_polynomial",
        "equation",
        "motor_heat",
        "gyro_misalignment",
        "gyro_g_sensitivity",
        "accel_misalignment",
        "imu_vibration",
        "imu_clipping",
        "imu_bandwidth",
        "vio_blur",
        "vio_latency",
    }
    assert effects | set(not_identified()) - {"motor_saturation"} | without == set(known_terms())
    assert set(PHYSICS) < set(known_terms())


def test_idle_terms_of_all_effects_make_one_valid_vehicle():
    vehicle = shipped()
    idle = idle_terms(catalogue(vehicle))
    refuse_unknown_terms(replace(vehicle, terms=idle))
    parameters = parameters_from_vehicle(replace(vehicle, terms=idle))
    assert set(parameters.terms) == set(idle) & set(PHYSICS)
