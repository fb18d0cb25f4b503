"""What VIO makes of a velocity, by the simulator's own terms. Pure."""

from swift_sim_bridge.sensors.vio import steady_drift


def velocity(q_world_body, v_world, terms: dict):
    """Return the velocity (n, 3) m/s in the world that VIO tells of a body at q_world_body (n, 4), v_world (n, 3)."""
    told = v_world
    if scale := terms.get("vio_scale"):
        told = (1.0 + scale.scale) * told
    if drift := terms.get("vio_drift"):
        told = told + steady_drift(q_world_body, v_world, drift)
    return told
