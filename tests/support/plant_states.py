"""The referee's plant in a known state: its accelerations, and the force that a term adds."""

import jax.numpy as jnp
import numpy as np

from swift_sim_bridge.referee.simulator import plant, vehicles


def content(**more) -> dict:
    """Return a vehicle of the referee without terms, with other entries."""
    return vehicles.draw_vehicle(np.random.default_rng(3), "test") | {"terms": {}} | more


def state(p=(0.0, 0.0, 5.0), v=(0.0, 0.0, 0.0), w=(0.0, 0.0, 0.0), spin=1200.0, q=(0.0, 0.0, 0.0, 1.0)):
    q = np.asarray(q) / np.linalg.norm(q)
    spin = np.broadcast_to(spin, 4)
    lists = [tuple(jnp.asarray(float(x)) for x in row) for row in (p, q, v, w, spin)]
    return plant.State(*lists, jnp.asarray(300.0), jnp.asarray(0.1))


def held(u=0.3):
    nothing = (0.0, 0.0, 0.0)
    return plant.Inputs((u,) * 4, nothing, nothing, nothing, (0.0,) * 4)


def slopes(described: dict, at=None, u=0.3):
    slope, outputs = plant.derivative(at or state(), held(u), plant.plant_of(described))
    return slope, outputs


def more_force(described: dict, entry: dict, at) -> np.ndarray:
    """Return the force (N, body) that terms add at a state."""
    mass = described["mass"]
    return mass * np.subtract(
        slopes(described | {"terms": entry}, at)[1].specific_force, slopes(described, at)[1].specific_force
    )
