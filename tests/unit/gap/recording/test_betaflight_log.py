"""A flight controller's own log shows the gains of its rate loop: gains other than the vehicle file's are found.

The logs are written by a second, plain implementation of Betaflight's loop, closed around a simple body.
"""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml
from blackbox_writer import NAMES, written

from swift_ros import cli
from swift_ros.configuration import configuration_folder, load
from swift_ros.errors import UsageError
from swift_ros.recording import flight_files
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.configuration.vehicle_profile import profile_from_vehicle
from swift_sim_bridge.flight_controller.rate_loop import loop as rate_loop
from swift_sim_bridge.flight_controller.rate_loop import stick_path
from swift_sim_bridge.gap import api
from swift_sim_bridge.gap.pipeline import references
from swift_sim_bridge.gap.recording import betaflight_log
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.report import repaired_files

VEHICLE = load(Vehicle, configuration_folder() / "drone.yaml")
GAINS = VEHICLE.controller["pid"]
DT, SECONDS, LOGGED_EVERY = 5e-4, 12.0, 2  # s between passes, s, and passes per logged row
P, I, D = 0.032029, 0.244381 * np.array([1.0, 1.0, 2.5]), 0.000529  # pid.h, on deg/s
TURN_GAIN = np.array([250.0, 250.0, 60.0])  # rad/s^2 at full demand of an axis
LAG_S = 0.03
MIX = np.array([[-1, 1, -1], [-1, -1, 1], [1, 1, 1], [1, -1, -1]]) * [1.0, 1.0, -1.0]  # roll, pitch, yaw of each motor


def low(cutoff_hz: float) -> float:
    return DT / (DT + 1.0 / (2.0 * np.pi * cutoff_hz))


def log(seed: int, feedforward: float = 0.0, clip: float = 1.0, **changes) -> FlightTable:
    """Write the log of a flight with these gains in place of the file's: `roll=(60, 40, 48)`."""
    rng, gains = np.random.default_rng(seed), np.array([changes.get(axis, GAINS[axis]) for axis in betaflight_log.AXES])
    t, idle, tune = np.arange(0.0, SECONDS, DT), VEHICLE.controller["motor_idle"] / 100.0, VEHICLE.controller
    waves = sum(np.sin(2 * np.pi * hz * t[:, None] + rng.uniform(0, 6.0, 4)) for hz in (0.4, 0.9, 1.7, 3.1))
    setpoint, throttle = np.round(waves[:, :3] * [50.0, 50.0, 15.0]), 0.35 + 0.04 * waves[:, 3]
    ahead = feedforward * np.gradient(setpoint, DT, axis=0)
    relax, dterm = low(tune["iterm_relax_cutoff"]), low(tune["dterm_lpf1_static_hz"])
    omega, turn, total, slow, first, second, rows = *(np.zeros(3) for _ in range(6)), []
    for k in range(len(t)):
        gyro = omega + rng.normal(0.0, 0.5, 3)
        error, before = setpoint[k] - gyro, second
        first = first + dterm * (gyro - first)
        second = second + dterm * (first - second)
        slow = slow + relax * (setpoint[k] - slow)
        total = total + I * gains[:, 1] * error * DT * np.clip(1.0 - np.abs(setpoint[k] - slow) / 40.0, 0.0, 1.0)
        demand = (P * gains[:, 0] * error + total - D * gains[:, 2] * (second - before) / DT + ahead[k]) / 1000.0
        motors = idle + (1.0 - idle) * np.clip(throttle[k] + MIX @ demand, 0.0, clip)
        turn = turn + DT / LAG_S * (TURN_GAIN * demand - turn)
        omega = omega + DT * np.rad2deg(turn)
        if k % LOGGED_EVERY == 0:
            rows.append((t[k], np.round(gyro), setpoint[k], np.round(1999.0 * motors) / 1999.0, ahead[k] / 1000.0))
    t, gyro, setpoint, motors, ahead = (np.array(column) for column in zip(*rows, strict=True))
    return FlightTable(
        f"log {seed}",
        {
            "gyro_body": Samples(t, np.deg2rad(gyro)),
            "omega_command_body": Samples(t, np.deg2rad(setpoint)),
            "motor_command": Samples(t, motors),
            "feedforward_body": Samples(t, ahead),
        },
    )


def test_the_replayed_loop_gives_the_demand_of_the_logged_one():
    found = betaflight_log.read_rate_loop_log(log(1, feedforward=0.02), VEHICLE)
    apart = found.residual([VEHICLE])[0]
    assert found.observable.mean() > 0.9
    assert np.all(apart.std(axis=0) < 0.03 * found.demand.std(axis=0))


def test_an_imported_blackbox_holds_all_channels(tmp_path):
    flown = log(2, feedforward=0.02)
    flown = replace(
        flown, channels={name: Samples(one.t[:4000], one.values[:4000]) for name, one in flown.channels.items()}
    )
    rows = np.zeros((len(flown["gyro_body"].t), len(NAMES)), dtype=np.int64)
    columns = {name: rows[:, i] for i, name in enumerate(NAMES)}
    columns["loopIteration"][:], columns["time"][:] = np.arange(len(rows)), np.round(1e6 * flown["gyro_body"].t)
    for i in range(3):
        columns[f"gyroADC[{i}]"][:] = np.round(np.rad2deg(flown["gyro_body"].values[:, i]))
        columns[f"setpoint[{i}]"][:] = np.round(np.rad2deg(flown["omega_command_body"].values[:, i]))
        columns[f"axisF[{i}]"][:] = np.round(1000.0 * flown["feedforward_body"].values[:, i])
    columns["accSmooth[2]"][:] = 2048 + np.arange(len(rows)) % 7
    for i in range(4):
        columns[f"motor[{i}]"][:] = np.round(48 + 1999.0 * flown["motor_command"].values[:, i])
    columns["vbatLatest"][:] = 1600 - np.arange(len(rows)) // 500
    (tmp_path / "flight.bbl").write_bytes(written(rows))
    assert cli.main(["import", str(tmp_path / "flight.bbl"), "--out", str(tmp_path / "out")]) == 0
    found = betaflight_log.read_rate_loop_log(flight_files.read(tmp_path / "out" / "flight"), VEHICLE)
    apart = found.residual([VEHICLE])[0]
    assert len(found.t) == len(rows) and np.all(apart.std(axis=0) < 0.03 * found.demand.std(axis=0))


def found_in(table: FlightTable, vehicle: Vehicle = VEHICLE):
    return api.diagnose([table], vehicle, lambda text: None, validate=False)


@pytest.mark.slow
def test_a_log_with_the_settings_of_the_file_gives_no_finding(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", 8)
    report = found_in(log(3, feedforward=0.02)).report
    assert report["verdict"] == "cannot_tell"
    assert report["minimum_detectable"]["rate_loop_p"]["p_roll"] < 1.0


def test_other_gains_than_the_files_are_named_and_written_into_the_repaired_file(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", 8)
    found = found_in(log(4, roll=(60, 40, 48), pitch=(56, 42, 40)))
    parameters = {one["effect"]: one["parameters"] for one in found.report["findings"]}
    assert set(parameters) == {"rate_loop_p", "rate_loop_d"}
    assert parameters["rate_loop_p"]["p_roll"]["value"] == pytest.approx(60, abs=0.5)
    assert parameters["rate_loop_d"]["d_pitch"]["value"] == pytest.approx(40, abs=1.5)
    assert found.vehicle.controller["pid"]["roll"][0] == pytest.approx(60, abs=0.5)
    text = repaired_files.vehicle_text(
        {"controller": {"type": "betaflight", "dump": "diff.txt"}}, found, Path("drone.yaml")
    )
    assert yaml.safe_load(text)["controller"]["pid"]["pitch"][2] == pytest.approx(40, abs=1.5)


def test_a_gap_in_the_log_hides_only_the_time_after_it(monkeypatch):
    whole = log(5)
    cut = replace(
        whole,
        channels={
            name: Samples(np.delete(one.t, np.s_[6000:6900]), np.delete(one.values, np.s_[6000:6900], axis=0))
            for name, one in whole.channels.items()
        },
    )
    found = betaflight_log.read_rate_loop_log(cut, VEHICLE)
    apart = found.residual([VEHICLE])[0]
    around = (found.t > 6.9) & (found.t < 6.9 + betaflight_log.SETTLING_S - 0.01)
    assert not found.observable[around].any() and found.observable[~around & (found.t > 1.0)].mean() > 0.9
    assert np.all(np.abs(apart).max(axis=0) < 0.02)


def test_a_gain_beside_a_dump_replaces_the_dumps(tmp_path):
    (tmp_path / "diff.txt").write_text("# Betaflight / STM32F7X2 (S7X2) 4.5.1\nset p_roll = 45\nset d_roll = 33\n")
    dumped = replace(VEHICLE, controller={"type": "betaflight", "dump": "diff.txt"}, folder=str(tmp_path))
    gains = betaflight_log.with_pid_gains(dumped)
    assert gains.controller["pid"]["roll"][0] == 45
    gains.controller["pid"]["roll"][0] = 60.0
    before, after = (profile_from_vehicle(one) for one in (dumped, gains))
    assert float(after.kp[0] / before.kp[0]) == pytest.approx(60 / 45)
    assert np.array_equal(after.kp[1:], before.kp[1:]) and np.array_equal(after.kd, before.kd)


@pytest.mark.parametrize(
    "broken, says",
    [
        (lambda one: replace(one, channels={k: v for k, v in one.channels.items() if k != "motor_command"}), "lacks"),
        (
            lambda one: replace(one, channels={k: Samples(v.t[::5], v.values[::5]) for k, v in one.channels.items()}),
            "200 Hz, below 400",
        ),
        (
            lambda one: replace(
                one, channels={**one.channels, "gyro_body": Samples(one["gyro_body"].t + 3e-4, one["gyro_body"].values)}
            ),
            "not recorded at the same times",
        ),
    ],
)
def test_a_log_that_cannot_be_evaluated_gives_the_reason(broken, says):
    unavailable = betaflight_log.read_rate_loop_log(broken(log(6)), VEHICLE)
    assert says in unavailable.reason or (says, *unavailable.missing) == ("lacks", "motor_command")


@pytest.mark.parametrize(
    "order, says",
    [
        ([1, 0, 3, 2], "pitch and yaw against the rate loop; give them in"),
        ([2, 3, 0, 1], "roll and yaw against"),
        ([3, 2, 1, 0], "roll and pitch"),
    ],
)
def test_motors_in_another_order_are_refused(order, says):
    flown = log(6)
    mixed = Samples(flown["motor_command"].t, flown["motor_command"].values[:, order])
    with pytest.raises(UsageError, match=says), jax.enable_x64(True):
        read_recording(replace(flown, channels={**flown.channels, "motor_command": mixed}), VEHICLE)


def test_propellers_with_reversed_yaw_are_refused():
    other = replace(VEHICLE, controller={**VEHICLE.controller, "yaw_motors_reversed": True})
    with pytest.raises(UsageError, match="yaw_motors_reversed"), jax.enable_x64(True):
        read_recording(log(6), other)


def test_a_vehicle_whose_loop_cannot_be_replayed_gives_the_reason():
    flown = log(6)
    bare = replace(VEHICLE, controller={"type": "betaflight"})
    assert "controller" in betaflight_log.read_rate_loop_log(flown, bare).reason
    assert betaflight_log.with_pid_gains(bare) is bare
    six = replace(
        flown,
        channels={
            **flown.channels,
            "motor_command": Samples(
                flown["motor_command"].t, np.repeat(flown["motor_command"].values, 2, axis=1)[:, :6]
            ),
        },
    )
    assert "6 motors" in betaflight_log.read_rate_loop_log(six, VEHICLE).reason


def dumped(vehicle: Vehicle, seconds: float = 5.0) -> FlightTable:
    """Return the log, of every eighth pass, of the simulated firmware set up by the vehicle's dump."""
    settings, dt, rng = profile_from_vehicle(vehicle), 1.0 / 8000.0, np.random.default_rng(2)
    settings = replace(settings, watch_runaway=True)
    t = np.arange(0.0, seconds, dt)
    waves = sum(np.sin(2 * np.pi * hz * t[:, None] + rng.uniform(0, 6.0, 4)) for hz in (0.4, 0.9, 1.7, 3.1))
    frame = np.arange(len(t)) % 80 == 0
    held = waves[np.arange(len(t)) // 80 * 80]
    sticks, throttle = np.deg2rad(held[:, :3] * [30.0, 30.0, 10.0]), 0.35 + 0.06 * held[:, 3]

    def one(before, now):
        (loop, omega, turn), (rates, throttle, frame, noise) = before, now
        taken = rate_loop.take_frame(loop, stick_path.ReceiverFrame(rates, throttle, jnp.asarray(True)), settings)
        loop = jax.tree.map(lambda new, old: jnp.where(frame, new, old), taken, loop)
        seen = (omega + noise) * rate_loop.DEGREES
        filtered, _ = rate_loop._filter_gyro(seen, loop, dict(loop.terms), settings, dt, jnp.full(4, 1300.0))
        smooth, _, _ = stick_path.pass_sticks(rates * rate_loop.DEGREES, throttle, dict(loop.terms), settings, dt)
        measured = rate_loop.LoopInput(rates, throttle, omega + noise, jnp.full(4, 1300.0))
        loop, motors = rate_loop.rate_loop_step(loop, measured, settings, dt)
        ahead = settings.feedforward.gain * loop.terms["smooth_feedforward"][-1]
        turn = turn + dt / jnp.array([0.03, 0.03, 0.008]) * (TURN_GAIN * loop.terms["pid_sum"] / 1000.0 - turn)
        return (loop, omega + dt * turn, turn), (filtered, smooth, ahead, motors)

    zero = jnp.zeros(3)
    start = rate_loop.initial_loop_state(zero, settings), zero, zero
    inputs = tuple(map(jnp.asarray, (sticks, throttle, frame, rng.normal(0.0, 0.02, (len(t), 3)))))
    _, logged = jax.jit(lambda inputs: jax.lax.scan(one, start, inputs))(inputs)
    gyro, setpoint, ahead, motors = (np.asarray(part)[::8] for part in logged)
    names = ("gyro_body", "omega_command_body", "feedforward_body", "motor_command")
    values = np.deg2rad(np.round(gyro)), np.deg2rad(np.round(setpoint)), np.round(ahead) / 1000, np.round(1999 * motors)
    return FlightTable(
        "dumped",
        {
            name: Samples(t[::8], column / (1999.0 if name == "motor_command" else 1.0))
            for name, column in zip(names, values, strict=True)
        },
    )


@pytest.mark.slow
def test_a_whole_set_up_is_replayed_within_two_hundredths(tmp_path):
    """Smoothing, feed-forward, RPM filter, notches, TPA, anti-gravity and boost as the firmware ships them."""
    (tmp_path / "diff.txt").write_text("# Betaflight / STM32F7X2 (S7X2) 4.5.1\nfeature AIRMODE\nset p_roll = 45\n")
    vehicle = replace(VEHICLE, controller={"type": "betaflight", "dump": "diff.txt"}, folder=str(tmp_path))
    with jax.enable_x64(True):
        found = betaflight_log.read_rate_loop_log(dumped(vehicle), vehicle)
        apart = found.residual([vehicle])[0]
    slow = lambda values: np.stack([np.convolve(column, np.ones(40) / 40, "same") for column in values.T], axis=-1)  # noqa: E731
    assert found.observable.mean() > 0.8
    assert np.all(slow(apart)[found.observable].std(axis=0) < 0.02 * slow(found.demand)[found.observable].std(axis=0))
