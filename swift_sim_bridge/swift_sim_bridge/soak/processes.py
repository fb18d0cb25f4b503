"""Memory of a process and of all processes that it has started, from /proc."""

from pathlib import Path

PROC = Path("/proc")


def memory_mb(root: int) -> dict[str, float]:
    """Return the proportional memory (PSS, MB) of a process and its descendants, by name of the program."""
    children: dict[int, list[int]] = {}
    for folder in PROC.iterdir():
        if folder.name.isdigit() and (parent := _parent(folder)) is not None:
            children.setdefault(parent, []).append(int(folder.name))
    found: dict[str, float] = {}
    waiting = [root]
    while waiting:
        process = waiting.pop()
        waiting += children.get(process, [])
        size_mb = _pss_mb(PROC / str(process))
        if size_mb:
            name = _name(PROC / str(process))
            found[name] = found.get(name, 0.0) + size_mb
    return found


def _parent(folder: Path) -> int | None:
    try:
        return int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
    except OSError:  # it has ended meanwhile
        return None


def _pss_mb(folder: Path) -> float:
    try:
        lines = (folder / "smaps_rollup").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("Pss:")), 0.0)


def _name(folder: Path) -> str:
    """Return the name of the program: of the script, for one that the interpreter runs."""
    try:
        words = (folder / "cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        return "ended"
    script = next((word for word in words[1:2] if "/" in word), words[0])
    return "swiftros" if script == "-m" else Path(script).name
