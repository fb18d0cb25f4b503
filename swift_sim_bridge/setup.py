"""Package swift_sim_bridge: its executable, commands and data files."""

import os
from pathlib import Path

from setuptools import find_packages, setup

NAME = "swift_sim_bridge"
HERE = Path(__file__).resolve().parent  # colcon builds through a link to this file


def relative(paths):
    """The files among `paths` from the working directory, as setuptools wants data files."""
    return [os.path.relpath(path) for path in sorted(paths) if path.is_file()]


setup(
    name=NAME,
    version="0.1.0",
    description="What a workstation adds to Swift: the simulator, training and evaluation.",
    maintainer="Swift maintainers",
    maintainer_email="maintainers@swift.example.org",
    license="Proprietary",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", relative([HERE / "resource" / NAME])),
        (f"share/{NAME}", relative([HERE / "package.xml"])),
        (f"share/{NAME}/launch", relative((HERE / "launch").glob("*.py"))),
    ],
    entry_points={
        "console_scripts": ["bridge = swift_sim_bridge.nodes.bridge:main"],
        # each names a function that adds its parser: see swift_ros/cli.py
        "swift.commands": [
            "bench = swift_sim_bridge.commands.bench:command",
            "evaluate = swift_sim_bridge.commands.evaluate:command",
            "gap = swift_sim_bridge.commands.gap:command",
            "gap-referee = swift_sim_bridge.commands.gap_referee:command",
            "identify = swift_sim_bridge.commands.identify:command",
            "race = swift_sim_bridge.commands.race:command",
            "sim = swift_sim_bridge.commands.sim:command",
            "train = swift_sim_bridge.commands.train:command",
        ],
    },
)
