"""What to do after a diagnosis: files to use, things to check on the vehicle, manoeuvres to fly, channels to record."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.effects.catalogue import MAP_EFFECTS, all_effects
from swift_sim_bridge.gap.recording.channel_names import missing_channels, names_with_columns, unmeasured
from swift_sim_bridge.gap.report.sentences import ranked

MAX_RECORDED = 3  # channels that are proposed, those first that make most effects testable
FINER = ("gyro_body", "specific_force_body", "rotor_speed")  # that pose and motor commands stand in for
IMAGES = "gate_observations"  # not proposed: a vehicle has a camera for gates, or has none
RACING = ("betaflight",)  # types of flight controllers that the simulator flies races with
MAX_NAMED = 6  # effects that a sentence names
MAX_CHECKED, MAX_FLOWN = 4, 3  # things to check on the vehicle, and manoeuvres; those that matter most
# What shows on the vehicle itself whether a finding is true, or removes it; {variant}: number of the rotor or gate
CHECKS = {
    "mass": "Weigh the vehicle as it flew, with its pack.",
    "payload": "Weigh what the vehicle carries, and measure where it hangs.",
    "com_offset": "Balance the vehicle on two edges along both axes; move the pack until it balances over its centre.",
    "inertia": "Measure the inertia with a bifilar pendulum.",
    "thrust_axis_tilt": "Look for tilted motor mounts, and level the flight controller's accelerometer on flat ground.",
    "damaged_propeller": "Replace the propeller of rotor {variant}, and look at its motor.",
    "rotor_gain": "Compare the propellers, and the speeds of all motors at one throttle on the bench.",
    "thrust_coefficient": "Measure the thrust of one rotor on a stand, and compare the type of propeller.",
    "torque_coefficient": "Measure the torque of one rotor on a stand, and compare the type of propeller.",
    "motor_time_constant": "Step the throttle on the bench and log the rotor speed.",
    "motor_asymmetry": "Step the throttle up and down on the bench; look at the setting of active braking of the ESCs.",
    "motor_map": "Run the motors up slowly on the bench, with a full and with an empty pack.",
    "battery_sag": "Measure the pack's internal resistance with the charger; an old or cold pack sags more.",
    "gyro_bias": "Let the vehicle stand still while the gyro calibrates, before each flight.",
    "accel_bias": "Calibrate the accelerometer on its six sides.",
    "accel_scale": "Calibrate the accelerometer on its six sides.",
    "imu_lever_arm": "Measure where the IMU sits relative to the centre of mass.",
    "marker_offset": "Move the origin of the markers' rigid body to the centre of mass in the motion capture.",
    "frame_misalignment": "Define the markers' rigid body again while the vehicle stands level and points along x.",
    "map_tilt": "Level the ground plane of the motion capture.",
    "time_offset": "Correct the stamps of the motion capture, or synchronise its clock with the vehicle's.",
    "clock_drift": "Synchronise the clocks of motion capture and vehicle (PTP, or NTP while recording).",
    "gate_displaced": "Measure gate {variant} again.",
    "map_scale": "Measure the distance of two gates.",
    "camera_extrinsic": "Calibrate the camera's mount (`swiftros calibration`).",
    "camera_focal": "Calibrate the camera (`swiftros calibration`).",
    "rate_loop_p": "Compare the vehicle file with the flight controller's `diff all`.",
    "rate_loop_i": "Compare the vehicle file with the flight controller's `diff all`.",
    "rate_loop_d": "Compare the vehicle file with the flight controller's `diff all`.",
    "rate_scale": "Compare rates and expo of the vehicle file with the flight controller's `diff all`.",
    "wind": "Fly again in still air.",
    "gust": "Fly again in still air.",
    "local_draught": "Look for a fan, a door or an air conditioner near this place.",
}


@dataclass(frozen=True)
class Inputs:
    """What a diagnosis was made from, and where its results are.

    Attributes:
        vehicle_file: the vehicle file.
        recordings: the recordings.
        out: folder of the results.
    """

    vehicle_file: Path
    recordings: list[Path]
    out: Path

    @property
    def again(self) -> str:
        """The command that diagnoses the same recordings and a new one together."""
        known = " ".join(str(path) for path in self.recordings)
        return f"swiftros gap {known} NEW_FLIGHT --vehicle {self.vehicle_file}"


def next_steps(report: dict, diagnosis, vehicle: Vehicle, inputs: Inputs) -> list[dict]:
    """Return what to do, in order: entries with `kind` (use, check, fly, record), `text` and `commands`.

    Args:
        report: content of report.json.
        diagnosis: a `gap.pipeline.diagnosis.Diagnosis`.
        vehicle: the vehicle before the repair.
        inputs: of the diagnosis.
    """
    findings = ranked(report["findings"])
    manoeuvres = {(one.effect.id, one.effect.variant): one.effect.manoeuvre for one in diagnosis.selected}
    return [
        *_use(findings, vehicle, inputs, _flown(diagnosis)),
        *_check(findings),
        *_fly(findings, manoeuvres, inputs),
        *_record(diagnosis, vehicle),
    ]


def _step(kind: str, text: str, *commands: str) -> dict:
    return {"kind": kind, "text": text, "commands": list(commands)}


def _flown(diagnosis) -> str:
    """Return up to which speed and motor command the repaired file was found, as a sentence; "" if neither is known."""
    recordings = [one.recording for one in diagnosis.evidence.residual_models]
    speeds = [np.linalg.norm(one.v_world, axis=1).max() for one in recordings if one.v_world is not None]
    commands = [one.motor_record.command.max() for one in recordings if one.motor_record is not None]
    known = [f"speeds up to {max(speeds):.0f} m/s"] if speeds else []
    known += [f"motor commands up to {max(commands):.2f}"] if commands else []
    return f" It was found at {' and '.join(known)}: beyond, it extrapolates." if known else ""


def _use(findings: list[dict], vehicle: Vehicle, inputs: Inputs, flown: str) -> list[dict]:
    """Return the steps that use the repaired files.

    Args:
        findings: by rank.
        vehicle: before the repair.
        inputs: of the diagnosis.
        flown: sentence about the speeds at which a repair was found that is not certain.
    """
    effects = [one for one in findings if one["effect"] or one.get("in_repair")]
    of_vehicle = [one for one in effects if one["effect"] not in MAP_EFFECTS]
    repaired, steps = inputs.out / "vehicle.yaml", []
    if not effects:
        steps.append(_step("use", f"Keep {inputs.vehicle_file}: no value in it changes."))
    if of_vehicle:
        text = f"Simulate with the repaired vehicle file, {repaired}."
        races = vehicle.controller.get("type") in RACING
        commands = (
            [f"swiftros race --vehicle {repaired}", f"swiftros train policy --vehicle {repaired}"] if races else []
        )
        if any(one["verdict"] != "confirmed" for one in of_vehicle):
            text += " Test it before on a flight that this diagnosis has not seen: it must find less there." + flown
            commands.insert(0, f"swiftros gap ANOTHER_FLIGHT --vehicle {repaired} --out {inputs.out}-test")
        steps.append(_step("use", text, *commands))
    if len(of_vehicle) < len(effects):
        text = f"Fly with the repaired map, {inputs.out / 'track.yaml'}: copy it over track.yaml of your configuration."
        steps.append(_step("use", text))
    return steps


def _check(findings: list[dict]) -> list[dict]:
    """Return one step that looks at the vehicle itself, for the findings that can be checked there."""
    known = [one for one in findings if one["effect"] in CHECKS][:MAX_CHECKED]
    texts = dict.fromkeys(CHECKS[one["effect"]].format(variant=one["variant"]) for one in known)
    return [_step("check", text) for text in texts]


def _fly(findings: list[dict], manoeuvres: dict, inputs: Inputs) -> list[dict]:
    """Return one step with the manoeuvres that separate confounders, make findings certain, or test an equation."""
    separating, certain = [], []
    for one in findings:
        name = one["effect"] and one["effect"].replace("_", " ")
        if one["verdict"] == "ambiguous" and one["separating_manoeuvre"]:
            names = dict.fromkeys([name, *(other["effect"].replace("_", " ") for other in one["alternatives"])])
            separating.append(f"{one['separating_manoeuvre']} (separates {' from '.join(names)})")
        elif "unexplained" in one:
            certain.append("the same path again (shows whether what is left comes back)")
        elif one["effect"] is None:
            certain.append("the same path at another speed and heading (tests whether the equation holds)")
        elif one["verdict"] == "tentative" and (one["effect"], one["variant"]) in manoeuvres:
            certain.append(f"{manoeuvres[one['effect'], one['variant']]} (makes {name} certain)")
    flights = list(dict.fromkeys([*separating, *certain]))[:MAX_FLOWN]
    if not flights:
        return []
    return [_step("fly", f"Fly: {'; '.join(flights)}. Then diagnose all flights together:", inputs.again)]


def _record(diagnosis, vehicle: Vehicle) -> list[dict]:
    """Return the channels to record: those first that make most further effects testable."""
    recordings = [one.recording for one in diagnosis.evidence.residual_models]
    gained: dict[tuple[str, ...], dict[str, None]] = {}
    for effect in all_effects(vehicle, gates=1):
        lacking = _lacking(effect, recordings)
        if lacking and effect.possible(vehicle) and IMAGES not in lacking:
            gained.setdefault(lacking, {})[effect.id] = None
    first = sorted(gained, key=lambda lacking: -len(gained[lacking]) / len(lacking))[:MAX_RECORDED]
    steps = []
    if any(one.driven for one in recordings):
        text = f"Record {names_with_columns(FINER)}: smaller changes show then, and effects that look alike separate."
        steps.append(_step("record", text))
    for lacking in first:
        names = [name.replace("_", " ") for name in gained[lacking]]
        more = f" and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else ""
        text = f"Record {names_with_columns(lacking)}: this makes {', '.join(names[:MAX_NAMED])}{more} testable."
        steps.append(_step("record", text))
    return steps


def _lacking(effect: Effect, recordings) -> tuple[str, ...]:
    """Return the channels that an effect needs and a recording lacks; none where another recording would not help."""
    missing = missing_channels(effect, recordings)
    if effect.layer == "command" and missing:
        evidence = "rate_loop" if "rate_loop" in missing else "command_link"
        missing = next(one.unavailable[evidence].missing for one in recordings if evidence in one.unavailable)
    return tuple(dict.fromkeys(unmeasured(missing, recordings)))
