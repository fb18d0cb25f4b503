"""Dryden gusts: turbulence as coloured noise, by MIL-F-8785C's low-altitude forms.

    along the wind:  sigma sqrt(2 L / (pi V)) / (1 + L/V s)
    across and up:   sigma sqrt(L / (pi V)) (1 + sqrt(3) L/V s) / (1 + L/V s)^2

with, h in feet, L_w = h, L_u = L_v = h / (0.177 + 0.000823 h)^1.2, sigma_w = 0.1 W20 and sigma_u = sigma_v = sigma_w /
(0.177 + 0.000823 h)^0.4. The field is frozen and passes at one airspeed V and height h, which the vehicle file gives,
so that the filters stay what they are while the vehicle turns, climbs and stops.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from swift_sim_bridge.physics.terms.vectors import Vector

FOOT = 0.3048
LOWEST_M = 10 * FOOT  # below, the standard has no forms
ROOT3 = 3.0**0.5


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Gust:
    """wind_20ft: m/s, mean wind 20 ft up, 2..15 (the standard: light 7.7, moderate 15.4); heading: rad about z, where
    it blows to; height: m, at least 3.05; airspeed: m/s at which the field passes, 5..20."""

    wind_20ft: float
    heading: float = 0.0
    height: float = 3.05
    airspeed: float = 10.0


def scales(coefficients):
    """Return (sigma, L), each of (along, across, up), in m/s and m."""
    height = jnp.maximum(coefficients.height, LOWEST_M)
    profile = 0.177 + 0.000823 * height / FOOT
    along = height / profile**1.2
    sigma_up = 0.1 * coefficients.wind_20ft
    sigma = sigma_up / profile**0.4
    return (sigma, sigma, sigma_up), (along, along, height)


def gust(p_world, coefficients, remembered):
    """Return the gust's velocity (world, m/s); the mean wind is not in it."""
    if not remembered:
        return Vector()
    (sigma_u, sigma_v, sigma_w), _ = scales(coefficients)
    u, v, w = sigma_u * remembered["u"], sigma_v * remembered["v"], sigma_w * remembered["w"]
    cosine, sine = jnp.cos(coefficients.heading), jnp.sin(coefficients.heading)
    return Vector(cosine * u - sine * v, sine * u + cosine * v, w)


def _second_order(first, second):
    """Return the output of (1 + sqrt(3) T s)/(1 + T s)^2 from its two first-order stages in a row."""
    return ROOT3 * first + (1.0 - ROOT3) * second


def start(coefficients, zero, normal, count):
    """Return filters in their stationary state: u, v, w have variance 1; v1, v2, w1, w2 are the stages of v and w."""
    remembered = {"u": normal() + zero}
    for axis in "vw":
        first, fresh = 0.5**0.5 * (normal() + zero), 0.5**0.5 * (normal() + zero)
        second = 0.5 * (first + fresh)
        remembered |= {f"{axis}1": first, f"{axis}2": second, axis: _second_order(first, second)}
    return remembered


def advance(remembered, passed, coefficients, parameters):
    """Return the filters one step on, driven so that their variance is 1 at any step length."""
    _, (length_u, length_v, length_w) = scales(coefficients)
    white_u, *white = passed.random
    keep = jnp.exp(-passed.dt * coefficients.airspeed / length_u)
    moved = {"u": keep * remembered["u"] + jnp.sqrt(1.0 - keep * keep) * white_u}
    for axis, length, drive in zip("vw", (length_v, length_w), white, strict=True):
        moved |= _two_stages(axis, remembered, passed.dt * coefficients.airspeed / length, drive)
    return moved


def _two_stages(axis, remembered, step, white):
    """Return both stages and the output after `step` time constants; the input noise enters the first stage."""
    keep = jnp.exp(-step)
    passing = keep * step
    # Stationary covariances of the two stages per variance of the drive, and with them the output's.
    p11 = 1.0 / (1.0 - keep * keep)
    p12 = keep * passing * p11 * p11
    p22 = (2.0 * keep * passing * p12 + passing * passing * p11) * p11
    variance = 3.0 * p11 + 2.0 * ROOT3 * (1.0 - ROOT3) * p12 + (1.0 - ROOT3) ** 2 * p22
    first = keep * remembered[f"{axis}1"] + white / jnp.sqrt(variance)
    second = keep * remembered[f"{axis}2"] + passing * remembered[f"{axis}1"]
    return {f"{axis}1": first, f"{axis}2": second, axis: _second_order(first, second)}
