"""What the air does to body and rotors sideways: drags, lift, and the grey-box polynomial (Methods, eq. 5)."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from swift_sim_bridge.physics.terms.vectors import ZERO, Vector, add, cross, parts, scale, total, vector


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RotorDrag:
    """k_d: N/(rad/s m/s) a rotor, 2e-5..9e-5: induced (blade) drag."""

    k_d: float


def rotor_drag(instant, coefficients):
    """Return forces F_i = -k_d Omega_i v_i in the rotors' plane, v_i the velocity of hub i through the air.

    Source: the usual first-order blade model (Martin and Salaun 2010), here at each hub, so that it damps yaw as well.
    """
    drags = (-coefficients.k_d * speed for speed in instant.rotor_speed)
    return tuple(Vector(drag * v.x, drag * v.y) for drag, v in zip(drags, instant.hub_velocity, strict=True))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LinearDrag:
    """c: (3,) N/(m/s) along the body's axes, 0..0.5."""

    c: tuple[float, float, float]


def linear_drag(instant, coefficients, parameters):
    """Return the wrench of F = -c v along each body axis, acting at the centre of mass."""
    return Vector(*(-c * v for c, v in zip(parts(coefficients.c), instant.v_body, strict=True))), ZERO


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class BodyDrag:
    """c: (3,) N/(m/s)^2 along the body's axes, 0.004..0.02."""

    c: tuple[float, float, float]


def body_drag(instant, coefficients, parameters):
    """Return the wrench of F = -c |v| v along each body axis, acting at the centre of mass."""
    force = (-c * instant.airspeed * v for c, v in zip(parts(coefficients.c), instant.v_body, strict=True))
    return Vector(*force), ZERO


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DragCenter:
    """position: (3,) m from the centre of mass, 2..15 mm: where `linear_drag` and `body_drag` act."""

    position: tuple[float, float, float]


DRAGS = {"linear_drag": linear_drag, "body_drag": body_drag}


def drag_center(instant, coefficients, parameters):
    """Return the wrench that moves the body's drags from the centre of mass to their centre: the moment r x F alone."""
    force = ZERO
    for name, drag in DRAGS.items():
        if name in parameters.terms:
            force = add(force, drag(instant, parameters.terms[name], parameters)[0])
    return ZERO, cross(vector(coefficients.position), force)


def has_drag(coefficients, vehicle):
    """Raise ValueError when the vehicle has no drag whose centre could lie anywhere."""
    if not set(DRAGS) & set(vehicle.terms):
        raise ValueError(f"moves the body's drag, which needs {' or '.join(DRAGS)} beside it")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LiftCross:
    """a, b: N/(m/s)^2, 0.003..0.03: lift of the body in oblique flow."""

    a: float = 0.0
    b: float = 0.0


def lift_cross(instant, coefficients, parameters):
    """Return the wrench of F_x = a v_x v_z, F_y = a v_y v_z, F_z = b |v_xy| v_z."""
    v = instant.v_body
    along = coefficients.a * v.z
    return Vector(along * v.x, along * v.y, coefficients.b * instant.lateral * v.z), ZERO


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FlappingMoment:
    """k_f: N m/(rad/s m/s) a rotor, 1e-7..3e-6: blades that flap tilt the rotor's plane against the hub's springs."""

    k_f: float


def flapping_moment(instant, coefficients, parameters):
    """Return the wrench of tau_i = k_f Omega_i (v_iy, -v_ix, 0), v_i the velocity of hub i through the air."""
    pairs = list(zip(instant.rotor_speed, instant.hub_velocity, strict=True))
    across_x = total(speed * v.x for speed, v in pairs)
    across_y = total(speed * v.y for speed, v in pairs)
    return ZERO, scale(coefficients.k_f, Vector(across_y, -across_x))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class AerodynamicPolynomial:
    """One coefficient a summand of eq. 5, with m = mean squared rotor speed (rad^2/s^2), v in m/s, N and N m:

    f_x (4,): v_x, v_x |v_x|, m, v_x m; f_y (4,): alike in v_y;
    f_z (7,): v_z, v_z |v_z|, v_xy, v_xy^2, v_xy m, v_z m, v_xy v_z m, with v_xy the speed across the body's z axis;
    tau_x (5,): v_y, v_y |v_y|, m, v_y m, v_y |v_y| m; tau_y (5,): alike in v_x; tau_z (2,): v_x, v_y.
    None is published; drag-like summands are negative.
    """

    f_x: tuple[float, float, float, float] = (0.0,) * 4
    f_y: tuple[float, float, float, float] = (0.0,) * 4
    f_z: tuple[float, float, float, float, float, float, float] = (0.0,) * 7
    tau_x: tuple[float, float, float, float, float] = (0.0,) * 5
    tau_y: tuple[float, float, float, float, float] = (0.0,) * 5
    tau_z: tuple[float, float] = (0.0,) * 2


def aerodynamic_polynomial(instant, coefficients, parameters):
    """Return the wrench of the paper's grey-box polynomial (Methods, eq. 5) in body velocity and mean squared speed."""
    v, m = instant.v_body, instant.mean_squared_speed
    fx, fy, fz = (parts(c) for c in (coefficients.f_x, coefficients.f_y, coefficients.f_z))
    tx, ty, tz = (parts(c) for c in (coefficients.tau_x, coefficients.tau_y, coefficients.tau_z))
    size_x, size_y, lateral = jnp.abs(v.x), jnp.abs(v.y), instant.lateral
    force = Vector(
        v.x * (fx[0] + fx[1] * size_x + fx[3] * m) + fx[2] * m,
        v.y * (fy[0] + fy[1] * size_y + fy[3] * m) + fy[2] * m,
        v.z * (fz[0] + fz[1] * jnp.abs(v.z) + (fz[5] + fz[6] * lateral) * m)
        + lateral * (fz[2] + fz[4] * m)
        + fz[3] * instant.lateral_squared,
    )
    moment = Vector(
        v.y * (tx[0] + tx[3] * m + size_y * (tx[1] + tx[4] * m)) + tx[2] * m,
        v.x * (ty[0] + ty[3] * m + size_x * (ty[1] + ty[4] * m)) + ty[2] * m,
        tz[0] * v.x + tz[1] * v.y,
    )
    return force, moment
