"""The policy's 31 observations, the same function for training (JAX, batched) and flight (NumPy).

Position 3, velocity 3, rotation matrix 9, the next gate's four corners relative to the vehicle 12, previous action 4
(Methods, "Observations"). The paper does not publish scales and the corners' frame; here they are the constants below
and the body frame.
"""

from array_api_compat import array_namespace

from swift_ros import geometry

SIZE = 31  # entries of an observation
# Offset and scales that bring the observations of the shipped track to the order of one.
POSITION_CENTRE = (2.0, 0.0, 3.0)  # m
POSITION_SCALE = 10.0  # m
VELOCITY_SCALE = 15.0  # m/s
CORNER_SCALE = 10.0  # m


def observe(p_map, v_map, q_map_body, corners_map, previous_action):
    """Return observations (..., 31).

    Args:
        p_map: position (..., 3), m.
        v_map: velocity (..., 3), m/s.
        q_map_body: attitude (..., 4).
        corners_map: corners (..., 4, 3) of the next gate, m.
        previous_action: (..., 4), in [-1, 1].
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
