"""Betaflight 4.5's rate loop, from the firmware's formulas (pid.c, mixer.c, filter.c), batchable in JAX.

The firmware uses degrees and FLU axes: roll right, nose down and turn left are positive. D acts on the measurement
alone; the I term is reset while the throttle is closed; at saturation body rates have priority (Methods, low-level
controller). A term that a profile switches off is None or empty in it and absent from the compiled pass.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swift_sim_bridge.flight_controller.rate_loop import (
    dynamic_notch,
    filters,
    mixer,
    rpm_filter,
    runaway,
    stick_path,
    throttle_path,
)
from swift_sim_bridge.flight_controller.rate_loop.profile import RateLoopProfile

ITERM_RELAX_THRESHOLD = 40.0  # deg/s between a setpoint and its low-pass at which the I term stops growing (pid.c)
LEVELLED_RELAX_SHARE = 0.2  # of that threshold in angle mode
ANTI_GRAVITY_FREE = 50.0  # deg/s of setpoint above which anti-gravity's P fades
D_RANGE_HZ, D_SMOOTH_HZ = 85.0, 35.0  # pid_init.c: D_MIN_RANGE_HZ, D_MIN_LOWPASS_HZ
DEGREES = 180.0 / np.pi  # deg per rad


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RateLoopState:
    """Memory of the rate loop.

    Attributes:
        iterm: (..., 3) PID units.
        gyro_filters: memory of each gyro filter.
        dterm_filters: memory of each filter of the D term.
        dterm_gyro: (..., 3) deg/s, last filtered sample of the D term.
        setpoint: (..., 3) deg/s, low-passed setpoint.
        mix_range: (...), range of the last motor differences as a share of the motors' range.
        terms: memory of the profile's optional terms, by name.
    """

    iterm: jax.Array
    gyro_filters: tuple
    dterm_filters: tuple
    dterm_gyro: jax.Array
    setpoint: jax.Array
    mix_range: jax.Array
    terms: dict = field(default_factory=dict)


def initial_loop_state(omega_body, profile: RateLoopProfile | None = None) -> RateLoopState:
    """Return the memory of a loop with the gyro at rest.

    Args:
        omega_body: (..., 3) array that gives shape and type.
        profile: profile of the loop; None for one PT1 low-pass on the gyro, two on D and no optional terms.
    """
    zero = jnp.zeros_like(omega_body)
    if profile is None:
        return RateLoopState(zero, ((zero,),), ((zero,),) * 2, zero, zero, zero[..., 0])
    terms = stick_path.at_rest(profile, zero) | throttle_path.at_rest(profile, zero[..., 0])
    if profile.rpm_filter is not None:
        terms["rpm_filter"] = rpm_filter.at_rest(profile.rpm_filter, zero)
    if profile.dynamic_notch is not None:
        terms["dynamic_notch"] = dynamic_notch.at_rest(profile.dynamic_notch, zero)
    if profile.yaw_lowpass_hz is not None:
        terms["yaw_p"] = (zero[..., 2:],)
    if profile.d_min is not None:
        terms |= {"d_range": (zero, zero), "d_factor": (zero, zero)}
    if profile.sag_compensation is not None:
        full = jnp.full_like(zero[..., :1], mixer.CELL_FULL_V) * profile.sag_compensation.cells[..., None]
        terms["sag_voltage"] = (full,)
    if profile.loop_hz:
        terms["omega_before"] = omega_body
    if profile.serial_phase_s:
        terms |= {"held_setpoint": zero, "held_throttle": zero[..., 0]}
    if profile.watch_runaway:
        terms |= {"pid_sum": zero, "runaway_s": zero[..., 0], "runaway": zero[..., 0] > 0}
    gyro, dterm = (
        tuple(filters.initial_memory(each, zero) for each in throttle_path.lowpasses_of_sweeps(row, terms))
        for row in (profile.gyro_filters, profile.dterm_filters)
    )
    return RateLoopState(
        iterm=zero,
        gyro_filters=gyro,
        dterm_filters=dterm,
        dterm_gyro=zero,
        setpoint=zero,
        mix_range=zero[..., 0],
        terms=terms,
    )


class LoopInput(NamedTuple):
    """What one pass of the rate loop takes.

    Attributes:
        setpoint_omega_body: (..., 3) rad/s.
        throttle: (...), 0 (closed) to 1.
        gyro_omega_body: (..., 3) rad/s, measured.
        rotor_speed: (..., n) rad/s; only the RPM filter needs it.
    """

    setpoint_omega_body: jax.Array
    throttle: jax.Array
    gyro_omega_body: jax.Array
    rotor_speed: jax.Array | None = None


class _Tracking(NamedTuple):
    """Filtered setpoint and gyro of one pass and their difference, each (..., 3) deg/s."""

    setpoint: jax.Array
    gyro: jax.Array
    error: jax.Array


def take_frame(loop_state, frame: stick_path.ReceiverFrame, profile) -> RateLoopState:
    """Return the memory after a receiver frame; the following passes fly by it."""
    setpoint = frame.setpoint_omega_body * DEGREES
    terms = stick_path.take_frame(loop_state.terms, frame, setpoint, profile)
    if profile.watch_runaway:
        terms["runaway"] = terms["runaway"] & frame.armed
    if profile.serial_phase_s:
        held_throttle = jnp.asarray(frame.throttle, setpoint.dtype)
        terms |= {"held_setpoint": frame.setpoint_omega_body, "held_throttle": held_throttle}
    return replace(loop_state, terms=terms)


def take_voltage(loop_state, voltage, profile, dt) -> RateLoopState:
    """Return the memory after a measurement of the pack's voltage.

    Source: sensors/voltage.c.

    Args:
        loop_state: memory before.
        voltage: (...) V.
        profile: profile of the loop.
        dt: s since the previous measurement.
    """
    if profile.sag_compensation is None:
        return loop_state
    gain = filters.pt1_gain(profile.sag_compensation.lowpass_hz, dt)
    smooth, _ = filters.chain(loop_state.terms["sag_voltage"], voltage[..., None], gain)
    return replace(loop_state, terms={**loop_state.terms, "sag_voltage": smooth})


def rate_loop_step(loop_state, measured: LoopInput, profile, dt):
    """Run one pass of the rate loop.

    Args:
        loop_state: memory of the passes before.
        measured: setpoint, throttle and measurements of this pass.
        profile: profile of the loop.
        dt: s since the previous pass.

    Returns:
        (loop_state, motor_command (..., 4) in 0..1).
    """
    throttle, terms = measured.throttle, dict(loop_state.terms)
    setpoint = measured.setpoint_omega_body * DEGREES
    setpoint, throttle, terms = stick_path.pass_sticks(setpoint, throttle, terms, profile, dt)
    gyro = measured.gyro_omega_body * DEGREES
    gyro, gyro_memory = _filter_gyro(gyro, loop_state, terms, profile, dt, measured.rotor_speed)
    tracking = _Tracking(setpoint, gyro, setpoint - gyro)

    dterm_filters = throttle_path.lowpasses_of_sweeps(profile.dterm_filters, terms)
    dterm_memory, dterm_gyro = filters.apply_all(dterm_filters, loop_state.dterm_filters, gyro, dt)
    dterm = profile.kd * (loop_state.dterm_gyro - dterm_gyro) / dt
    dterm = _scale_dterm(dterm, (loop_state.dterm_gyro - dterm_gyro) / dt, terms, profile, dt)

    growth, slow_setpoint = _iterm_growth(tracking, loop_state, terms, profile, dt)
    if profile.windup_inverse is not None:
        growth = growth * jnp.clip((1.0 - loop_state.mix_range) * profile.windup_inverse, 0.0, 1.0)[..., None]
    limit = profile.iterm_limit[..., None]
    before = _rotated(loop_state.iterm, gyro, dt) if profile.rotate_iterm else loop_state.iterm
    iterm = jnp.clip(before + growth * dt, -limit, limit)
    acting_iterm = iterm
    if profile.airmode is None:
        acting_iterm = iterm = jnp.where(measured.throttle[..., None] > 0, iterm, 0.0)
    else:  # the firmware adds the I term before it resets it
        iterm = jnp.where(terms["airborne"][..., None], iterm, 0.0)

    pterm = _proportional(tracking, terms, profile, dt)
    pid_sum = pterm + acting_iterm + dterm
    if profile.feedforward is not None:
        pid_sum = pid_sum + profile.feedforward.gain * terms["smooth_feedforward"][-1]
    if profile.watch_runaway:
        terms |= _runaway_memory(pid_sum, gyro, terms, dt)
    throttle, terms = throttle_path.pass_throttle(throttle, terms, profile, dt)
    range_lost = None
    if profile.sag_compensation is not None:
        range_lost = mixer.range_lost_to_sag(terms["sag_voltage"][0][..., 0], profile.sag_compensation)
    motor_command, mix_range = mixer.mix(pid_sum, throttle, profile, range_lost)
    after = RateLoopState(
        iterm=iterm,
        gyro_filters=gyro_memory,
        dterm_filters=dterm_memory,
        dterm_gyro=dterm_gyro,
        setpoint=slow_setpoint,
        mix_range=mix_range,
        terms=terms,
    )
    return after, motor_command


def _filter_gyro(gyro, loop_state, terms, profile, dt, rotor_speed):
    """Return (gyro (..., 3), memory of `gyro_filters`) after RPM filter, gyro filters and dynamic notches."""
    if profile.rpm_filter is not None:
        past = terms["rpm_filter"]
        terms["rpm_filter"], gyro = rpm_filter.apply(profile.rpm_filter, past, gyro, rotor_speed, dt)
    row = throttle_path.lowpasses_of_sweeps(profile.gyro_filters, terms)
    memory, gyro = filters.apply_all(row, loop_state.gyro_filters, gyro, dt)
    if profile.dynamic_notch is not None:
        past = terms["dynamic_notch"]
        terms["dynamic_notch"], gyro = dynamic_notch.apply(profile.dynamic_notch, past, gyro, dt)
    return gyro, memory


def _scale_dterm(dterm, delta, terms, profile, dt):
    """Return D (..., 3), scaled between its minimum and maximum and attenuated by throttle (pid.c, `pidController`)."""
    if profile.d_min is not None:
        term = profile.d_min
        correction = filters.CUTOFF_CORRECTIONS[2]
        gains = (filters.pt1_gain(jnp.asarray(hz * correction, dterm.dtype), dt) for hz in (D_RANGE_HZ, D_SMOOTH_HZ))
        terms["d_range"], moved = filters.chain(terms["d_range"], delta, next(gains))
        factor = jnp.abs(moved) * term.gyro_gain[..., None]
        if profile.feedforward is not None:
            ahead = jnp.abs(terms["smooth_feedforward"][-1]) * term.setpoint_gain[..., None]
            factor = jnp.maximum(factor, ahead)
        factor = term.share + (1.0 - term.share) * factor
        terms["d_factor"], factor = filters.chain(terms["d_factor"], factor, next(gains))
        dterm = dterm * jnp.where(term.share > 0, jnp.minimum(factor, 1.0), 1.0)
    return dterm if profile.tpa is None else dterm * terms["tpa"][..., None]


def _iterm_growth(tracking: _Tracking, loop_state, terms, profile, dt):
    """Return (growth of the I term per s, low-pass of the setpoint), each (..., 3) (`applyItermRelax`)."""
    setpoint, gyro, error = tracking
    ki = profile.ki
    if profile.anti_gravity is not None:
        more = throttle_path.ANTI_GRAVITY_KI * terms["anti_gravity_d"][..., None]
        ki = ki + jnp.where(jnp.arange(3) < 2, more, 0.0)
    if profile.iterm_relax_cutoff_hz is None:
        return ki * error, loop_state.setpoint
    gain = filters.pt1_gain(profile.iterm_relax_cutoff_hz, dt)
    _, slow_setpoint = filters.chain((loop_state.setpoint,), setpoint, gain)
    ahead = jnp.abs(setpoint - slow_setpoint)
    if profile.relax == "GYRO":
        off = slow_setpoint - gyro
        growth = ki * jnp.sign(off) * jnp.maximum(jnp.abs(off) - ahead, 0.0)
    else:
        threshold = ITERM_RELAX_THRESHOLD
        if "levelled" in terms:
            threshold = jnp.where(terms["levelled"], LEVELLED_RELAX_SHARE, 1.0)[..., None] * threshold
        growth = ki * error * jnp.maximum(1.0 - ahead / threshold, 0.0)
    if profile.relax_only_growth:
        growth = jnp.where(loop_state.iterm * error < 0, ki * error, growth)
    if not profile.relax_yaw:
        growth = jnp.where(jnp.arange(3) < 2, growth, ki * error)
    return growth, slow_setpoint


def _proportional(tracking: _Tracking, terms, profile, dt):
    """Return the P term (..., 3)."""
    pterm = profile.kp * tracking.error
    if profile.tpa is not None and profile.tpa.on_p:
        pterm = pterm * terms["tpa"][..., None]
    if profile.yaw_lowpass_hz is not None:
        gain = filters.pt1_gain(profile.yaw_lowpass_hz, dt)
        terms["yaw_p"], yaw = filters.chain(terms["yaw_p"], pterm[..., 2:], gain)
        pterm = jnp.concatenate([pterm[..., :2], yaw], axis=-1)
    if profile.anti_gravity is not None:
        share = throttle_path.ANTI_GRAVITY_KP * profile.anti_gravity.p_gain * terms["anti_gravity_d"]
        boost = 1.0 + share[..., None] / jnp.maximum(jnp.abs(tracking.setpoint) / ANTI_GRAVITY_FREE, 1.0)
        pterm = pterm * jnp.where(jnp.arange(3) < 2, boost, 1.0)
    return pterm


def _rotated(iterm, gyro, dt):
    """Return the I term (..., 3), rotated to stay constant in space while the body rotates (`rotateVector`)."""
    parts = [iterm[..., i] for i in range(3)]
    for i in range(3):
        j, k, turn = (i + 1) % 3, (i + 2) % 3, gyro[..., i] * dt / DEGREES
        parts[j], parts[k] = parts[j] + parts[k] * turn, parts[k] - parts[j] * turn
    return jnp.stack(parts, axis=-1)


def _runaway_memory(pid_sum, gyro, terms, dt):
    """Return the memory of runaway-takeoff detection (core.c, `subTaskPidController`)."""
    rotating = jnp.any(jnp.abs(gyro) > jnp.asarray(runaway.GYRO_LIMITS_DEG_S, gyro.dtype), axis=-1)
    at_full_effort = jnp.any(jnp.abs(pid_sum) >= runaway.PID_SUM_LIMIT, axis=-1)
    runaway_s = jnp.where(at_full_effort & rotating, terms["runaway_s"] + dt, 0.0)
    return {"pid_sum": pid_sum, "runaway_s": runaway_s, "runaway": terms["runaway"] | (runaway_s > runaway.TRIP_S)}
