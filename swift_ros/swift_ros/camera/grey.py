"""Grey levels of coloured pictures."""

import numpy as np


def grey_levels(picture: np.ndarray) -> np.ndarray:
    """Return the grey levels (h, w) of a picture (h, w) or (h, w, 3): the brightest of its three channels.

    Gates are painted to be seen, and their paint differs from grey surroundings by its colour more than by its
    luminance: orange is as bright as concrete, but its red is brighter.
    """
    if picture.ndim == 2:
        return picture
    return np.maximum(np.maximum(picture[..., 0], picture[..., 1]), picture[..., 2])
