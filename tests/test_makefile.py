"""What the Makefile's targets run, as ``make --dry-run`` prints it."""

import subprocess

import pytest
from command_line import REPOSITORY


def _last_line(*arguments: str) -> str:
    """Return the last command of a target, with every run of white space as one space."""
    made = subprocess.run(["make", "--dry-run", *arguments], cwd=REPOSITORY, capture_output=True, text=True, check=True)
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
