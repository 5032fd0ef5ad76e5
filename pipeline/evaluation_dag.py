"""How an annotation is held against the truth."""

from pipeline.annotation_dag import add_round
from pipeline.graph import TRUTH_EDGE, Dag
from stages import evaluate, start_from_truth


def add_evaluations(dag: Dag, num_rounds: int) -> tuple[str, ...]:
    """Add how each round is held against the truth, on its own, so that a further round leaves the others' figures.

    Beside them the upper bound: a round that starts from the truth, which nothing but its own evaluation reads.
    """
    dag.add("true_start", start_from_truth.STAGE, truth=TRUTH_EDGE, chunks="ingest.chunks")
    add_round(dag, "upper_bound", "round_0", *["true_start"] * 2)
    add_evaluation(dag, "evaluation_bound", "upper_bound")
    add_evaluation(dag, "evaluation_smoothed", "smoothed")
    names = tuple(f"evaluation_{number}" for number in range(num_rounds + 1))
    for number, name in enumerate(names):
        add_evaluation(dag, name, f"round_{number}")
    return names


def add_evaluation(dag: Dag, name: str, judged: str, cut_by: str = "ingest") -> None:
    """Add how a node's joints are held against the truth, in the chunks into which a node cuts the sequence."""
    dag.add(name, evaluate.STAGE, chunks=f"{cut_by}.chunks", truth=TRUTH_EDGE, joints=f"{judged}.joints")
