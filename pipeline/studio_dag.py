"""How a synthetic recording is made."""

from pipeline.graph import TAKE_EDGE, Dag
from stages import deliver_recording, film_take, preview_recording, script_take


def add_studio(dag: Dag) -> None:
    """Add how a synthetic recording is made (docs/decisions/0006)."""
    dag.add("script", script_take.STAGE, takes=TAKE_EDGE)
    dag.add("film", film_take.STAGE, takes=TAKE_EDGE, chunks="script.chunks")
    dag.add(
        "delivery",
        deliver_recording.STAGE,
        takes=TAKE_EDGE,
        actions="script.actions",
        footage="film.footage",
        true_joints="film.true_joints",
        true_views="film.true_views",
        true_instants="film.true_instants",
    )
    dag.add("preview", preview_recording.STAGE, takes=TAKE_EDGE, footage="film.footage", true_views="film.true_views")
