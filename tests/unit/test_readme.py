"""README and docs describe what is there: commands parse, paths and links exist, generated pages equal the code."""

import importlib.util
import re
import shlex
import signal
from importlib.metadata import entry_points

import pytest

from swift_ros import cli
from swift_sim_bridge.effects import known_terms

MAX_README_LINES, MAX_README_WORDS = 120, 1500
MAX_CELL = 250  # characters: beyond, a table is not readable
PLACEHOLDER = re.compile(r"(?<![\w$-])[A-Z]{4,}(?:\.\w+)?(?!\w*=)")  # FLIGHT, PATH, FLIGHT.bbl; not ARGS=...


def load_script(repository, name):
    """Return a file of scripts/ as a module."""
    spec = importlib.util.spec_from_file_location(name, repository / f"scripts/{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def documented(repository):
    return load_script(repository, "run_documented_commands")


@pytest.fixture(scope="module")
def pages(repository, documented):
    """Return the text of each page by its path."""
    return {path: path.read_text() for path in documented.pages(repository)}


@pytest.fixture(scope="module")
def blocks(repository, documented):
    return documented.blocks(repository)


def test_the_readme_is_short(repository):
    text = (repository / "README.md").read_text()
    assert len(text.splitlines()) <= MAX_README_LINES
    assert len(text.split()) <= MAX_README_WORDS


def test_the_page_of_topics_equals_the_code_and_the_page_of_effects_has_every_term(repository):
    generator = load_script(repository, "generate_docs")
    for path, text in generator.pages().items():
        if path == generator.EFFECTS:  # written for each build
            assert all(name in text for name in known_terms())
        else:
            assert path.read_text() == text, f"{path.name} is out of date; run `make docs`"


def test_every_command_is_one_that_swiftros_understands(blocks):
    commands = {command for block in blocks for command in block.commands}
    commands |= {f"swiftros race {match[1]}" for one in commands if (match := re.match(r'make race ARGS="(.*)"', one))}
    calls = [shlex.split(command)[1:] for command in sorted(commands) if command.startswith("swiftros ")]
    assert {words[0] for words in calls} == {entry.name for entry in entry_points(group=cli.GROUP)} - {"bench"} | {
        "bench"
    }
    for words in calls:
        parser = cli.Parser(prog="swiftros")
        (entry,) = entry_points(group=cli.GROUP, name=words[0])
        entry.load()(parser.add_subparsers())
        parser.parse_args(words)  # raises UsageError for an unknown option or a missing argument


def test_every_make_target_exists(repository, blocks, pages):
    targets = set(re.findall(r"(?m)^([a-z-]+):", (repository / "Makefile").read_text()))
    named = {command.split()[1] for block in blocks for command in block.commands if command.startswith("make ")}
    named |= {name for text in pages.values() for name in re.findall(r"`make ([a-z-]+)", text)}
    assert named <= targets


def test_commands_with_placeholders_are_marked_as_not_run(blocks):
    found = [
        f"{block.page}:{block.line}: {command}"
        for block in blocks
        for command in block.commands
        if not block.not_run and PLACEHOLDER.search(re.sub(r"ARGS=", "", command))
    ]
    assert not found


def test_every_path_in_the_repository_exists(repository, pages, blocks):
    tops = {path.name for path in repository.iterdir() if path.is_dir()} - {"recordings", "runs", "results", "site"}
    spans = {span for text in pages.values() for span in re.findall(r"`([\w.-]+/[\w./-]*)`", text)}
    words = {word for block in blocks for command in block.commands for word in command.split()}
    named = {path for path in spans | words if path.split("/")[0] in tops and "/" in path}
    missing = {path for path in named if not (repository / path).exists()}
    assert not missing


def test_every_link_and_picture_resolves(repository, pages):
    broken = []
    for page, text in pages.items():
        for target in re.findall(r"\]\(([^)\s]+)\)", text):
            if re.match(r"https?://", target):
                continue
            name, _, anchor = target.partition("#")
            path = (page.parent / name).resolve() if name else page
            if path == repository / "docs/effects.md":  # written for each build
                continue
            if not path.exists():
                broken.append(f"{page.relative_to(repository)}: {target}")
            elif anchor and anchor not in anchors(path.read_text()):
                broken.append(f"{page.relative_to(repository)}: {target}, no such heading")
    assert not broken


def test_pages_that_the_code_names_exist(repository):
    missing = []
    for folder in ("swift_ros", "swift_sim_bridge", "config", "tests", "scripts"):
        for path in sorted((repository / folder).rglob("*")):
            if path.suffix in (".py", ".yaml", ".xml") and path.name != "test_readme.py":
                named = set(re.findall(r"\bdocs/[\w/-]+\.md\b", path.read_text()))
                missing += [
                    f"{path.relative_to(repository)}: {name}" for name in named if not (repository / name).exists()
                ]
    assert not missing


def anchors(text: str) -> set[str]:
    """Return the anchors of a page's headings, as code hosts and mkdocs make them."""
    headings = re.findall(r"(?m)^#+ (.*)$", re.sub(r"(?ms)^```.*?^```$", "", text))
    return {re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", heading).strip().lower()) for heading in headings}


def test_tables_have_short_cells(repository, pages):
    long = [
        f"{page.relative_to(repository)}:{number}: {len(cell)} characters"
        for page, text in pages.items()
        for number, line in enumerate(text.splitlines(), start=1)
        if line.startswith("|")
        for cell in line.split("|")
        if len(cell.strip()) > MAX_CELL
    ]
    assert not long


def test_blocks_are_read_with_their_markers(documented):
    text = "\n".join(
        (
            "```bash",
            "make race   # once",
            "swiftros check \\",
            "  recordings/race",
            "```",
            "<!-- not run: needs a GPU -->",
            "```bash",
            "swiftros train policy",
            "```",
            "<!-- with: swiftros sim -->",
            "```bash",
            "swiftros topics list",
            "```",
            "",
        )
    )
    first, second, third = documented.blocks_of("a.md", text)
    assert first.commands == ("make race", "swiftros check    recordings/race") and not first.not_run
    assert second.not_run == "needs a GPU"
    assert third.background == "swiftros sim"


def test_a_here_document_is_one_command_with_its_file(documented, tmp_path):
    text = "```bash\ncat > made.yaml <<'END'\ngates:  # two\n  - {a: 1}\nEND\ntest -f made.yaml\n```\n"
    (block,) = documented.blocks_of("a.md", text)
    assert [one.exit_code for one in documented.run_blocks([block], tmp_path)] == [0, 0]
    assert (tmp_path / "made.yaml").read_text() == "gates:  # two\n  - {a: 1}\n"


def test_commands_run_in_order_and_failures_are_reported(documented, tmp_path):
    block = documented.Block("a.md", 1, ("echo 1 > made", "test -f made", "false", "test -f made"))
    outcomes = list(documented.run_blocks([block], tmp_path))
    assert [one.exit_code for one in outcomes] == [0, 0, 1, 0]
    skipped = documented.Block("b.md", 1, ("false",), not_run="needs a GPU")
    (outcome,) = documented.run_blocks([skipped], tmp_path)
    assert outcome.exit_code is None and outcome.note == "needs a GPU"


ENDLESS = """\
import signal, sys, time
signal.signal(signal.SIGINT, lambda *_: sys.exit(0))
signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
time.sleep(600)
sys.exit("never interrupted")
"""


def test_endless_commands_are_interrupted(documented, tmp_path, monkeypatch):
    """The program inherits a mask that holds the interrupt back until it is ready, however late it starts."""
    (tmp_path / "endless.py").write_text(ENDLESS)
    monkeypatch.setitem(documented.ENDLESS, "exec python3 endless.py", 1.0)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        assert documented.run_command("exec python3 endless.py", tmp_path) == 0
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def test_commands_are_not_run_without_the_background_that_they_need(documented, tmp_path):
    block = documented.Block("a.md", 1, ("touch run",), background="false")
    outcomes = list(documented.run_blocks([block], tmp_path))
    assert [one.exit_code for one in outcomes] == [1, None]
    assert not (tmp_path / "run").exists()


def test_commands_do_not_receive_the_arguments_of_make_check_docs(documented, tmp_path, monkeypatch):
    monkeypatch.setenv("ARGS", "FOLDER")
    monkeypatch.setenv("MAKEFLAGS", " -- ARGS=FOLDER")
    (tmp_path / "Makefile").write_text("race:\n\ttest -z '$(ARGS)'\n")
    assert documented.run_command("make race", tmp_path) == 0
