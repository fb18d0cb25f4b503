"""Functions written for JAX as CasADi expressions, so that the limit obeys the physics of the simulator.

JAX lists the primitive operations of a function of scalars (a jaxpr). An operation on a traced scalar is replaced by
its counterpart of CasADi; one on constants is computed.
"""

from collections.abc import Callable, Sequence

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np

UNARY = {
    "abs": ca.fabs,
    "convert_element_type": lambda a: a,
    "copy": lambda a: a,
    "cos": ca.cos,
    "exp": ca.exp,
    "log": ca.log,
    "neg": lambda a: -a,
    "sign": ca.sign,
    "sin": ca.sin,
    "sqrt": ca.sqrt,
    "square": lambda a: a * a,
    "stop_gradient": lambda a: a,
    "tanh": ca.tanh,
}
BINARY = {
    "add": lambda a, b: a + b,
    "add_any": lambda a, b: a + b,
    "and": ca.logic_and,
    "atan2": ca.atan2,
    "div": lambda a, b: a / b,
    "ge": lambda a, b: a >= b,
    "gt": lambda a, b: a > b,
    "le": lambda a, b: a <= b,
    "lt": lambda a, b: a < b,
    "max": ca.fmax,
    "min": ca.fmin,
    "mul": lambda a, b: a * b,
    "or": ca.logic_or,
    "pow": lambda a, b: a**b,
    "sub": lambda a, b: a - b,
}
SHAPES = ("broadcast_in_dim", "reshape", "squeeze")  # leave a scalar what it is


def symbolic(function: Callable, arguments: Sequence) -> list:
    """Return what `function` returns for CasADi scalars.

    Args:
        function: of scalars, written with jax.numpy; returns scalars in a tuple, dict or dataclass of JAX.
        arguments: CasADi scalars (SX).

    Returns:
        The scalars (SX or float) in JAX's order of leaves.

    Raises:
        NotImplementedError: the function has an operation without a counterpart here.
    """
    with jax.enable_x64(True):
        shape = jax.ShapeDtypeStruct((), jnp.result_type(float))
        closed = jax.make_jaxpr(function)(*[shape] * len(arguments))
        return [_scalar(value) for value in _evaluated(closed.jaxpr, closed.consts, arguments)]


def _evaluated(jaxpr, constants, arguments) -> list:
    """Return the outputs of a jaxpr for CasADi scalars and constants."""
    values = dict(zip((*jaxpr.constvars, *jaxpr.invars), (*constants, *arguments), strict=True))

    def read(atom):
        return atom.val if hasattr(atom, "val") else values[atom]

    for equation in jaxpr.eqns:
        results = _applied(equation, [read(atom) for atom in equation.invars])
        values.update(zip(equation.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def _applied(equation, inputs) -> list:
    """Return the results of one equation of a jaxpr."""
    name, parameters = equation.primitive.name, equation.params
    inner = parameters.get("jaxpr") or parameters.get("call_jaxpr")
    if inner is not None:
        return _evaluated(inner.jaxpr, inner.consts, inputs)
    if not any(isinstance(value, ca.SX) for value in inputs):
        results = equation.primitive.bind(*inputs, **parameters)
        return results if equation.primitive.multiple_results else [results]
    if name in SHAPES:
        return inputs
    scalars = [_scalar(value) for value in inputs]
    if name in UNARY:
        return [UNARY[name](*scalars)]
    if name in BINARY:
        return [BINARY[name](*scalars)]
    if name == "integer_pow":
        return [scalars[0] ** parameters["y"]]
    if name == "select_n" and len(scalars) == 3:
        which, if_false, if_true = scalars
        return [ca.if_else(which, if_true, if_false)]
    if name == "clamp":
        low, value, high = scalars
        return [ca.fmin(ca.fmax(value, low), high)]
    raise NotImplementedError(f"the limit cannot compute JAX's operation '{name}'; add its counterpart of CasADi")


def _scalar(value):
    """Return a CasADi scalar unchanged, a constant as float. Raises ValueError for an array."""
    return value if isinstance(value, ca.SX) else float(np.asarray(value).reshape(()))
