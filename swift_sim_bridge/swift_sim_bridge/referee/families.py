"""The families of sealed cases: what each conceals, and the seeds for development, tests and reviews."""

from swift_ros.errors import UsageError
from swift_sim_bridge.referee.effects.laws import BLIND, STRANGE

TEST_SEEDS, REVIEW_SEEDS = range(1_000, 10_000), range(10_000, 1_000_000)  # lower seeds are for development
MULTIPLES = (0.5, 1.0, 2.0, 4.0, 10.0)  # sizes of single effects, relative to the detectable size
FAMILIES = {
    "null": "no effect",
    "null_sheet": "no effect, and a noise sheet that is wrong by a factor of 0.5 or 2",
    "null_pilot": "no effect, flown with other gains than those of the vehicle file",
    "single": "one effect, at 0.5 to 10 times the detectable size",
    "pair": "two effects",
    "triple": "three effects",
    "confusable": "one effect of a confusable group, in a flight that excites all axes",
    "poor": "one effect of a confusable group, in a hover, which shows little",
    "knockout": "one effect, removed from the tool's catalogue",
    "lacking": "one effect, in a recording with missing channels",
    "sheet": "one effect, and a noise sheet that is wrong by a factor of 0.5 or 2",
    "gusty": "one effect, with strong process noise",
    "null_slow": "no effect, in a hover or low over the ground",
    "null_foreign": "no effect, by a foreign logger (see `foreign_logger`); half of the files have small errors",
    "foreign": "one effect, recorded likewise",
    "foreign_pair": "two effects, recorded likewise",
    "strange": "physics that no effect of the tool's catalogue names",
    "null_pose_commands": "no effect, in a recording of pose and motor commands alone",
    "pose_commands": "a cut propeller, a hung weight, a heavier battery or a weaker pack, recorded likewise",
    "far": "a file in which a motor lag, a drag or the pack's resistance is wrong by a factor of 3, 10 or 30",
    "strange_blind": "physics that no effect names, by an author who had not read the tool; each law in turn",
    "strange_race": "the laws of both in turn, in a vehicle that races in the concealed and in the repaired world",
    "null_foreign_pose_commands": "no effect, in a recording of pose and motor commands by a foreign logger",
    "foreign_pose_commands": "one change of `pose_commands`, recorded likewise",
}
CHANGED = "pose_commands", "foreign_pose_commands"  # families with one of `concealment.CHANGES`
STRANGE_FAMILIES = ("strange", "strange_blind", "strange_race")
CONFUSABLE = (
    ("mass", "thrust_coefficient", "accel_scale"),
    ("motor_time_constant", "command_latency", "time_offset"),
    ("rotor_drag", "linear_drag", "body_drag"),
    ("wind", "accel_bias", "thrust_axis_tilt", "com_offset"),
    ("com_offset", "damaged_propeller", "payload"),
    ("imu_lever_arm", "marker_offset", "accel_bias", "lift_cross"),
    ("axial_inflow", "body_drag", "vortex_ring", "translational_lift"),
    ("inertia", "thrust_coefficient", "motor_time_constant"),
    ("rate_scale", "gyro_scale", "gyro_bias"),
    ("dropped_commands", "command_latency"),
)  # groups of effects with similar residuals


def check_seed(seed: int, review: bool) -> None:
    """Raise UsageError if a seed is out of range, or reserved for reviews and `review` is false."""
    if seed < 0 or seed >= REVIEW_SEEDS.stop:
        raise UsageError(f"the seed {seed} is not from 0 to {REVIEW_SEEDS.stop - 1}")
    if seed >= REVIEW_SEEDS.start and not review:
        raise UsageError(
            f"the seed {seed} is kept for reviews; use 0 to 999 to develop, 1000 to 9999 to test, or give --review"
        )


def draw_effects(family: str, seed: int, rng, known) -> list[tuple[str, float]]:
    """Return the hidden effects of a family and their sizes relative to the detectable size; 0: drawn later.

    Args:
        family: key of FAMILIES.
        seed: seed of the case.
        rng: generator of the case.
        known: the effects of which the hidden ones are drawn.
    """
    if family.startswith("null") or family in (*CHANGED, "far"):
        return []
    if family in ("confusable", "poor"):
        groups = [[name for name in group if name in known] for group in CONFUSABLE]
        groups = [group for group in groups if len(group) > 1]
        group = groups[rng.integers(len(groups))]
        return [(str(rng.choice(group)), float(rng.choice([3.0, 6.0, 10.0])))]
    if family in ("pair", "triple", "foreign_pair"):
        count = 3 if family == "triple" else 2
        names = [str(name) for name in rng.choice(known, count, replace=False)]
        return [(name, float(rng.choice([3.0, 6.0, 10.0]))) for name in names]
    if family in STRANGE_FAMILIES:
        return [_strange_law(family, seed, rng)]
    factor = 0.0 if family == "single" else float(rng.choice([3.0, 6.0, 10.0]))
    return [(str(rng.choice(known)), factor)]


def _strange_law(family: str, seed: int, rng) -> tuple[str, float]:
    """Return a law of physics without a name, and its size relative to the detectable size."""
    if family == "strange":
        law = str(rng.choice(list(STRANGE)))
    else:
        laws = tuple(BLIND) if family == "strange_blind" else (*STRANGE, *BLIND)
        law = laws[seed % len(laws)]
    if law in BLIND:
        return law, BLIND[law].largest / BLIND[law].detectable
    return law, float(rng.choice([3.0, 6.0, 10.0]))
