"""Residuals of VIO and commands in reference flights, which simulate neither.

The vehicle file does not describe their noise. Reference flights use the recording's own: what all effects and
quantities together leave of its residuals, with random phases (Theiler et al. 1992). It has the same spectrum, and is
independent of the motion. The part that depends on the motion is caused by the noise of the pose; it is computed by
adding the same noise to the pose once more.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from swift_ros import geometry
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.effects.injection import file_values, inject
from swift_sim_bridge.gap.inference.normal_equations import solve
from swift_sim_bridge.gap.inference.null_distribution import NullDistribution, seconds_with_data
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.nominal import rotor_speed_model
from swift_sim_bridge.gap.nominal.recorded_flight import RecordedFlight
from swift_sim_bridge.gap.recording.recording import SYNCHRONOUS_CHANNELS, read_recording
from swift_sim_bridge.gap.residuals import odometry
from swift_sim_bridge.gap.residuals.filters import apply
from swift_sim_bridge.parallel import run_in_threads
from swift_sim_bridge.sensors.terms import sensor_terms


def add_surrogate_channels(
    references: list[Linearisation], recorded: Linearisation, quantities: list[np.ndarray], seed: int
) -> None:
    """Give the reference flights the channels that only the recording has: the last ones of its linearisation.

    Args:
        references: linearisations of the reference flights. They are replaced one by one: with and without these
            channels all of them take more than a gigabyte.
        recorded: linearisation of the recording.
        quantities: for each channel of the recording the quantities (m, q) on which its residual may depend; what they
            explain is not noise.
        seed: seed of the random phases.
    """
    simulated = references[0].residual.shape[1]
    if recorded.residual.shape[1] == simulated:
        return
    rng, noise = np.random.default_rng([seed, 14]), _unexplained(recorded, simulated, quantities)
    rows = np.flatnonzero(np.any(recorded.sensitivity[:, :, simulated:] != 0, axis=(1, 2)))
    sensitivity = recorded.sensitivity[rows, :, simulated:]
    surrogates = [_with_random_phases(noise, rng) for _ in references]

    def complete(i: int) -> None:
        references[i] = _with_channels(references[i], rows, sensitivity, surrogates[i])

    run_in_threads(*(partial(complete, i) for i in range(len(references))))


def _unexplained(recorded: Linearisation, first: int, quantities: list[np.ndarray]) -> np.ndarray:
    """Return what effects and quantities leave (m, h) of each channel from `first` on, one channel at a time."""
    left = recorded.residual[:, first:].copy()
    for channel in range(left.shape[1]):
        own = np.where(recorded.good[:, None], quantities[first + channel], 0.0).T
        columns = np.concatenate([recorded.sensitivity[:, :, first + channel], own])
        columns = columns[np.any(columns != 0, axis=1)]
        left[:, channel] -= solve(columns @ columns.T, columns @ left[:, channel]) @ columns
    return left


def _with_random_phases(values, rng) -> np.ndarray:
    """Return a signal (m, h) with the same spectrum and random phases, the same in all columns."""
    spectrum = np.fft.rfft(values, axis=0)
    turn = np.exp(2j * np.pi * rng.random((len(spectrum), 1)))
    return np.fft.irfft(np.concatenate([spectrum[:1], (turn * spectrum)[1:]]), n=len(values), axis=0)


def _with_channels(reference: Linearisation, rows, sensitivity, residual) -> Linearisation:
    """Return a reference flight with h more channels, cut or padded with zeros to its length.

    Args:
        reference: the reference flight.
        rows: (k,) parameters that affect these channels.
        sensitivity: (k, m, h) of these parameters.
        residual: (m, h).
    """

    def joined(simulated, others, places=...):
        """Return channels (..., m', c) followed by others (..., m, h) at these places of the first axis."""
        count, channels = min(len(reference.t), len(residual)), simulated.shape[-1]
        both = np.zeros((*simulated.shape[:-1], channels + others.shape[-1]))
        both[..., :channels] = simulated
        both[..., channels:][places, :count] = np.where(reference.good[:count, None], others[..., :count, :], 0.0)
        return both

    residual, sensitivity = joined(reference.residual, residual), joined(reference.sensitivity, sensitivity, rows)
    return replace(reference, residual=residual, sensitivity=sensitivity)


def with_pose_noise(
    null_distribution: NullDistribution,
    recorded: RecordedFlight,
    effects: tuple[Effect, ...],
    noise_m: float,
    seed: int,
) -> NullDistribution:
    """Return the null distribution with the bias that the noise of the pose causes in the effects of VIO.

    Without a recorded velocity, that of the pose is on both sides of VIO's residual: in a slow flight its noise looks
    like a scale error of VIO (errors in variables, Fuller 1987).

    Args:
        null_distribution: of the reference flights.
        recorded: the recording.
        effects: all effects.
        noise_m: standard deviation of the pose's position, m.
        seed: seed of the added noise.
    """
    channels = [c for c, channel in enumerate(recorded.residual_model.channels) if channel.layer == "vio"]
    vio_effects = [effect for effect in effects if effect.layer == "vio"]
    recording, low, line = recorded.residual_model.recording, recorded.residual_model.filter, recorded.linearisation
    if not channels or not vio_effects or recording.velocity_measured:
        return null_distribution
    p_world = _position_with_noise(recorded, noise_m, seed)
    q = recording.q_world_body[low.rows]
    v_world, noise = (apply(low.slope, p) for p in (recording.p_world, p_world - recording.p_world))
    seconds, gradient = seconds_with_data(line), np.zeros_like(null_distribution.bias_gradient_by_channel)
    sigma = null_distribution.sigma[channels]
    for effect in vio_effects:
        for i, parameter in enumerate(effect.parameters):
            row = null_distribution.slices[effect.key].start + i
            step = parameter.step * np.eye(len(effect.parameters))[i]
            idle, moved = (
                sensor_terms(inject(recorded.vehicle, effect, file_values(effect, recorded.vehicle) + by))
                for by in (0.0, step)
            )
            without_noise, with_noise = (
                odometry.velocity_error(q, v, moved) - odometry.velocity_error(q, v, idle)
                for v in (v_world, v_world + noise)
            )
            products = geometry.rotate_inverse(q, with_noise - without_noise) * geometry.rotate_inverse(q, noise)
            gradient[row, channels] = products[line.good].sum(axis=0) / np.square(sigma) / seconds
    bias = gradient.sum(axis=1) * seconds / np.maximum(null_distribution.information, 1e-300)
    return replace(
        null_distribution,
        bias_gradient_by_channel=null_distribution.bias_gradient_by_channel + gradient,
        bias=null_distribution.bias - bias,
    )


def _position_with_noise(recorded: RecordedFlight, noise_m: float, seed: int) -> np.ndarray:
    """Return the position (n, 3) m of a recording on its grid, with noise added to the measured one."""
    position, rng = recorded.table["p_world"], np.random.default_rng([seed, 16])
    noisy = Samples(position.t, position.values + noise_m * rng.standard_normal(position.values.shape))
    whole = rotor_speed_model.with_modelled_rotor_speeds(recorded.table, recorded.vehicle)
    channels = {name: samples for name, samples in whole.channels.items() if name in SYNCHRONOUS_CHANNELS}
    table = FlightTable(recorded.table.name, {**channels, "p_world": noisy})
    return read_recording(table, recorded.vehicle, simulated=True).p_world
