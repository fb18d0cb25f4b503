"""Lateral aerodynamic forces on body and rotors: drag, lift and the grey-box polynomial (Methods, eq. 5)."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from swift_sim_bridge.effects import FORCE_CHANNELS, Effect, scalar_parameter, vector_parameters
from swift_sim_bridge.physics.terms.term import Term
from swift_sim_bridge.physics.terms.vectors import ZERO, Vector, add, cross, parts, scale, total, vector


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RotorDrag:
    """Induced (blade) drag of each rotor.

    Attributes:
        k_d: N/(rad/s m/s) for each rotor, 2e-5 to 9e-5.
    """

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
    """Drag proportional to the airspeed.

    Attributes:
        c: (3,) N/(m/s) along the body axes, 0 to 0.5.
    """

    c: tuple[float, float, float]


def linear_drag(instant, coefficients, parameters):
    """Return the wrench of F = -c v along each body axis, acting at the centre of mass."""
    return Vector(*(-c * v for c, v in zip(parts(coefficients.c), instant.v_body, strict=True))), ZERO


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class BodyDrag:
    """Drag proportional to the square of the airspeed.

    Attributes:
        c: (3,) N/(m/s)^2 along the body axes, 0.004 to 0.02.
    """

    c: tuple[float, float, float]


def body_drag(instant, coefficients, parameters):
    """Return the wrench of F = -c |v| v along each body axis, acting at the centre of mass."""
    force = (-c * instant.airspeed * v for c, v in zip(parts(coefficients.c), instant.v_body, strict=True))
    return Vector(*force), ZERO


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DragCenter:
    """Point at which `linear_drag` and `body_drag` act.

    Attributes:
        position: (3,) m from the centre of mass, 2 to 15 mm.
    """

    position: tuple[float, float, float]


BODY_DRAGS = {"linear_drag": linear_drag, "body_drag": body_drag}  # the drags that act at the drag centre


def drag_center(instant, coefficients, parameters):
    """Return the wrench that moves the body's drags from the centre of mass to their centre: the moment r x F alone."""
    force = ZERO
    for name, drag in BODY_DRAGS.items():
        if name in parameters.terms:
            force = add(force, drag(instant, parameters.terms[name], parameters)[0])
    return ZERO, cross(vector(coefficients.position), force)


def has_body_drag(coefficients, vehicle):
    """Raise ValueError when the vehicle has no drag that could act at a drag centre."""
    if not set(BODY_DRAGS) & set(vehicle.terms):
        raise ValueError(f"moves the body's drag, which needs {' or '.join(BODY_DRAGS)} beside it")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LiftCross:
    """Lift of the body in oblique flow.

    Attributes:
        a: N/(m/s)^2, lateral force, 0.003 to 0.03.
        b: N/(m/s)^2, vertical force, 0.003 to 0.03.
    """

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
    """Moment of flapping blades, which tilt the rotor's plane against the stiffness of the hub.

    Attributes:
        k_f: N m/(rad/s m/s) for each rotor, 1e-7 to 3e-6.
    """

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
    """Grey-box polynomial of the Methods, eq. 5: one coefficient for each summand, in N and N m.

    m is the mean squared rotor speed (rad^2/s^2), v in m/s, v_xy the speed across the body's z axis. The paper does not
    publish the coefficients; those of drag-like summands are negative.

    Attributes:
        f_x: (4,) of v_x, v_x |v_x|, m, v_x m.
        f_y: (4,) of v_y, v_y |v_y|, m, v_y m.
        f_z: (7,) of v_z, v_z |v_z|, v_xy, v_xy^2, v_xy m, v_z m, v_xy v_z m.
        tau_x: (5,) of v_y, v_y |v_y|, m, v_y m, v_y |v_y| m.
        tau_y: (5,) of v_x, v_x |v_x|, m, v_x m, v_x |v_x| m.
        tau_z: (2,) of v_x, v_y.
    """

    f_x: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    f_y: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    f_z: tuple[float, float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    tau_x: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    tau_y: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    tau_z: tuple[float, float] = (0.0, 0.0)


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


LATERAL_FORCE_UNITS = ("N/(m/s)", "N/(m/s)^2", "N/(rad/s)^2", "N/(m/s (rad/s)^2)")
LATERAL_MOMENT_UNITS = (
    "N m/(m/s)",
    "N m/(m/s)^2",
    "N m/(rad/s)^2",
    "N m/(m/s (rad/s)^2)",
    "N m/((m/s)^2 (rad/s)^2)",
)
POLYNOMIAL_UNITS = {
    "f_x": LATERAL_FORCE_UNITS,
    "f_y": LATERAL_FORCE_UNITS,
    "f_z": (
        "N/(m/s)",
        "N/(m/s)^2",
        "N/(m/s)",
        "N/(m/s)^2",
        "N/(m/s (rad/s)^2)",
        "N/(m/s (rad/s)^2)",
        "N/((m/s)^2 (rad/s)^2)",
    ),
    "tau_x": LATERAL_MOMENT_UNITS,
    "tau_y": LATERAL_MOMENT_UNITS,
    "tau_z": ("N m/(m/s)", "N m/(m/s)"),
}

TERMS = {
    "rotor_drag": Term(
        RotorDrag,
        hubs=rotor_drag,
        idle={"k_d": 0.0},
        example={"k_d": 6e-5},
        effects=(
            Effect(
                id="rotor_drag",
                layer="force",
                parameters=(scalar_parameter("k_d", "N/(rad/s m/s)", "rotor_drag", step=1e-6, low=0.0, high=1e-3),),
                equation="F_i,xy = -k_d Omega_i v_i,xy",
                sentence="the rotors drag by {k_d:.3g} N/(rad/s m/s) each",
                manoeuvre="one speed at two thrusts: straight and in a tight turn",
                channels=FORCE_CHANNELS,
            ),
        ),
    ),
    "linear_drag": Term(
        LinearDrag,
        wrench=linear_drag,
        idle={"c": [0.0, 0.0, 0.0]},
        example={"c": [0.2, 0.3, 0.1]},
        effects=(
            Effect(
                id="linear_drag",
                layer="force",
                parameters=vector_parameters("c", "N/(m/s)", "linear_drag", step=2e-3, bounds=(0.0, 3.0)),
                equation="F = -c v",
                sentence="the body drags by {values} N/(m/s)",
                manoeuvre="straight passes both ways at three speeds",
                channels=FORCE_CHANNELS,
            ),
        ),
    ),
    "body_drag": Term(
        BodyDrag,
        wrench=body_drag,
        idle={"c": [0.0, 0.0, 0.0]},
        example={"c": [0.02, 0.03, 0.04]},
        effects=(
            Effect(
                id="body_drag",
                layer="force",
                parameters=vector_parameters("c", "N/(m/s)^2", "body_drag", step=3e-4, bounds=(0.0, 0.3)),
                equation="F = -c |v| v",
                sentence="the body drags by {values} N/(m/s)^2",
                manoeuvre="straight passes at three speeds",
                channels=FORCE_CHANNELS,
            ),
        ),
    ),
    "drag_center": Term(
        DragCenter,
        wrench=drag_center,
        check=has_body_drag,
        idle={"position": [0.0, 0.0, 0.0]},
        example={"position": [0.004, -0.006, 0.01]},
        effects=(
            Effect(
                id="drag_center",
                layer="moment",
                parameters=vector_parameters("position", "m", "drag_center", step=1e-3, bounds=(-0.2, 0.2)),
                equation="tau = r x F_drag",
                sentence="the body's drag acts at {values} m",
                manoeuvre="straight passes at three speeds",
                channels=FORCE_CHANNELS,
                requires=tuple(BODY_DRAGS),
            ),
        ),
    ),
    "lift_cross": Term(
        LiftCross,
        wrench=lift_cross,
        idle={"a": 0.0, "b": 0.0},
        example={"a": 0.01, "b": -0.02},
        effects=(
            Effect(
                id="lift_cross",
                layer="force",
                parameters=tuple(
                    scalar_parameter(name, "N/(m/s)^2", "lift_cross", step=5e-4, low=-0.2, high=0.2)
                    for name in ("a", "b")
                ),
                equation="F_x,y = a v_x,y v_z, F_z = b |v_xy| v_z",
                sentence="oblique flow lifts the body: a = {a:.3g}, b = {b:.3g} N/(m/s)^2",
                manoeuvre="dives and pull-ups, both ways",
                channels=FORCE_CHANNELS,
            ),
        ),
    ),
    "flapping_moment": Term(
        FlappingMoment,
        wrench=flapping_moment,
        idle={"k_f": 0.0},
        example={"k_f": 1e-6},
        effects=(
            Effect(
                id="flapping_moment",
                layer="moment",
                parameters=(
                    scalar_parameter("k_f", "N m/(rad/s m/s)", "flapping_moment", step=5e-8, low=-1e-4, high=1e-4),
                ),
                equation="tau_i = k_f Omega_i (v_i,y, -v_i,x, 0)",
                sentence="blade flapping gives a moment of {k_f:.3g} N m/(rad/s m/s) for each rotor",
                manoeuvre="passes forwards, backwards and sideways",
                channels=FORCE_CHANNELS,
            ),
        ),
    ),
    "aerodynamic_polynomial": Term(
        AerodynamicPolynomial,
        wrench=aerodynamic_polynomial,
        idle={},
        example={
            "f_x": [-0.1, -0.01, 1e-8, -6e-8],
            "f_y": [-0.1, -0.01, -1e-8, -7e-8],
            "f_z": [-0.1, -0.02, 0.05, 0.01, 2e-8, -9e-8, 5e-9],
            "tau_x": [0.002, 1e-4, 1e-9, 2e-9, 1e-10],
            "tau_y": [-0.002, 1e-4, -1e-9, 3e-9, 1e-10],
            "tau_z": [1e-4, -2e-4],
        },
        units=POLYNOMIAL_UNITS,
    ),
}
