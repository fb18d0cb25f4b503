"""What the checks say of a file: a refusal, an acceptance or an advice."""

from pathlib import Path

import pytest

from swift_ros import cli, configuration
from swift_ros.errors import UsageError
from swift_ros.plausibility.finding import ODD


def check_refusal(kind: type, path: Path, sentence: str):
    """Assert that a file is refused by one sentence, which begins with its path and contains `sentence`."""
    with pytest.raises(UsageError, match=sentence) as caught:
        configuration.load(kind, path)
    text = str(caught.value)
    assert text.startswith(str(path)) and "\n" not in text and len(text) < 400


def check_acceptance(kind: type, path: Path):
    """Assert that a file is used, whatever is odd about it."""
    assert all(finding.level == ODD for finding in configuration.load(kind, path).findings())


def check_advice(path: Path, sentence: str, capsys):
    """Assert that `swiftros check` accepts a file and prints what is odd about it."""
    assert cli.main(["check", str(path)]) == 0
    assert sentence in capsys.readouterr().out
