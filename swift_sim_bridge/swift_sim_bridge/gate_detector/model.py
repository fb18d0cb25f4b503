"""The gate detector's network and its loss: the U-Net of the paper (six levels, LeakyReLU 0.01).

One convolution a level; max-pooling down; nearest upsampling and concatenated skips up. The twelve outputs are four
corner maps and four two-channel affinity fields, at half the input's resolution: unlike in the paper the last decoder
level is left out, which makes a pass three times cheaper and costs 0.1 px of accuracy. Arrays are NHWC.
"""

import jax
import jax.numpy as jnp
import numpy as np

FILTERS = (8, 16, 16, 16, 32, 32)  # of each level; 16 in the paper's last ones, which see too little of a gate's looks
KERNELS = (3, 3, 3, 5, 7, 7)  # sides of the kernels, as in the paper
OUTPUTS = 12  # 4 corner maps and 4 x 2 affinity fields
CORNERS = 4  # number of corner maps
SLOPE = 0.01  # of LeakyReLU for negative inputs
STRIDE = 2  # input pixels per output pixel, on each axis
BLOCK = 16  # pixels; side of the blocks whose means `normalize` uses
LEAST_LIT = 1e-3  # lit share of the surroundings below which their mean tends to that of the image
WHOLE_SHARE = 0.25  # of the whole image's standard deviation, added to the local one: noise is not amplified
MOST_CONTRAST = 6.0  # standard deviations; a lamp in a dark room has many more
START_BIAS = -4.0  # of the corner maps before the sigmoid: corners are rare, so that maps begin near zero


def layer_shapes() -> dict[str, tuple[int, int, int, int]]:
    """Return name -> (height, width, inputs, outputs) of every convolution, in order of use."""
    shapes, inputs = {}, 1
    for level, (filters, kernel) in enumerate(zip(FILTERS, KERNELS, strict=True)):
        shapes[f"down{level}"] = (kernel, kernel, inputs, filters)
        inputs = filters
    for level in range(len(FILTERS) - 2, 0, -1):
        shapes[f"up{level}"] = (KERNELS[level], KERNELS[level], inputs + FILTERS[level], FILTERS[level])
        inputs = FILTERS[level]
    return shapes | {"out": (1, 1, inputs, OUTPUTS)}


def initial_weights(rng) -> dict:
    """Return random weights {layer: {"kernel", "bias"}}, float32, He-scaled."""
    weights = {}
    for name, shape in layer_shapes().items():
        scale = np.sqrt(2 / np.prod(shape[:3]))
        kernel = scale * rng.standard_normal(shape)
        weights[name] = {"kernel": kernel.astype(np.float32), "bias": np.zeros(shape[3], np.float32)}
    weights["out"]["bias"][:CORNERS] = START_BIAS
    return weights


def normalize(images):
    """Return grey images (n, h, w) as (n, h, w, 1) of local contrast, within +-MOST_CONTRAST; 0 where they are black.

    From each pixel the mean of its surroundings is subtracted. The difference is divided by their standard deviation,
    to which a share of that of the whole image is added. So a faint gate in a dark corner has more of the contrast of a
    painted one in full light. The sides of the images are multiples of BLOCK.
    """
    images = images.astype(jnp.float32)
    lit = (images > 0).astype(jnp.float32)
    count = jnp.sum(lit, axis=(1, 2), keepdims=True) + 1
    offset = (images - jnp.sum(images, axis=(1, 2), keepdims=True) / count) * lit
    deviation = jnp.sqrt(jnp.sum(offset * offset, axis=(1, 2), keepdims=True) / count)
    around_mean, around_deviation = _surroundings(jnp.stack([lit, offset, offset * offset], axis=-1))
    contrast = (offset - around_mean) * lit / (around_deviation + WHOLE_SHARE * deviation + 1)
    return jnp.clip(contrast, -MOST_CONTRAST, MOST_CONTRAST)[..., None]


def _surroundings(moments):
    """Return mean and standard deviation (n, h, w) of 3 x 3 blocks around each pixel, interpolated between blocks.

    Args:
        moments: (n, h, w, 3), 1 where the image is lit, its levels and their squares there.
    """
    n, h, w, _ = moments.shape
    rows, columns = h // BLOCK, w // BLOCK
    blocks = moments.reshape(n, rows, BLOCK, columns, BLOCK, 3).mean(axis=(2, 4))
    padded = jnp.pad(blocks, ((0, 0), (1, 1), (1, 1), (0, 0)))
    around = sum(padded[:, i : i + rows, j : j + columns] for i in range(3) for j in range(3)) / 9
    weight = around[..., 0] + LEAST_LIT
    mean = around[..., 1] / weight
    deviation = jnp.sqrt(jnp.maximum(around[..., 2] / weight - mean * mean, 0.0))
    fine = jax.image.resize(jnp.stack([mean, deviation], axis=-1), (n, h, w, 2), "linear")
    return fine[..., 0], fine[..., 1]


def _convolve(x, layer):
    numbers = ("NHWC", "HWIO", "NHWC")
    return jax.lax.conv_general_dilated(x, layer["kernel"], (1, 1), "SAME", dimension_numbers=numbers) + layer["bias"]


def _activate(x):
    return jnp.where(x > 0, x, SLOPE * x)


def _halve(x):
    """Return the max-pooling by two. On one core its gradient costs a tenth of that of a reduce-window."""
    n, h, w, c = x.shape
    blocks = x.reshape(n, h // 2, 2, w // 2, 2, c)
    rows = jnp.maximum(blocks[:, :, 0], blocks[:, :, 1])
    return jnp.maximum(rows[:, :, :, 0], rows[:, :, :, 1])


def _first_halved(x, layer):
    """Return `_halve(_activate(_convolve(x, layer)))` for one input channel, 2.5 times faster.

    The four pixels of a pooling block are the outputs of one 4 x 4 convolution of stride 2.
    """
    kernel = layer["kernel"]
    shifted = [jnp.pad(kernel, ((a, 1 - a), (b, 1 - b), (0, 0), (0, 0))) for a in (0, 1) for b in (0, 1)]
    kernel = jnp.concatenate(shifted, axis=3)
    numbers = ("NHWC", "HWIO", "NHWC")
    places = jax.lax.conv_general_dilated(x, kernel, (2, 2), ((1, 1), (1, 1)), dimension_numbers=numbers)
    a, b, c, d = jnp.split(places, 4, axis=-1)
    return _activate(jnp.maximum(jnp.maximum(a, b), jnp.maximum(c, d)) + layer["bias"])


def _double(x):
    return jnp.repeat(jnp.repeat(x, 2, axis=1), 2, axis=2)


def network(weights, x):
    """Return (n, h/2, w/2, 12) of normalised images (n, h, w, 1): corner maps before the sigmoid, affinity fields."""
    x = _first_halved(x, weights["down0"])
    skips = [None]  # the decoder does not return to the resolution of the first level
    for level in range(1, len(FILTERS)):
        x = _activate(_convolve(_halve(x) if level > 1 else x, weights[f"down{level}"]))
        skips.append(x)
    for level in range(len(FILTERS) - 2, 0, -1):
        x = _activate(_convolve(jnp.concatenate([_double(x), skips[level]], axis=-1), weights[f"up{level}"]))
    return _convolve(x, weights["out"])


def detect(weights, images):
    """Return (n, h/2, w/2, 12) of grey images (n, h, w): corner maps in 0..1 and affinity fields, as exported."""
    raw = network(weights, normalize(images))
    return jnp.concatenate([jax.nn.sigmoid(raw[..., :CORNERS]), raw[..., CORNERS:]], axis=-1)


def loss(weights, x, target, mask, *, background: float, affinity_weight: float):
    """Return (total, (corner part, affinity part)): quality-focal loss on corners, squared error on fields.

    Args:
        weights: of the network.
        x: (n, h, w, 1), normalised images.
        target: (n, h/2, w/2, 12).
        mask: (n, h/2, w/2, 2), 0 where the corner maps and where the fields are ignored, else 1.
        background: weight of the fields away from edges.
        affinity_weight: of the affinity part.
    """
    raw = network(weights, x)
    logits, corners = raw[..., :CORNERS], target[..., :CORNERS]
    entropy = jnp.maximum(logits, 0) - logits * corners + jnp.log1p(jnp.exp(-jnp.abs(logits)))
    focus = (jax.nn.sigmoid(logits) - corners) ** 2
    corner_loss = jnp.sum(focus * entropy * mask[..., :1]) / (jnp.sum(corners) + 20)
    fields = target[..., CORNERS:].reshape(*target.shape[:3], 4, 2)
    edge = jnp.sum(fields**2, axis=-1) > 0.25
    error = jnp.sum((raw[..., CORNERS:].reshape(fields.shape) - fields) ** 2, axis=-1)
    weight = jnp.where(edge, 1.0, background) * mask[..., 1:]
    affinity_loss = jnp.sum(weight * error) / (jnp.sum(edge * mask[..., 1:]) + 100)
    return corner_loss + affinity_weight * affinity_loss, (corner_loss, affinity_loss)
