"""The equation of a repaired vehicle file, as documented for the file: the referee's own implementation.

Each summand is coefficient * clip(product, low, high), with the named quantities of docs/vehicle-file.md.
"""

import re

import jax.numpy as jnp

AIR_DENSITY = 1.225  # kg/m^3 at sea level and 15 deg C (ISO 2533)
WRENCH = ("force_x", "force_y", "force_z", "moment_x", "moment_y", "moment_z")
SIDES = (*WRENCH, "rotor_thrust", "rotor_speed", "voltage")


def summands_of(contents) -> dict[str, list[str]]:
    """Return by side the products of quantities in the equations of vehicle files' contents."""
    found: dict[str, list[str]] = {}
    for content in contents:
        for side, products in content.get("terms", {}).get("equation", {}).items():
            if side in SIDES:
                found.setdefault(side, []).extend(one for one in products if one not in found.get(side, []))
    return found


def coefficients_of(content: dict, summands: dict[str, list[str]]) -> dict:
    """Return (coefficient, low, high) of each summand, zero for those that the file lacks."""
    own = content.get("terms", {}).get("equation", {})

    def row(side, product):
        entry = own.get(side, {}).get(product)
        return [entry["coefficient"], *entry["range"]] if entry else [0.0, 0.0, 0.0]

    return {side: {product: row(side, product) for product in products} for side, products in summands.items()}


def wrench(at: dict, equation: dict):
    """Return the equation's force (N) and moment (N m), body.

    Args:
        at: quantities by name, see `quantities`.
        equation: see `coefficients_of`.
    """
    found = {side: 0.0 * at["v_x"] + added(at, equation.get(side, {})) for side in WRENCH}
    return tuple(tuple(found[f"{kind}_{axis}"] for axis in "xyz") for kind in ("force", "moment"))


def added(at: dict, products: dict):
    """Return the sum of one left side's summands.

    Args:
        at: quantities by name, see `quantities`, `of_rotor`, `of_motor` and `of_pack`.
        products: (coefficient, low, high) by product.
    """
    total = 0.0
    for product, (coefficient, low, high) in products.items():
        total = total + coefficient * jnp.clip(_product(product, at), low, high)
    return total


def of_rotor(thrust, spin, v, height, p, radius) -> dict:
    """Return the quantities that the equation of a rotor's thrust may name.

    Args:
        thrust: static thrust, N.
        spin: rad/s.
        v: velocity of the hub through the air, m/s, body.
        height: of the hub, m.
        p: position of the vehicle, m, world.
        radius: m.
    """
    across = jnp.sqrt(v[0] ** 2 + v[1] ** 2 + 1e-12)
    induced = jnp.sqrt(jnp.maximum(thrust, 1e-6) / (2.0 * AIR_DENSITY * jnp.pi * radius**2))
    sink = jnp.clip(-v[2] / induced, 0.0, 2.0)
    return {
        "p": p,
        "thrust": thrust,
        "Omega": spin,
        "v_z": v[2],
        "min(v_z,0)": jnp.minimum(v[2], 0.0),
        "v_xy": across,
        "mu": across / jnp.maximum(spin * radius, 1.0),
        "sink": sink,
        "ring": sink * (2.0 - sink),
        "ground": (0.25 * radius / jnp.maximum(height, 0.5 * radius)) ** 2,
    }


def of_motor(u, voltage, speed, number: int, count: int) -> dict:
    """Return the quantities that the equation of the steady speed of motor `number`, from 1, of `count` may name."""
    own = {f"rotor_{other}": 1.0 if other == number else 0.0 for other in range(1, count + 1)}
    return {"u": u, "sqrt(u)": jnp.sqrt(jnp.maximum(u, 0.0)), "U": voltage, "Omega": speed, **own}


def of_pack(current, charge, speeds) -> dict:
    """Return the quantities that the equation of the voltage may name."""
    return {"current": current, "charge": charge, "Omega^3": sum(speed**3 for speed in speeds)}


def _product(text: str, at: dict):
    """Return a product of quantities."""
    value = 1.0
    for factor in text.split():
        if factor in at:  # as the name Omega^3 of a pack
            value = value * at[factor]
            continue
        name, _, power = factor.partition("^")
        value = value * (1.0 if name == "1" else _value(name, at)) ** int(power or 1)
    return value


def _value(name: str, at: dict):
    """Return a quantity: by its name, over(name,value), around(name,value,reach), or near(x,y,z,radius)."""
    if name in at:
        return at[name]
    if name.startswith("over("):
        inner, _, bend = name[5:-1].rpartition(",")
        return jnp.maximum(_value(inner, at) - float(bend), 0.0)
    if name.startswith("around("):
        inner, center, reach = name[7:-1].rsplit(",", 2)
        apart = (_value(inner, at) - float(center)) / float(reach)
        return jnp.maximum(1.0 - apart**2, 0.0) ** 2
    x, y, z, radius = (float(part) for part in re.findall(r"-?[\d.]+", name))
    p = at["p"]
    apart = (p[0] - x) ** 2 + (p[1] - y) ** 2 + (p[2] - z) ** 2
    return jnp.maximum(1.0 - apart / radius**2, 0.0) ** 2


def quantities(p, axes, v, w, rotors: dict, plant: dict) -> dict:
    """Return the quantities that an equation may name.

    Args:
        p: position, m, world.
        axes: the world's axes x, y and z in the body, (3) vectors.
        v: velocity through the air, m/s, body.
        w: angular velocity, rad/s, body.
        rotors: by name `speed`, `rate` and `spin` of each rotor, rad/s, rad/s^2, and +1 or -1.
        plant: parameters of the vehicle.
    """
    speeds, count = rotors["speed"], len(rotors["speed"])
    thrusts = [plant["lift"][i] * spin**2 for i, spin in enumerate(speeds)]
    thrust, mean = sum(thrusts), sum(speeds) / count
    across = jnp.sqrt(v[0] ** 2 + v[1] ** 2 + 1e-12)
    area = jnp.pi * plant["radius"] ** 2 * count
    sink = jnp.clip(-v[2] / jnp.sqrt(jnp.maximum(thrust, 1e-6) / (2.0 * AIR_DENSITY * area)), 0.0, 2.0)
    height = jnp.maximum(p[2], 0.5 * plant["radius"])
    found = {f"v_{axis}": v[i] for i, axis in enumerate("xyz")}
    found |= {f"|v_{axis}|": jnp.abs(v[i]) for i, axis in enumerate("xyz")}
    found |= {f"omega_{axis}": w[i] for i, axis in enumerate("xyz")}
    found |= {
        f"{name}_{axis}": axes[k][i] for k, name in enumerate(("east", "north", "up")) for i, axis in enumerate("xyz")
    }
    found |= {f"thrust_{i + 1}": one for i, one in enumerate(thrusts)}
    found |= {f"Omega_{i + 1}": one for i, one in enumerate(speeds)}
    return found | {
        "p": p,
        "|v|": jnp.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2 + 1e-12),
        "v_xy": across,
        "min(v_z,0)": jnp.minimum(v[2], 0.0),
        "thrust": thrust,
        "Omega": mean,
        "mu": across / jnp.maximum(mean * plant["radius"], 1.0 / count),
        "spin_Omega": sum(way * one for way, one in zip(rotors["spin"], speeds, strict=True)),
        "spin_Omega'": sum(way * one for way, one in zip(rotors["spin"], rotors["rate"], strict=True)),
        "ground": (0.25 * plant["radius"] / height) ** 2,
        "sink": sink,
        "ring": sink * (2.0 - sink),
    }
