"""The settings of composites: which gates, scenes and exposures are drawn."""

from dataclasses import dataclass

from swift_ros.configuration import refuse_falling, refuse_outside, within

FAMILIES = ("bars", "banner", "pipe", "truss", "cloth", "led", "checkered", "brackets")
SCENES = ("hall", "outdoors", "dark", "underwater", "plain")
RANGES = ("gates", "side", "side_share", "bar", "clutter", "light", "gamma", "vignetting", "noise", "jpeg_quality")


@dataclass(frozen=True)
class CompositeLooks:
    """What composites look like. Pairs are (lowest, highest) of a uniform draw.

    Attributes:
        families: of gates, from FAMILIES, drawn with equal shares.
        scenes: procedural surroundings, from SCENES.
        photograph_share: of the images that have a photograph as background, where photographs are given.
        own_gate_share: of the gates that show a picture of an own gate, where such pictures are given.
        negative_share: of the images that show no gate.
        gates: number of gates in the other images.
        side: m, of an opening.
        side_share: side of an opening in the image, in shorter sides of the image; the logarithm is uniform.
        bar: width of a bar in sides of the opening.
        stacked_share: of the gates that have two openings, one above the other.
        thick_share: of the gates with sides that are seen obliquely.
        lit_share: of the gates with lamps, besides those of the family `led`.
        most_oblique_deg: between the line of sight and the gate's normal.
        tilt_deg: standard deviation of a gate's roll; its pitch has as much.
        clutter: number of other objects.
        near_gate_share: of these that resemble gates: frames without a side, triangles, circles, closed panels.
        before_share: of the other objects that stand before a gate.
        hand_held_share: of the images with a camera that is held almost level.
        elevation_deg, roll_deg: standard deviations of the attitude of a racing camera.
        backlit_share: of the gates that are darker than their surroundings.
        light: mean brightness of the image, 0..1.
        gamma: of the image.
        vignetting: share of light that is lost in the corners.
        flare_share: of the images with a sun or lamp in view that glares.
        motion_px: standard deviation of the motion in the middle of the image during the exposure.
        rolling_px: the same between the readout of the first and of the last row.
        defocus_px: largest standard deviation of the defocus.
        noise: standard deviation at middle brightness, grey levels.
        jpeg_share, jpeg_quality: images that were compressed, and how.
        sharpened_share: of the images with halos of a sharpening.
        reduced_share: of the images that are enlarged from a lower resolution.
        least_contrast: grey levels between frame and opening below which a corner is ignored.
    """

    families: tuple[str, ...]
    scenes: tuple[str, ...]
    photograph_share: float = within(0.0, 1.0)
    own_gate_share: float = within(0.0, 1.0)
    negative_share: float = within(0.0, 1.0)
    gates: tuple[int, int] = within(1, 20)
    side: tuple[float, float] = within(0.1, 20.0)
    side_share: tuple[float, float] = within(0.005, 2.0)
    bar: tuple[float, float] = within(0.01, 2.0)
    stacked_share: float = within(0.0, 1.0)
    thick_share: float = within(0.0, 1.0)
    lit_share: float = within(0.0, 1.0)
    most_oblique_deg: float = within(0.0, 85.0)
    tilt_deg: float = within(0.0, 20.0)
    clutter: tuple[int, int] = within(0, 100)
    near_gate_share: float = within(0.0, 1.0)
    before_share: float = within(0.0, 1.0)
    hand_held_share: float = within(0.0, 1.0)
    elevation_deg: float = within(0.0, 60.0)
    roll_deg: float = within(0.0, 90.0)
    backlit_share: float = within(0.0, 1.0)
    light: tuple[float, float] = within(0.01, 1.0)
    gamma: tuple[float, float] = within(0.1, 5.0)
    vignetting: tuple[float, float] = within(0.0, 1.0)
    flare_share: float = within(0.0, 1.0)
    motion_px: float = within(0.0, 50.0)
    rolling_px: float = within(0.0, 50.0)
    defocus_px: float = within(0.0, 10.0)
    noise: tuple[float, float] = within(0.0, 100.0)
    jpeg_share: float = within(0.0, 1.0)
    jpeg_quality: tuple[int, int] = within(1, 100)
    sharpened_share: float = within(0.0, 1.0)
    reduced_share: float = within(0.0, 1.0)
    least_contrast: float = within(0.0, 255.0)

    def __post_init__(self):
        for key, names, options in (("families", self.families, FAMILIES), ("scenes", self.scenes, SCENES)):
            if not names:
                raise ValueError(f"'{key}' names none; list one or more of {', '.join(options)}")
            for name in names:
                refuse_outside(options, **{key: name})
        refuse_falling(**{name: getattr(self, name) for name in RANGES})
