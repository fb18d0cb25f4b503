"""Dryden gusts: turbulence as coloured noise, low-altitude forms of MIL-F-8785C.

    along the wind:  sigma sqrt(2 L / (pi V)) / (1 + L/V s)
    across and up:   sigma sqrt(L / (pi V)) (1 + sqrt(3) L/V s) / (1 + L/V s)^2

with h in feet: L_w = h, L_u = L_v = h / (0.177 + 0.000823 h)^1.2, sigma_w = 0.1 W20 and sigma_u = sigma_v = sigma_w /
(0.177 + 0.000823 h)^0.4. The field is frozen. Airspeed V and height h are constants of the vehicle file, so that the
filters do not change while the vehicle turns, climbs and stops.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from swift_sim_bridge.effects import FORCE_CHANNELS, Effect, scalar_parameter
from swift_sim_bridge.physics.terms.air import DRAGS
from swift_sim_bridge.physics.terms.term import Term
from swift_sim_bridge.physics.terms.vectors import Vector

FOOT_M = 0.3048  # m, international foot
MIN_HEIGHT_M = 10 * FOOT_M  # lowest height for which the standard gives forms
ROOT3 = 3.0**0.5


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Gust:
    """Dryden turbulence.

    Attributes:
        wind_20ft: m/s, mean wind 20 ft above ground, 2 to 15 (the standard: light 7.7, moderate 15.4).
        heading: rad about z, direction towards which the wind blows.
        height: m, at least 3.05.
        airspeed: m/s at which the field passes the vehicle, 5 to 20.
    """

    wind_20ft: float
    heading: float = 0.0
    height: float = 3.05
    airspeed: float = 10.0


def scales(coefficients):
    """Return (sigma, L), each of (along, across, up), in m/s and m."""
    height = jnp.maximum(coefficients.height, MIN_HEIGHT_M)
    profile = 0.177 + 0.000823 * height / FOOT_M
    along = height / profile**1.2
    sigma_up = 0.1 * coefficients.wind_20ft
    sigma = sigma_up / profile**0.4
    return (sigma, sigma, sigma_up), (along, along, height)


def gust(p_world, coefficients, memory):
    """Return the gust's velocity (world, m/s) without the mean wind."""
    if not memory:
        return Vector()
    (sigma_u, sigma_v, sigma_w), _ = scales(coefficients)
    u, v, w = sigma_u * memory["u"], sigma_v * memory["v"], sigma_w * memory["w"]
    cosine, sine = jnp.cos(coefficients.heading), jnp.sin(coefficients.heading)
    return Vector(cosine * u - sine * v, sine * u + cosine * v, w)


def _second_order(first, second):
    """Return the output of (1 + sqrt(3) T s)/(1 + T s)^2 from its two first-order stages in a row."""
    return ROOT3 * first + (1.0 - ROOT3) * second


def start(coefficients, zero, normal, count):
    """Return the filters in their stationary state: u, v, w of variance 1, and the two stages of v and of w."""
    memory = {"u": normal() + zero}
    for axis in "vw":
        first, fresh = 0.5**0.5 * (normal() + zero), 0.5**0.5 * (normal() + zero)
        second = 0.5 * (first + fresh)
        memory |= {f"{axis}1": first, f"{axis}2": second, axis: _second_order(first, second)}
    return memory


def advance(memory, step, coefficients, parameters):
    """Return the filters after a step; the variance of their outputs is 1 at any step length."""
    _, (length_u, length_v, length_w) = scales(coefficients)
    white_u, *white = step.random
    keep = jnp.exp(-step.dt * coefficients.airspeed / length_u)
    moved = {"u": keep * memory["u"] + jnp.sqrt(1.0 - keep * keep) * white_u}
    for axis, length, drive in zip("vw", (length_v, length_w), white, strict=True):
        moved |= _two_stages(axis, memory, step.dt * coefficients.airspeed / length, drive)
    return moved


def _two_stages(axis, memory, time, white):
    """Return both stages and the output after `time` time constants; the input noise enters the first stage."""
    keep = jnp.exp(-time)
    passing = keep * time
    # Stationary covariances of the two stages per variance of the drive, and with them the output's.
    p11 = 1.0 / (1.0 - keep * keep)
    p12 = keep * passing * p11 * p11
    p22 = (2.0 * keep * passing * p12 + passing * passing * p11) * p11
    variance = 3.0 * p11 + 2.0 * ROOT3 * (1.0 - ROOT3) * p12 + (1.0 - ROOT3) ** 2 * p22
    first = keep * memory[f"{axis}1"] + white / jnp.sqrt(variance)
    second = keep * memory[f"{axis}2"] + passing * memory[f"{axis}1"]
    return {f"{axis}1": first, f"{axis}2": second, axis: _second_order(first, second)}


TERMS = {
    "gust": Term(
        Gust,
        air=gust,
        start=start,
        advance=advance,
        randoms=lambda count: 3,
        idle={"wind_20ft": 0.0},
        example={"wind_20ft": 3.0},
        effects=(
            Effect(
                id="gust",
                layer="force",
                parameters=(scalar_parameter("wind_20ft", "m/s", "gust", step=0.1, low=0.0, high=60.0),),
                equation="v_air = Dryden's noise (MIL-F-8785C) at this mean wind",
                sentence="gusts blow as at a mean wind of {wind_20ft:.3g} m/s",
                manoeuvre="hover at one place for a minute",
                channels=FORCE_CHANNELS,
                requires=DRAGS,
                own_search=True,
            ),
        ),
        units={"heading": "rad", "height": "m", "airspeed": "m/s"},
    ),
}
