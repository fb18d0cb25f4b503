"""Package swift_ros: its executables, commands and data files."""

import os
from glob import glob
from pathlib import Path

from setuptools import setup

HERE = Path(__file__).resolve().parent  # colcon builds through a link to this file
CONFIG = HERE.parent / "config"  # one folder for the whole repository, installed with what flies

NODES = (
    "betaflight",
    "camera",
    "gate_detector",
    "gate_pose",
    "mavlink_telemetry",
    "policy",
    "race_monitor",
    "recorder",
    "state_estimator",
    "vio",
)


def config_files(folder):
    """The files of a folder of the configuration from the working directory, as setuptools wants data files."""
    return [os.path.relpath(path) for path in sorted(folder.iterdir()) if path.is_file()]


setup(
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/swift_ros"]),
        ("share/swift_ros", ["package.xml"]),
        ("share/swift_ros/launch", sorted(glob("launch/*.py"))),
        *(
            (f"share/swift_ros/config/{folder.relative_to(CONFIG)}", config_files(folder))
            for folder in (CONFIG, *sorted(CONFIG.rglob("*")))
            if folder.is_dir()
        ),
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
