"""Package swift_ros: its executables, commands and data files."""

import os
from pathlib import Path

from setuptools import find_packages, setup

NAME = "swift_ros"
HERE = Path(__file__).resolve().parent  # colcon builds through a link to this file
CONFIG = HERE.parent / "config"  # one folder for the whole repository, installed with what flies

NODES = ("betaflight", "camera", "gate_detector", "gate_pose", "mavlink_telemetry", "policy", "race_monitor",
         "recorder", "state_estimator", "vio")


def relative(paths):
    """The files among `paths` from the working directory, as setuptools wants data files."""
    return [os.path.relpath(path) for path in sorted(paths) if path.is_file()]


setup(
    name=NAME,
    version="0.1.0",
    description="What flies: the nodes of the Swift drone-racing graph, from camera to flight controller.",
    maintainer="Swift maintainers",
    maintainer_email="maintainers@swift.example.org",
    license="Proprietary",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", relative([HERE / "resource" / NAME])),
        (f"share/{NAME}", relative([HERE / "package.xml"])),
        (f"share/{NAME}/launch", relative((HERE / "launch").glob("*.py"))),
        *((f"share/{NAME}/config/{folder.relative_to(CONFIG)}", relative(folder.iterdir()))
          for folder in (CONFIG, *sorted(CONFIG.rglob("*"))) if folder.is_dir()),
    ],
    entry_points={
        "console_scripts": [
            "swiftros = swift_ros.cli:main",
            *(f"{name} = swift_ros.nodes.{name}:main" for name in NODES),
        ],
        # each names a function that adds its parser: see swift_ros/cli.py
        "swift.commands": [
            "check = swift_ros.commands.check:command",
            "import = swift_ros.commands.import_recording:command",
            "record = swift_ros.commands.record:command",
            "replay = swift_ros.commands.replay:command",
            "topics = swift_ros.commands.topics:command",
        ],
    },
)
