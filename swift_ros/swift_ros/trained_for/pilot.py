"""Track and vehicle that a pilot's network was trained for."""

import json
from pathlib import Path

import numpy as np

from swift_ros import configuration
from swift_ros.track import Track
from swift_ros.trained_for.comparison import Part, angles_deg, difference, far, warnings
from swift_ros.vehicle import Vehicle

# Differences that a pilot flies with: its training draws errors of the estimate of 0.1 m and starts within 0.1 m.
GATE_M, GATE_DEG, SIDE_M = 0.1, 5.0, 0.05
PODIUM_M, PODIUM_DEG = 0.2, 10.0
# Relative spreads of the vehicle: those of the training (`swift_sim_bridge.pilot.randomization`), and 10 % elsewhere.
MASS, THRUST, DRAG, OTHER = 0.02, 0.05, 0.3, 0.1
# Terms of a vehicle file that change what is measured, not how it flies. No training of a pilot simulates them.
INSTRUMENTS = frozenset(
    {
        "gyro_bias",
        "gyro_scale",
        "gyro_misalignment",
        "gyro_g_sensitivity",
        "accel_bias",
        "accel_scale",
        "accel_misalignment",
        "imu_lever_arm",
        "imu_vibration",
        "imu_clipping",
        "imu_bandwidth",
        "marker_offset",
        "frame_misalignment",
        "map_tilt",
        "time_offset",
        "clock_drift",
        "vio_scale",
        "vio_drift",
        "vio_blur",
        "vio_latency",
        "camera_extrinsic",
        "camera_focal",
        "rolling_shutter",
        "corner_noise",
        "camera_exposure",
        "processing_latency",
        "gate_displaced",
        "map_scale",
    }
)


def of_pilot(track: Track, vehicle: Vehicle) -> dict:
    """Return `trained_for` of a pilot's network."""
    return {"track": configuration.content(track), "vehicle": configuration.content(vehicle)}


def pilot_warnings(model: Path, track: Track, vehicle: Vehicle) -> list[str]:
    """Return a sentence for each of track and vehicle that a pilot's network was not trained for."""
    train = "train one with `swiftros train policy"
    parts = (
        Part("track", Track, track, _track_differences, "another track", f"{train} --track FILE`"),
        Part("vehicle", Vehicle, vehicle, _vehicle_differences, "another vehicle", f"{train} --vehicle FILE`"),
        Part("vehicle", Vehicle, vehicle, _instrument_differences, "other instruments", "no training simulates them"),
    )
    return warnings(model, "pilot", parts)


def _track_differences(trained: Track, track: Track) -> list[str]:
    if len(trained.gates) != len(track.gates):
        return [f"it had {len(trained.gates)} gates, not {len(track.gates)}"]
    away = np.linalg.norm(track.positions - trained.positions, axis=1)
    turned = angles_deg(trained.attitudes, track.attitudes)
    order = np.argsort(-away, kind="stable")
    found = [f"gate {i + 1} is {away[i]:.1f} m away from where it was" for i in order if away[i] > GATE_M]
    found += [f"gate {i + 1} is turned by {turned[i]:.0f} degrees" for i in order if turned[i] > GATE_DEG]
    for i, (before, now) in enumerate(zip(trained.inner_sides, track.inner_sides, strict=True), start=1):
        if abs(now - before) > SIDE_M:
            found.append(f"the opening of gate {i} is {now:.2f} m wide, it was {before:.2f} m")
    (p_before, q_before), (p_now, q_now) = trained.start_pose, track.start_pose
    podium_m = float(np.linalg.norm(p_now - p_before))
    if podium_m > PODIUM_M:
        found.append(f"the podium is {podium_m:.1f} m away from where it was")
    podium_deg = float(angles_deg(q_before, q_now))
    if podium_deg > PODIUM_DEG:
        found.append(f"the heading on the podium is turned by {podium_deg:.0f} degrees")
    low, high = (np.array(getattr(track, name)) - getattr(trained, name) for name in ("bounds_min", "bounds_max"))
    if max(low.max(), -high.min()) > GATE_M:
        found.append("the flight volume is smaller")
    return found


def _vehicle_differences(trained: Vehicle, vehicle: Vehicle) -> list[str]:
    def inertia(one):
        return np.linalg.eigvalsh(one.inertia_matrix)

    def rotors(one):
        return np.array([(*rotor.position, rotor.spin) for rotor in one.rotors])

    rows = (
        ("mass", trained.mass, vehicle.mass, MASS, "kg"),
        ("the largest thrust", trained.max_thrust, vehicle.max_thrust, THRUST, "N"),
        ("inertia", inertia(trained), inertia(vehicle), OTHER, "kg m^2"),
        ("rotors", rotors(trained), rotors(vehicle), OTHER, ""),
        ("motor.time_constant_up", trained.motor.time_constant_up, vehicle.motor.time_constant_up, OTHER, "s"),
        ("motor.time_constant_down", trained.motor.time_constant_down, vehicle.motor.time_constant_down, OTHER, "s"),
        ("rates.max", trained.rates.max, vehicle.rates.max, 0.0, "rad/s"),
        ("hull_radius", trained.hull_radius, vehicle.hull_radius, OTHER, "m"),
    )
    found = [difference(name, before, now, unit) for name, before, now, share, unit in rows if far(before, now, share)]
    found += _term_differences(trained, vehicle, {*trained.terms, *vehicle.terms} - INSTRUMENTS)
    keys = sorted({*trained.controller, *vehicle.controller})
    differing = [key for key in keys if _plain(trained.controller.get(key)) != _plain(vehicle.controller.get(key))]
    return found + [f"'controller.{key}' has another value" for key in differing]


def _instrument_differences(trained: Vehicle, vehicle: Vehicle) -> list[str]:
    return _term_differences(trained, vehicle, {*trained.terms, *vehicle.terms} & INSTRUMENTS)


def _term_differences(trained: Vehicle, vehicle: Vehicle, names: set[str]) -> list[str]:
    found = []
    for name in sorted(names):
        before, now = trained.terms.get(name), vehicle.terms.get(name)
        if before is None or now is None:
            found.append(f"its file has {'no' if now is None else 'the new'} term '{name}'")
        else:
            found += _value_differences(f"terms.{name}", before, now)
    return found


def _value_differences(name: str, before, now) -> list[str]:
    """Return the coefficients of a term that differ by more than the spread of the training."""
    if isinstance(before, dict) and isinstance(now, dict) and set(before) == set(now):
        return [one for key in before for one in _value_differences(f"{name}.{key}", before[key], now[key])]
    try:
        return [difference(name, before, now, "")] if far(before, now, DRAG) else []
    except (TypeError, ValueError):
        return [f"'{name}' has another value"] if _plain(before) != _plain(now) else []


def _plain(value):
    return json.dumps(value, sort_keys=True, default=str)
