import itertools
import re
from pathlib import Path

from pipeline.dag import build_dag
from pipeline.describe import describe

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_the_document_is_what_runs() -> None:
    assert (DOCS / "tables.md").read_text(encoding="utf-8") == describe(build_dag()), (
        "the DAG or a table changed: run `make docs`"
    )


def test_the_picture_of_the_dag_is_true() -> None:
    block = (DOCS / "architecture.md").read_text().split("## The DAG")[1].split("```")[1]
    dags = build_dag(), build_dag(is_ego_trained=True)
    there = {(name, node.name) for dag in dags for node in dag.nodes.values() for name in node.upstream}
    arrows = [(chain.split(" → ")) for chain in re.findall(r"\w+(?: → \w+)+", block)]
    pairs = {pair for chain in arrows for pair in itertools.pairwise(chain)}
    assert len(pairs) > 40
    assert pairs - there == set()
