import io
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pyarrow as pa
from error_tables import errors_table
from finished_run import CONFIG, write_evaluation
from rich.console import Console

from pipeline.config import RunConfig
from pipeline.evaluation import print_evaluation


def _said(run: Path, **kinds: str) -> str:
    text = io.StringIO()
    config = cast(RunConfig, SimpleNamespace(stages={"evaluate": CONFIG}))
    print_evaluation(Console(file=text, width=200), config, run, kinds)
    return text.getvalue()


def _errors(sequence_id: str, *scales: float) -> pa.Table:
    hard = np.random.default_rng(0).gamma(2, 4, (20, 2))
    names = ("2d_triangulation", "R1")
    return errors_table({n: s * hard for n, s in zip(names, scales, strict=False)}, sequence_id=sequence_id)


def test_without_truth_nothing_is_said(tmp_path: Path) -> None:
    assert _said(tmp_path) == ""


def test_one_method_of_one_sequence_has_its_table_and_nothing_else(tmp_path: Path) -> None:
    write_evaluation(tmp_path, "monday", _errors("monday", 1.0))
    said = _said(tmp_path)
    assert "monday against the simulator's truth" in said and "2d_triangulation" in said and "840" in said
    assert "together" not in said and "in pairs" not in said


def test_sequences_are_pooled_and_methods_compared_where_all_are_there(tmp_path: Path) -> None:
    for name in ("monday", "tuesday"):
        write_evaluation(tmp_path, name, _errors(name, 1.0, 0.5))
    write_evaluation(tmp_path, "failed", _errors("failed", 9.0))
    said = _said(tmp_path)
    assert "failed against" in said and "all: 2 sequences together against the simulator's truth" in said
    assert "failed is not in the figures over all sequences: not all methods were evaluated there" in said
    assert "methods in pairs" in said and "0.50" in said.split("methods in pairs")[1]


def test_rigs_and_splits_are_not_pooled_with_one_another(tmp_path: Path) -> None:
    for name, scale in (("monday", 0.5), ("tuesday", 0.5), ("workshop", 0.9)):
        write_evaluation(tmp_path, name, _errors(name, 1.0, scale))
    said = _said(tmp_path, monday="assembly test", tuesday="assembly test", workshop="desktop test")
    first, second = said.split("all desktop test: 1 sequences, methods in pairs")
    assert "all assembly test: 2 sequences together" in first and "0.50" in first.split("in pairs")[1]
    assert "0.90" in second and "0.50" not in second
