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
from pipeline.evaluation import pools, print_evaluation, read_errors, read_metrics


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


def test_what_the_headset_alone_sees_has_figures_of_its_own_by_whose_crops(tmp_path: Path) -> None:
    """Both nodes call their method the same, and not every recording has a headset."""
    for name in ("monday", "tuesday"):
        write_evaluation(tmp_path, name, _errors(name, 1.0, 0.5))
    for node, error_mm in (("evaluation_ego_only", 30.0), ("evaluation_ego_only_manual", 40.0)):
        errors = errors_table({"ego_triangulation": np.full((20, 2), error_mm)}, sequence_id="monday")
        write_evaluation(tmp_path / node, "monday", errors)
        (tmp_path / node / "evaluation_bound").rename(tmp_path / node / "moved")
        for table in ("errors", "metrics"):
            (tmp_path / node / "moved" / table).rename(tmp_path / node / table)
    said = _said(tmp_path)
    assert "all: 2 sequences together" in said and "left" not in said
    own, pairs = said.split("monday against")[1].split("all, headset alone: 1 sequences, methods in pairs")
    assert "30.00" in own and "40.00" in own and "ego_triangulation, people's crops" in own
    assert "1.33" in pairs or "0.75" in pairs
    errors = read_errors(tmp_path)
    assert [pool.name for pool in pools(errors, {})] == ["all", "all, headset alone"]
    assert {row["row"] for row in read_metrics(tmp_path) if "ego" in row["row"]} == {
        "ego_triangulation", "ego_triangulation, people's crops"}  # fmt: skip
