"""The packages depend on each other in one direction: the imports of all files, against the floor plan below."""

import ast
import re
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

import pytest

PACKAGES = ("swift_ros", "swift_sim_bridge")
MAX_FILES = 14  # Python files in a folder, its __init__.py not counted: what one finds at a glance
MAX_PARAMETERS = 6  # of a function, without self: more become a named dataclass

# From the bottom up. A node is a folder, or a module at the root of a package or of gap/. It imports nodes of lower
# lines only, none of its own line.
LAYERS = (
    # what flies
    (
        "swift_ros",
        "swift_ros/library_threads",
        "swift_ros/errors",
        "swift_ros/geometry",
        "swift_ros/text",
        "swift_ros/types",
        "swift_ros/working_time",
    ),
    ("swift_ros/files", "swift_ros/plausibility"),
    ("swift_ros/vehicle",),
    (
        "swift_ros/configuration",
        "swift_ros/corner_rays",
        "swift_ros/mavlink",
        "swift_ros/results",
        "swift_ros/timeline",
    ),
    ("swift_ros/graph", "swift_ros/track"),
    ("swift_ros/camera", "swift_ros/race"),
    ("swift_ros/trained_for",),
    ("swift_ros/messages",),
    ("swift_ros/recording/mcap_format", "swift_ros/recording/table_formats"),
    ("swift_ros/recording/log_formats",),
    ("swift_ros/recording/log_mapping", "swift_ros/estimation/odometry_check"),
    ("swift_ros/betaflight", "swift_ros/estimation", "swift_ros/perception", "swift_ros/policy", "swift_ros/recording"),
    ("swift_ros/importers", "swift_ros/nodes"),
    ("swift_ros/commands",),
    ("swift_ros/cli",),
    # the vehicle and its instruments
    (
        "swift_sim_bridge",
        "swift_sim_bridge/compiled_code",
        "swift_sim_bridge/parallel",
        "swift_sim_bridge/seeds",
        "swift_sim_bridge/tcp_ports",
        "swift_sim_bridge/units",
    ),
    ("swift_sim_bridge/effects", "swift_sim_bridge/model_files", "swift_sim_bridge/plots"),
    ("swift_sim_bridge/residual_models",),
    ("swift_sim_bridge/physics/terms", "swift_sim_bridge/flight_controller/rate_loop"),
    ("swift_sim_bridge/physics", "swift_sim_bridge/flight_controller/configuration"),
    ("swift_sim_bridge/sensors", "swift_sim_bridge/flight_controller"),
    ("swift_sim_bridge/flight_controller/sitl",),
    ("swift_sim_bridge/labels", "swift_sim_bridge/rendering", "swift_sim_bridge/simulation"),
    # whole flights and trainings
    ("swift_sim_bridge/pilot/episodes",),
    (
        "swift_sim_bridge/bridge",
        "swift_sim_bridge/limit",
        "swift_sim_bridge/pilot",
        "swift_sim_bridge/racing",
        "swift_sim_bridge/video",
    ),
    ("swift_sim_bridge/faults", "swift_sim_bridge/gate_detector", "swift_sim_bridge/soak"),
    ("swift_sim_bridge/gate_detector/images/own_gates",),
    ("swift_sim_bridge/gate_detector/images/composites",),
    ("swift_sim_bridge/gate_detector/images",),
    ("swift_sim_bridge/gate_detector/evaluation", "swift_sim_bridge/gate_detector/training"),
    ("swift_sim_bridge/labelling",),
    # analysis of flights
    ("swift_sim_bridge/identification",),
    ("swift_sim_bridge/gap", "swift_sim_bridge/gap/effects"),
    ("swift_sim_bridge/gap/recording",),
    ("swift_sim_bridge/gap/residuals",),
    ("swift_sim_bridge/gap/inference",),
    ("swift_sim_bridge/gap/nominal",),
    ("swift_sim_bridge/gap/discovery",),
    ("swift_sim_bridge/gap/attribution",),
    ("swift_sim_bridge/gap/validation",),
    ("swift_sim_bridge/gap/report",),
    ("swift_sim_bridge/gap/pipeline",),
    ("swift_sim_bridge/gap/api",),
    ("swift_sim_bridge/gap/self_test",),
    ("swift_sim_bridge/referee/effects", "swift_sim_bridge/referee/simulator"),
    ("swift_sim_bridge/referee",),
    ("swift_sim_bridge/benchmarks", "swift_sim_bridge/view"),
    ("swift_sim_bridge/commands",),
)

ONE_OF_A_KIND = {  # folders that may hold more files, and of which kind these are
    "swift_ros/swift_ros/nodes": "one node for each file",
    "swift_sim_bridge/swift_sim_bridge/physics/terms": "one group of physical terms for each file",
}

WITH_RCLPY = {  # modules outside nodes/ that import rclpy, and why
    "swift_ros.graph.qos": "turns a row of the topic table into a QoS profile",
    "swift_ros.messages.serialization": "converts between messages and CDR bytes",
    "swift_sim_bridge.bridge.node": "the simulator's node",
    "swift_sim_bridge.faults.relay": "the nodes that plant a fault in a topic",
}

LOADED_BY_NAME = {  # modules that import others by names which no import statement shows, and which
    "swift_ros.messages.serialization": "message classes by their ROS type",
    "swift_ros.commands.checked_files": "records of a configuration, of packages above it too: by `section_table`",
    "swift_ros.commands.import_recording": "the importer of a format",
    "swift_sim_bridge.effects": "the tables of all terms, above it in LAYERS: a vehicle file is checked against both",
    "swift_sim_bridge.physics.terms.registry": "all modules of its own folder",
}

WIDE: dict[str, str] = {}  # functions with more parameters, and why


class Import(NamedTuple):
    """One import: the importing module, the imported one (in full), and the line."""

    importer: str
    imported: str
    line: int


@pytest.fixture(scope="module")
def modules(repository) -> dict[str, Path]:
    """Return the file of each module of both packages by its dotted name."""
    found = {}
    for package in PACKAGES:
        root = repository / package / package
        for path in root.rglob("*.py"):
            parts = path.relative_to(root.parent).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@pytest.fixture(scope="module")
def imports(modules) -> list[Import]:
    """Return all imports of both packages, those within functions included."""
    return [one for name, path in sorted(modules.items()) for one in imports_of(name, ast.parse(path.read_text()))]


def imports_of(name: str, tree: ast.Module) -> list[Import]:
    found = []
    for item in ast.walk(tree):
        if isinstance(item, ast.Import):
            found += [Import(name, alias.name, item.lineno) for alias in item.names]
        elif isinstance(item, ast.ImportFrom) and item.module:
            found += [Import(name, f"{item.module}.{alias.name}", item.lineno) for alias in item.names]
    return found


def internal(imports: list[Import], modules) -> list[Import]:
    """Return the imports of modules of both packages, with the imported name reduced to its module."""
    found = []
    for one in imports:
        target = one.imported if one.imported in modules else one.imported.rpartition(".")[0]
        if target in modules and target != one.importer:
            found.append(one._replace(imported=target))
    return found


def node_of(module: str, modules) -> str:
    """Return the node of the floor plan to which a module belongs."""
    parts = module.split(".")
    is_root = len(parts) == 2 or (parts[1:2] == ["gap"] and len(parts) == 3)
    return "/".join(parts if is_root or modules[module].name == "__init__.py" else parts[:-1])


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the nodes that are on a circle, grouped by circle (Tarjan's strongly connected components)."""
    index, low, stack, found = {}, {}, [], []

    def visit(node):
        index[node] = low[node] = len(index)
        stack.append(node)
        for neighbour in graph.get(node, ()):
            if neighbour not in index:
                visit(neighbour)
            if neighbour in stack:
                low[node] = min(low[node], low[neighbour])
        if low[node] == index[node]:
            group = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(group) > 1:
                found.append(sorted(group))

    for node in sorted(graph):
        if node not in index:
            visit(node)
    return found


def test_circles_are_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]
    assert circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_no_files_import_each_other_in_a_circle(imports, modules):
    graph = defaultdict(set)
    for one in internal(imports, modules):
        graph[one.importer].add(one.imported)
    assert circles(graph) == []


def test_no_folders_import_each_other_in_a_circle(imports, modules):
    graph = defaultdict(set)
    for one in internal(imports, modules):
        first, second = node_of(one.importer, modules), node_of(one.imported, modules)
        if first != second:
            graph[first].add(second)
    assert circles(graph) == []


def test_imports_go_down_the_layers(imports, modules):
    height = {node: number for number, layer in enumerate(LAYERS) for node in layer}
    unplaced = {node_of(module, modules) for module in modules} - set(height)
    assert not unplaced, f"without a place in LAYERS: {sorted(unplaced)}"
    upwards = []
    for one in internal(imports, modules):
        first, second = node_of(one.importer, modules), node_of(one.imported, modules)
        if first != second and height[second] >= height[first]:
            upwards.append(f"{one.importer}:{one.line} imports {one.imported}")
    assert not upwards, "\n".join(upwards)


def test_what_flies_imports_neither_jax_nor_the_workstation(imports):
    forbidden = ("jax", "jaxlib", "optax", "swift_sim_bridge")
    wrong = [one for one in imports if one.importer.startswith("swift_ros") and root(one.imported) in forbidden]
    assert not wrong


def test_ros_is_imported_by_nodes_alone(imports):
    wrong = [
        f"{one.importer}:{one.line}"
        for one in imports
        if root(one.imported) == "rclpy" and ".nodes." not in one.importer and one.importer not in WITH_RCLPY
    ]
    assert not wrong


def test_imports_by_name_are_few_and_known(modules):
    loading = {name for name, path in modules.items() if "import_module(" in path.read_text()}
    assert loading == set(LOADED_BY_NAME)


def root(module: str) -> str:
    return module.partition(".")[0]


def test_folders_are_small_or_of_one_kind(modules, repository):
    count = defaultdict(int)
    for path in modules.values():
        count[path.parent.relative_to(repository).as_posix()] += path.name != "__init__.py"
    large = {folder: number for folder, number in count.items() if number > MAX_FILES and folder not in ONE_OF_A_KIND}
    assert not large
    assert not set(ONE_OF_A_KIND) - set(count)


def test_functions_take_few_parameters(modules):
    wide = {}
    for name, path in modules.items():
        for function in ast.walk(ast.parse(path.read_text())):
            if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef) and parameters(function) > MAX_PARAMETERS:
                wide[f"{name}.{function.name}"] = f"line {function.lineno}: {parameters(function)} parameters"
    found = [f"{name}, {text}" for name, text in wide.items() if name not in WIDE]
    assert not found, "\n".join(found)
    assert not set(WIDE) - set(wide), "no longer wide; remove them from WIDE"


def parameters(function) -> int:
    """Return how many parameters a function has, without self and cls."""
    arguments = function.args
    names = [one.arg for one in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]
    return len(names) - (names[:1] in (["self"], ["cls"]))


@pytest.mark.parametrize("forbidden", [r"\.\./shared", r"(?<![\w.])/work/"])
def test_pages_name_nothing_outside_the_repository(repository, forbidden):
    found = []
    for path in (
        repository / "README.md",
        repository / "CONTRIBUTING.md",
        *sorted((repository / "docs").rglob("*.md")),
    ):
        for number, line in enumerate(path.read_text().splitlines(), start=1):
            if re.search(forbidden, line):
                found.append(f"{path.relative_to(repository)}:{number}: {line.strip()}")
    assert not found
