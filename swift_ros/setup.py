"""Package swift_ros: its executables, commands and data files."""

import os
import runpy
from glob import glob
from pathlib import Path

from setuptools import setup

NAME = "swift_ros"
HERE = Path(__file__).resolve().parent  # resolved: colcon builds through a symbolic link to this file
CONFIG = HERE.parent / "config"  # configuration of the whole repository, installed with the onboard package
NODES = runpy.run_path(str(HERE / "swift_ros/graph/topic_table.py"))["NODES"].values()
COMMANDS = runpy.run_path(str(HERE / "swift_ros/commands/command_table.py"))["COMMANDS"]


def config_files(folder):
    """Return the files of a configuration folder, relative to the working directory as setuptools requires."""
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
            *(node.entry_point for node in NODES if node.package == NAME),
        ],
        "swift.commands": [command.entry_point for command in COMMANDS if command.package == NAME],
    },
)
