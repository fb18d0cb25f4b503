"""The workspace: package descriptions, messages, the command line and the set-up script."""

import ast
import importlib.util
import json
import re
import subprocess
import sys
import textwrap
import xml.etree.ElementTree as ElementTree
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message

import swift_msgs.msg
from swift_ros import cli
from swift_ros.commands.command_table import COMMANDS
from swift_ros.graph.topic_table import NODES
from swift_ros.messages.serialization import deserialize

# Packages that Debian names otherwise than Python; others without a ROS package come from pyproject.toml.
MODULES = {"mcap-ros2-support": "mcap_ros2"}  # modules of packages that have another name
DEBIAN = {"PIL": "python3-pil", "cv2": "python3-opencv", "yaml": "python3-yaml"} | {
    name: f"python3-{name}" for name in ("h5py", "matplotlib", "numpy", "scipy")
}
OPTIONAL = {"crazyflow", "l2f", "pyrealsense2", "rerun", "rerun_cli"}  # used where a user has installed them
MESSAGES = sorted(name for name in dir(swift_msgs.msg) if name[0].isupper())


# Descriptions


@pytest.mark.parametrize("package", ["swift_msgs", "swift_ros", "swift_sim_bridge"])
def test_package_description_is_well_formed(repository, package):
    root = ElementTree.parse(repository / package / "package.xml").getroot()
    assert root.findtext("name") == package
    assert root.get("format") == "3"
    assert "@" in root.find("maintainer").get("email")
    expected = "ament_cmake" if package == "swift_msgs" else "ament_python"
    assert root.findtext("export/build_type") == expected


@pytest.mark.parametrize("package", ["swift_ros", "swift_sim_bridge"])
def test_setup_py_and_package_xml_agree(repository, package):
    setup = subprocess.run(
        [sys.executable, "setup.py", "--name", "--version", "--description"],
        cwd=repository / package,
        capture_output=True,
        text=True,
        check=True,
    )
    root = ElementTree.parse(repository / package / "package.xml").getroot()
    assert setup.stdout.splitlines()[-3:] == [root.findtext(key) for key in ("name", "version", "description")]


@pytest.mark.parametrize("package", ["swift_ros", "swift_sim_bridge"])
def test_package_xml_names_what_the_package_imports(repository, package):
    files = [*(repository / package / package).rglob("*.py"), *(repository / package / "launch").glob("*.py")]
    nodes = [node for path in files for node in ast.walk(ast.parse(path.read_text()))]
    names = {node.module for node in nodes if isinstance(node, ast.ImportFrom)}
    names |= {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    pins = re.findall(r'^    "([\w-]+)==', (repository / "pyproject.toml").read_text(), re.MULTILINE)
    by_pip = {MODULES.get(name, name.replace("-", "_")) for name in pins} - set(DEBIAN)
    imported = {name.partition(".")[0] for name in names} - {package, *sys.stdlib_module_names, *by_pip, *OPTIONAL}
    root = ElementTree.parse(repository / package / "package.xml").getroot()
    declared = {entry.text for entry in root.findall("exec_depend")} - {"ros2launch"}  # which starts launch files
    assert declared == {DEBIAN.get(name, name) for name in imported}


def test_every_entry_point_names_a_function_that_exists():
    installed = [
        entry
        for group in ("console_scripts", "swift.commands")
        for entry in entry_points(group=group)
        if entry.value.startswith("swift_")
    ]
    assert len(installed) >= 20
    for entry in installed:
        spec = importlib.util.find_spec(entry.module)
        assert spec is not None, f"{entry.value} of {entry.name}"
        defined = [node.name for node in ast.parse(Path(spec.origin).read_text()).body if hasattr(node, "name")]
        assert entry.attr in defined, f"{entry.value} of {entry.name}"


def test_the_onboard_package_imports_without_jax_and_without_the_simulator(repository):
    code = (
        "import pkgutil, sys, swift_ros\n"
        "sys.modules['jax'] = sys.modules['swift_sim_bridge'] = None\n"
        "for module in pkgutil.walk_packages(swift_ros.__path__, 'swift_ros.'):\n"
        "    __import__(module.name)\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


def test_a_command_imports_ros_only_when_it_runs():
    modules = sorted({entry.module for entry in entry_points(group=cli.GROUP) if entry.value.startswith("swift_")})
    code = f"import sys\nsys.modules['rclpy'] = None\nfor name in {modules}:\n    __import__(name)\n"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


# Messages


def test_every_message_file_has_a_message_class(repository):
    assert [path.stem for path in sorted((repository / "swift_msgs/msg").glob("*.msg"))] == MESSAGES


@pytest.mark.parametrize("name", MESSAGES)
def test_message_is_unchanged_after_serialization(name):
    kind = getattr(swift_msgs.msg, name)
    sent = filled(kind, np.random.default_rng(1))
    assert sent != kind()
    assert deserialize_message(serialize_message(sent), kind) == sent


@pytest.mark.parametrize("name", ["GateDetections", "GatePoses"])
@pytest.mark.parametrize("count", range(3))
def test_gates_recorded_before_there_were_incomplete_ones_are_read(name, count):
    """The end of an older message lacks the sequence; a message that was cut elsewhere is still an error."""
    kind = getattr(swift_msgs.msg, name)
    sent = filled(kind, np.random.default_rng(1))
    sent.gates, sent.incomplete = sent.gates[:count], []
    older = serialize_message(sent)[:-4]
    found = deserialize(older, f"swift_msgs/msg/{name}")
    assert found == sent
    with pytest.raises(RuntimeError):
        deserialize(older[:-12], f"swift_msgs/msg/{name}")


def filled(kind, random):
    """Return a message without any field at its default value."""
    message = kind()
    for field, described in kind.get_fields_and_field_types().items():
        setattr(message, field, value_for(described, random))
    return message


def value_for(described, random):
    """Return a value for a field by its IDL type, such as `sequence<swift_msgs/GatePose>` or `double[9]`."""
    if described.startswith("sequence<"):
        return [value_for(described[len("sequence<") : -1], random) for _ in range(3)]
    if described.endswith("]"):
        element, size = described[:-1].split("[")
        return [value_for(element, random) for _ in range(int(size))]
    if "/" in described:
        package, name = described.split("/")
        return filled(getattr(importlib.import_module(f"{package}.msg"), name), random)
    if described == "string":
        return f"{random.integers(1000)} °"
    if described == "boolean":
        return True
    return float(np.float32(random.normal())) if described in ("float", "double") else int(random.integers(1, 100))


# The command line


def test_unknown_command_is_one_sentence_and_exit_code_2(capsys):
    assert cli.main(["fly-away"]) == 2
    out, error = capsys.readouterr()
    assert out == "" and len(error.splitlines()) == 1
    assert "'fly-away'" in error and "replay" in error


def test_no_command_is_exit_code_2(capsys):
    assert cli.main([]) == 2
    assert "--help" in capsys.readouterr().err


def test_workstation_command_on_a_vehicle_names_the_missing_package(monkeypatch, capsys):
    onboard = [entry for entry in entry_points(group=cli.GROUP) if entry.value.startswith("swift_ros.")]
    monkeypatch.setattr(cli, "entry_points", lambda group: onboard)
    assert cli.main(["race"]) == 2
    assert "swift_sim_bridge" in capsys.readouterr().err


def test_the_installed_commands_and_executables_are_those_of_the_tables():
    commands = {entry.name: entry.value for entry in entry_points(group=cli.GROUP) if entry.value.startswith("swift_")}
    assert commands == {command.name: f"{command.module}:command" for command in COMMANDS}
    scripts = {entry.name: entry.value for entry in entry_points(group="console_scripts")}
    assert {row.entry_point for row in NODES.values()} <= {f"{name} = {value}" for name, value in scripts.items()}


def test_help_lists_each_command_in_a_line_and_imports_none(capsys, planted_command):
    with pytest.raises(SystemExit) as stop:
        cli.main(["--help"])
    assert stop.value.code == 0
    assert ["hover", "Hold", "still."] in [line.split() for line in capsys.readouterr().out.splitlines()]
    assert "planted.hover" not in sys.modules


def test_command_receives_its_arguments_and_returns_its_exit_code(planted_command):
    assert cli.main(["hover", "--height", "3"]) == 3


@pytest.mark.parametrize(
    "words, cause",
    [
        (["hover", "--height", "3", "--fast"], "--fast"),
        (["hover", "--height", "up"], "up"),
        (["hover", "--height", "-1"], "underground"),
        (["hover", "--height", "0"], "no_such_library"),
    ],
)
def test_bad_arguments_are_one_sentence_and_exit_code_2(planted_command, capsys, words, cause):
    assert cli.main(words) == 2
    error = capsys.readouterr().err
    assert cause in error and len(error.splitlines()) == 1


def test_interrupted_command_exits_130(planted_command):
    assert cli.main(["hover", "--height", "99"]) == 130


@pytest.fixture
def planted_command(tmp_path, monkeypatch):
    """Install a command `hover` in a package of its own; its exit code is the height."""
    (tmp_path / "planted").mkdir()
    (tmp_path / "planted/__init__.py").touch()
    (tmp_path / "planted/hover.py").write_text(
        textwrap.dedent('''
        """Hold still.

        More about it.
        """
        from swift_ros.errors import UsageError

        def command(subparsers):
            parser = subparsers.add_parser("hover")
            parser.add_argument("--height", type=int, required=True)
            parser.set_defaults(run=run)

        def run(arguments):
            if arguments.height < 0:
                raise UsageError("the height is underground")
            if arguments.height == 0:
                import no_such_library
            if arguments.height == 99:
                raise KeyboardInterrupt
            return arguments.height
    ''')
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    metadata = tmp_path / "planted-1.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: planted\nVersion: 1\n")
    (metadata / "entry_points.txt").write_text("[swift.commands]\nhover = planted.hover:command\n")
    yield
    for module in [module for module in sys.modules if module.split(".")[0] == "planted"]:
        del sys.modules[module]


# Set-up


@pytest.fixture
def setup_workspace(repository, tmp_path, monkeypatch):
    """The set-up script as a module, with an empty folder as its checkout."""
    spec = importlib.util.spec_from_file_location("setup_workspace", repository / "scripts/setup_workspace.py")
    monkeypatch.syspath_prepend(str(repository / "scripts"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(module, "VENV", tmp_path / ".venv")
    monkeypatch.setattr(module, "STATE", tmp_path / ".venv/swift-setup.json")
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    return module


def test_a_step_runs_again_when_its_inputs_change_or_after_an_interruption(setup_workspace):
    setup_workspace.VENV.mkdir()
    setup_workspace.write_state({})
    ran = []
    for wanted in ("a", "a", "b"):
        setup_workspace.run_step("messages", "building", wanted, lambda wanted=wanted: ran.append(wanted))
    assert ran == ["a", "b"]

    with pytest.raises(KeyboardInterrupt):
        setup_workspace.run_step("messages", "building", "c", interrupt)
    assert json.loads(setup_workspace.STATE.read_text())["running"] == "messages"
    setup_workspace.run_step("messages", "building", "c", lambda: ran.append("c"))
    assert ran == ["a", "b", "c"]
    assert "running" not in setup_workspace.read_state()


def interrupt():
    raise KeyboardInterrupt


def test_an_environment_that_setup_did_not_make_is_not_changed(setup_workspace):
    setup_workspace.VENV.mkdir()
    with pytest.raises(setup_workspace.SetupError, match="make clean"):
        setup_workspace.ensure_environment(native=False)
    assert setup_workspace.VENV.is_dir()


def test_an_environment_for_another_ros_is_not_changed(setup_workspace):
    setup_workspace.VENV.mkdir()
    setup_workspace.write_state({"environment": "a", "kind": "ROS 2 from wheels", "python": "/usr/bin/python3"})
    with pytest.raises(setup_workspace.SetupError, match="was created for ROS 2 from wheels"):
        setup_workspace.ensure_environment(native=True)
    assert setup_workspace.read_state()["environment"] == "a"


@pytest.mark.parametrize(
    "missing, packages",
    [
        ({"cc"}, "build-essential"),
        ({"make", "c++", "cmake"}, "build-essential cmake"),
        ({"headers"}, "python3.12-dev"),
        ({"venv", "headers"}, "python3.12-dev python3.12-venv"),
    ],
)
def test_missing_tools_are_named_with_their_packages_in_one_sentence(setup_workspace, monkeypatch, missing, packages):
    machine = sys.modules["machine"]
    found = {"version": "3.12", "colcon": False, **{part: part not in missing for part in ("headers", "venv")}}
    monkeypatch.setattr(machine.subprocess, "check_output", lambda *_, **__: json.dumps(found))
    monkeypatch.setattr(machine.shutil, "which", lambda name: None if name in missing else f"/usr/bin/{name}")
    monkeypatch.setattr(machine, "cmake_version", lambda: (0, 0) if "cmake" in missing else (3, 25))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.delenv("CXX", raising=False)
    with pytest.raises(setup_workspace.SetupError) as stop:
        machine.require_build_tools("python3", native=False)
    assert f"sudo apt install {packages}`" in str(stop.value)
    assert len(str(stop.value).splitlines()) == 1


def test_other_ros_distribution_is_refused(setup_workspace, monkeypatch):
    machine = sys.modules["machine"]
    monkeypatch.setenv("ROS_DISTRO", "humble")
    monkeypatch.setattr(machine.shutil, "which", lambda name: f"/usr/bin/{name}")
    with pytest.raises(setup_workspace.SetupError, match="Jazzy"):
        setup_workspace.native_ros_sourced()


def test_cmake_files_of_the_wheels_are_patched_to_this_environment(setup_workspace, monkeypatch):
    share = setup_workspace.VENV / "share"
    share.mkdir(parents=True)
    (share / "a.cmake").write_text(
        'set(d "/opt/builder/cp311/include/python3.11;/opt/x/numpy/_core/include")\n'
        'set(keep "${prefix}/include/other")\n'
    )
    monkeypatch.setattr(setup_workspace, "venv_output", lambda code: json.dumps(["/here/python", "/here/numpy"]))
    setup_workspace.patch_cmake_files()
    assert (share / "a.cmake").read_text() == 'set(d "/here/python;/here/numpy")\nset(keep "${prefix}/include/other")\n'


def test_optional_groups_are_installed_only_when_they_are_named(setup_workspace):
    (setup_workspace.ROOT / "pyproject.toml").write_text('[dependency-groups]\ndocs = ["mkdocs"]\n')
    assert [name for name, *_ in setup_workspace.optional_steps(False, ["docs"])] == ["packages: docs"]
    assert "docs" not in setup_workspace.base_groups(native=False)
    with pytest.raises(setup_workspace.SetupError, match="'plots'.*types, docs"):
        setup_workspace.optional_steps(False, ["plots"])
