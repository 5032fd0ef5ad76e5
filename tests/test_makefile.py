"""What the Makefile's targets run, as ``make --dry-run`` prints it."""

import ast
import os
import re
import subprocess
from pathlib import Path

import pytest
from command_line import REPOSITORY


def _last_line(*arguments: str) -> str:
    """Return the last command of a target, with every run of white space as one space."""
    # A make that runs the tests, as `make check ARGS=…` does, would have its flags and variables obeyed, too.
    of_make = {"MAKEFLAGS", "MFLAGS", "MAKEOVERRIDES", "MAKELEVEL", "ARGS", "SEQ", "SET", "PRESET", "TARGET"}
    environment = {name: value for name, value in os.environ.items() if name not in of_make}
    command = ["make", "--dry-run", *arguments]
    made = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=True)
    return " ".join(made.stdout.splitlines()[-1].split())


@pytest.mark.parametrize(
    ("arguments", "command"),
    [
        ([], "plan annotate"),
        (["SEQ=monday", "ARGS=rounds=2"], "plan annotate 'seq=monday' rounds=2"),
        (["TARGET=all", "PRESET=small"], "plan all preset=small"),
        (["TARGET=evaluate", "SET=test"], "plan evaluate manifest=data_manifests/synthetic_test.csv seq=all"),
    ],
)
def test_a_plan_is_of_the_same_command_as_the_run(arguments: list[str], command: str) -> None:
    assert _last_line("plan", *arguments) == f".venv/bin/python -m pipeline {command}"


def test_benchmarks_that_are_run_need_nothing_and_the_others_are_named() -> None:
    listed = re.search(r"for name in ([a-z0-9_ ]+);", _last_line("benchmark"))
    assert listed
    run = set(listed[1].split())
    files = {path.stem: path for path in (REPOSITORY / "benchmarks").glob("[a-z]*.py")}
    assert run <= set(files)
    assert {name: needed for name in run if (needed := _needed_arguments(files[name]))} == {}
    by_hand, doc = set(files) - run, (REPOSITORY / "docs" / "benchmarks.md").read_text()
    assert {name for name in files if f"| `python benchmarks/{name}.py" in doc} == by_hand
    assert all(f"`{name}`" in doc for name in run)


def test_what_a_benchmark_needs_is_seen() -> None:
    assert _needed_arguments(REPOSITORY / "benchmarks" / "soak.py") == ["--calibration", "--videos"]


def _needed_arguments(path: Path) -> list[str]:
    """Return the arguments without which a program ends at once."""
    found = []
    for call in ast.walk(ast.parse(path.read_text())):
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute) and call.func.attr == "add_argument":
            name = ast.literal_eval(call.args[0])
            said = {keyword.arg: ast.unparse(keyword.value) for keyword in call.keywords}
            if said.get("required") == "True" or (name[0] != "-" and said.get("nargs") not in ("'?'", "'*'")):
                found.append(name)
    return found
