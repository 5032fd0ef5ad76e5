from pathlib import Path

from pipeline.dag import build_dag
from pipeline.describe import describe

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "tables.md"


def test_the_document_is_what_runs() -> None:
    assert DOCUMENT.read_text(encoding="utf-8") == describe(build_dag()), "the DAG or a table changed: run `make docs`"
