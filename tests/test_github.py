"""The workflow and the issue forms: they cannot run here, so what they name is looked up."""

import importlib.util
import os
import re
import shlex
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[1]
FORMS = sorted(path for path in (ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml") if path.name != "config.yml")
FIELDS = {"markdown", "textarea", "input", "dropdown", "checkboxes"}
ASKED_OF_A_BUG = {"version", "method", "dataset", "config", "message"}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def read(path: Path) -> dict[Any, Any]:
    values = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert isinstance(values, dict)
    return values


@pytest.fixture(scope="module")
def job() -> dict[str, Any]:
    return read(ROOT / ".github" / "workflows" / "checks.yml")["jobs"]["checks"]


def steps_on(job: dict[str, Any], system: str) -> list[str]:
    """Return the lines that are run on a system."""
    lines = []
    for step in job["steps"]:
        condition = step.get("if", "")
        compared = re.fullmatch(r"runner\.os (==|!=) '(\w+)'", condition)
        assert compared or not condition, f"{condition}: not understood here"
        if compared is None or (compared[2] == system) == (compared[1] == "=="):
            lines += step.get("run", "").splitlines()
    return lines


def fault_of(line: str) -> str | None:
    """Return what is wrong with a line of the workflow; None where all that it names is there."""
    words = shlex.split(line)
    if words[:2] == ["python", "-m"]:
        if importlib.util.find_spec(words[2]) is None:
            return f"no module {words[2]}"
        extras = re.findall(r"\[(\w+)\]", line) if words[2] == "pip" else []
        unknown = set(extras) - PROJECT["optional-dependencies"].keys()
        return f"no extra {unknown}" if unknown else None
    script = ROOT / words[0]
    if not script.is_file():
        return f"no script {words[0]}"
    return None if os.access(script, os.X_OK) else f"{words[0]} cannot be executed"


def test_the_workflow_is_run_for_every_change_everywhere(job: dict[str, Any]) -> None:
    workflow = read(ROOT / ".github" / "workflows" / "checks.yml")
    assert set(workflow[True]) == {"push", "pull_request"}  # YAML 1.1 reads the key "on" as true
    assert job["strategy"]["fail-fast"] is False
    matrix = job["strategy"]["matrix"]
    assert matrix["os"] == ["ubuntu-latest", "macos-latest", "windows-latest"]
    assert matrix["python"] == ["3.11", "3.12", "3.13", "3.14"]
    assert all(isinstance(version, str) for version in matrix["python"]), "3.10 would be read as 3.1"
    assert PROJECT["requires-python"] == f">={matrix['python'][0]}"
    assert job["runs-on"] == "${{ matrix.os }}"
    given = [step["with"]["python-version"] for step in job["steps"] if "setup-python" in step.get("uses", "")]
    assert given == ["${{ matrix.python }}"]


@pytest.mark.parametrize("system", ["Linux", "macOS", "Windows"])
def test_what_is_run_exists(system: str, job: dict[str, Any]) -> None:
    lines = steps_on(job, system)
    assert [fault for line in lines if (fault := fault_of(line))] == []
    assert lines[0].startswith("python -m pip install")
    if system == "Windows":
        assert not any(line.startswith("scripts/") for line in lines)
        assert any(line.startswith("python -m pytest") for line in lines)
    else:
        assert {"scripts/check", "scripts/test"} <= set(lines)
        assert job["env"]["STILLROOM_PYTHON"] == "python", "the scripts would make an environment of their own"


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("python -m no_such_module", "no module no_such_module"),
        ('python -m pip install ".[fast]"', "no extra {'fast'}"),
        ("scripts/fly", "no script scripts/fly"),
        ("scripts/check", None),
    ],
)
def test_what_does_not_exist_is_found(line: str, fault: str | None) -> None:
    assert fault_of(line) == fault


def test_tools_without_a_wheel_for_windows_are_left_out_there() -> None:
    gtsam = [tool for tool in PROJECT["optional-dependencies"]["dev"] if tool.startswith("gtsam")]
    assert len(gtsam) == 1
    assert gtsam[0].endswith("; sys_platform != 'win32'")


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.stem)
def test_a_form_is_one_that_github_reads(path: Path) -> None:
    form = read(path)
    assert form.keys() >= {"name", "description", "body"}
    assert all(field["type"] in FIELDS for field in form["body"])
    asked = [field for field in form["body"] if field["type"] != "markdown"]
    assert asked, "nothing is asked"
    names = [field["id"] for field in asked]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[\w-]+", name) for name in names)
    assert all(field["attributes"]["label"] for field in asked)
    assert all(isinstance(field["validations"]["required"], bool) for field in asked)


def test_there_is_a_form_for_each_kind_and_no_way_round() -> None:
    assert [path.stem for path in FORMS] == ["bug", "feature", "question"]
    assert read(ROOT / ".github" / "ISSUE_TEMPLATE" / "config.yml")["blank_issues_enabled"] is False
    bug = read(ROOT / ".github" / "ISSUE_TEMPLATE" / "bug.yml")
    assert {field.get("id") for field in bug["body"]} >= ASKED_OF_A_BUG
