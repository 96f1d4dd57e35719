"""There is one version; what cites it says the same."""

import re
from importlib.metadata import version
from pathlib import Path

import stillroom

ROOT = Path(__file__).parents[1]


def test_the_citation_the_changelog_and_the_installed_package_are_of_this_version() -> None:
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    assert cited is not None
    assert cited[1] == stillroom.__version__
    newest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert newest is not None
    assert newest[1] == stillroom.__version__
    assert version("stillroom") == stillroom.__version__
    assert "\nversion =" not in (ROOT / "pyproject.toml").read_text(encoding="utf-8"), "it stands in the package"
