"""Run a notebook of the repository as a person does, cell by cell, with paths from the environment."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from command_line import REPOSITORY

nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed: pip install -e '.[dev]'")
pytest.importorskip("ipykernel", reason="ipykernel is not installed: pip install -e '.[dev]'")

NOTEBOOKS = REPOSITORY / "notebooks"
TIMEOUT_S = 300  # of a cell; on a free machine the slowest takes some seconds


@dataclass(frozen=True)
class RunNotebook:
    """What a notebook showed, and what some of its variables were at the end.

    Attributes:
        printed: all that its cells printed.
        shown: tables and values as text.
        num_pictures: how many it shows.
        values: what was asked for, as JSON has it.
    """

    printed: str
    shown: str
    num_pictures: int
    values: Any


def run_notebook(name: str, folder: Path, environment: Mapping[str, str], asked: str) -> RunNotebook:
    """Run a notebook to its end.

    Args:
        name: Its file in ``notebooks``.
        folder: The current one of the notebook, in the repository or below it.
        environment: More of it.
        asked: An expression of its variables.
    """
    import nbformat

    notebook = nbformat.read(NOTEBOOKS / name, 4)
    notebook.cells.append(nbformat.v4.new_code_cell(f"import json as _json\nprint(_json.dumps({asked}))"))
    client = nbclient.NotebookClient(notebook, timeout=TIMEOUT_S, resources={"metadata": {"path": str(folder)}})
    client.execute(env={**os.environ, "OMP_NUM_THREADS": "1", "MPLBACKEND": "", **environment})
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    printed = [output["text"] for output in outputs if output.get("name") == "stdout"]
    errors = [output["text"] for output in outputs if output.get("name") == "stderr"]
    assert not errors, f"{name} warns: {errors}"
    data = [output.get("data", {}) for output in outputs]
    return RunNotebook(
        "".join(printed[:-1]),
        "\n".join(item["text/plain"] for item in data if "text/plain" in item),
        sum("image/png" in item for item in data),
        json.loads(printed[-1]),
    )
