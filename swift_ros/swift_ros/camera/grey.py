"""Grey levels of coloured pictures."""

import cv2
import numpy as np

REDNESS = np.array([[-0.5, -0.5, 1.5, 32.0]], np.float32)  # weights of blue, green and red, and the level of black
DARKEST = 1  # level; 0 is outside of the image circle
LEAST_COLOUR = 8  # levels between the channels of a pixel; less comes from the compression of grey pictures


def grey_levels(picture: np.ndarray) -> np.ndarray:
    """Return the grey levels (h, w) uint8 of a picture (h, w) or (h, w, 3) in the order blue, green, red.

    Gates are painted to be seen, and their paint differs from grey surroundings by its colour more than by its
    luminance: orange is as bright as concrete, but redder. So red counts three times as much as neutral grey, and
    green and blue count negatively: warm paints become bright, cold ones dark. A picture of equal channels is grey.
    """
    if picture.ndim == 2:
        return picture
    blue, green, red = cv2.split(picture)
    if max(cv2.norm(one, green, cv2.NORM_INF) for one in (blue, red)) < LEAST_COLOUR:
        return green
    return np.maximum(cv2.transform(picture, REDNESS), DARKEST)
