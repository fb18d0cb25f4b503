"""The policy's 31 observations, shared by training (JAX, batched) and flight (NumPy): what is trained is what flies.

position 3 · velocity 3 · rotation matrix 9 · the next gate's four corners relative to the vehicle 12 · previous
action 4 (Methods, "Observations"). The paper does not publish scales or the corners' frame: ours are the fixed scales
below and the body frame.
"""

from array_api_compat import array_namespace

from swift_ros import geometry

SIZE = 31
POSITION_CENTRE = (2.0, 0.0, 3.0)
POSITION_SCALE = 10.0
VELOCITY_SCALE = 15.0
CORNER_SCALE = 10.0


def observe(p_map, v_map, q_map_body, corners_map, previous_action):
    """Return observations (..., 31).

    p_map (..., 3) m, v_map (..., 3) m/s, q_map_body (..., 4), corners_map (..., 4, 3) m of the next gate,
    previous_action (..., 4) as the actor gave it, clipped to [-1, 1].
    """
    xp = array_namespace(p_map)
    rotation = geometry.rotation_matrix(q_map_body)
    corners_body = geometry.rotate_inverse(q_map_body[..., None, :], corners_map - p_map[..., None, :])
    batch = p_map.shape[:-1]
    return xp.concat(
        [
            (p_map - xp.asarray(POSITION_CENTRE, dtype=p_map.dtype)) / POSITION_SCALE,
            v_map / VELOCITY_SCALE,
            xp.reshape(rotation, (*batch, 9)),
            xp.reshape(corners_body, (*batch, 12)) / CORNER_SCALE,
            previous_action,
        ],
        axis=-1,
    )
