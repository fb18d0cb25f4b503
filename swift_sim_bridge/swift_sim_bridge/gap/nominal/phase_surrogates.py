"""Twins' share of what no twin flies: VIO and the commands' way, of whose noise the vehicle file knows nothing.

A twin borrows the recording's own: what is left of it beside all effects and quantities that show there, its phases
drawn anew (Theiler 1992): noise of the same colour that goes with no motion. What of that noise goes with a motion is
the pose's own, which is found by giving the pose as much again.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from swift_ros import geometry
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.effects.injection import file_values, inject
from swift_sim_bridge.gap.inference.normal_equations import solve
from swift_sim_bridge.gap.inference.null_distribution import NullDistribution, seconds_with_data
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.nominal import rotor_speed_model
from swift_sim_bridge.gap.recording.recording import SYNCHRONOUS_CHANNELS, read_recording
from swift_sim_bridge.gap.residuals import odometry
from swift_sim_bridge.gap.residuals.filters import apply
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.parallel import run_in_threads
from swift_sim_bridge.sensors.terms import sensor_terms


def with_surrogate_channels(
    twins: list[Linearisation], own: Linearisation, known: list[np.ndarray], seed: int
) -> list[Linearisation]:
    """Return the twins with the channels that the recording has beyond theirs, the last ones of its linearisation.

    known: for each channel of the recording quantities (m, q) by which it may go, so that this is no noise.
    """
    flown = twins[0].residual.shape[1]
    if own.residual.shape[1] == flown:
        return twins
    rng, left = np.random.default_rng([seed, 14]), _left(own, flown, known)
    shown = np.flatnonzero(np.any(own.sensitivity[:, :, flown:] != 0, axis=(1, 2)))
    columns, drawn = own.sensitivity[shown, :, flown:], [_drawn(left, rng) for _ in twins]
    return run_in_threads(
        *(partial(_beside, twin, shown, columns, one) for twin, one in zip(twins, drawn, strict=True))
    )


def _left(own: Linearisation, flown: int, known: list[np.ndarray]) -> np.ndarray:
    """Return what effects and quantities leave of the channels from `flown` on, each channel by itself (m, h)."""
    left = own.residual[:, flown:].copy()
    for channel in range(left.shape[1]):
        quantities = np.where(own.good[:, None], known[flown + channel], 0.0).T
        columns = np.concatenate([own.sensitivity[:, :, flown + channel], quantities])
        columns = columns[np.any(columns != 0, axis=1)]
        left[:, channel] -= solve(columns @ columns.T, columns @ left[:, channel]) @ columns
    return left


def _drawn(values, rng) -> np.ndarray:
    spectrum = np.fft.rfft(values, axis=0)
    turn = np.exp(2j * np.pi * rng.random((len(spectrum), 1)))
    return np.fft.irfft(np.concatenate([spectrum[:1], (turn * spectrum)[1:]]), n=len(values), axis=0)


def _beside(twin: Linearisation, shown, columns, residual) -> Linearisation:
    """Return the twin with more channels: residual (m, h) and the columns `shown` (k,) of them (k, m, h), the others
    nothing; cut or continued with nothing."""

    def joined(of_twin, others, places=...):
        rows, flown = min(len(twin.t), len(residual)), of_twin.shape[-1]
        both = np.zeros((*of_twin.shape[:-1], flown + others.shape[-1]))
        both[..., :flown] = of_twin
        both[..., flown:][places, :rows] = np.where(twin.good[:rows, None], others[..., :rows, :], 0.0)
        return both

    residual, columns = joined(twin.residual, residual), joined(twin.sensitivity, columns, shown)
    return replace(twin, residual=residual, sensitivity=columns)


def with_pose_noise(
    seen: NullDistribution,
    table: FlightTable,
    residual_model: ResidualModel,
    own: Linearisation,
    vehicle: Vehicle,
    effects: tuple[Effect, ...],
    noise_m: float,
    seed: int,
) -> NullDistribution:
    """Return the population with what a pose's noise of noise_m makes of VIO's errors by itself: the pose's velocity
    stands on both sides, and in a slow flight its noise looks like ways that VIO takes for shorter (Fuller 1987, errors
    in variables). table, replayer, own: the recording."""
    channels = [c for c, channel in enumerate(residual_model.channels) if channel.layer == "vio"]
    odd = [effect for effect in effects if effect.layer == "vio"]
    if not channels or not odd:
        return seen
    position, rng, low = table["p_world"], np.random.default_rng([seed, 16]), residual_model.filter
    noisy = Samples(position.t, position.values + noise_m * rng.standard_normal(position.values.shape))
    flown = {
        name: samples
        for name, samples in rotor_speed_model.with_modelled_rotor_speeds(table, vehicle).channels.items()
        if name in SYNCHRONOUS_CHANNELS
    }
    p_world = read_recording(FlightTable(table.name, {**flown, "p_world": noisy}), vehicle, simulated=True).p_world
    q = residual_model.recording.q_world_body[low.rows]
    v_world, noise = (
        apply(low.slope, p) for p in (residual_model.recording.p_world, p_world - residual_model.recording.p_world)
    )
    made = np.zeros_like(seen.bias_gradient_by_channel)
    for effect in odd:
        for i, parameter in enumerate(effect.parameters):
            row, step = seen.slices[effect.key].start + i, parameter.step * np.eye(len(effect.parameters))[i]
            idle, moved = (
                sensor_terms(inject(vehicle, effect, file_values(effect, vehicle) + by)) for by in (0.0, step)
            )
            less, more = (
                odometry.velocity(q, v, moved) - odometry.velocity(q, v, idle) for v in (v_world, v_world + noise)
            )
            products = geometry.rotate_inverse(q, more - less) * geometry.rotate_inverse(q, noise)
            made[row, channels] = (
                products[own.good].sum(axis=0) / np.square(seen.sigma[channels]) / seconds_with_data(own)
            )
    sizes = made.sum(axis=1) * seconds_with_data(own) / np.maximum(seen.information, 1e-300)
    return replace(seen, bias_gradient_by_channel=seen.bias_gradient_by_channel + made, bias=seen.bias - sizes)
