"""How verbs are told from hand poses."""

from pipeline.graph import ACTION_EDGE, CROP_EDGE, MEMBER_EDGE, Dag
from stages import classify_verbs, cut_verb_clips, draw_verb_clips, tabulate_verbs, train_verbs, use_msg3d


def add_verbs(dag: Dag, last: str) -> None:
    """Add how verbs are told from poses (paper, Sec. 5), by our labels or people's: each source of poses has its part.

    The shipped network was trained on poses that the studio drew, the `own_` ones on the source that they are for.
    """
    drawn = {"orders": CROP_EDGE, "chunks": "crop_plan.chunks"}
    dag.add("drawn_verb_clips", draw_verb_clips.STAGE, **drawn)
    dag.add("drawn_verb_weights", train_verbs.STAGE, members=MEMBER_EDGE, clips="drawn_verb_clips.clips")
    _add_classification(dag, "drawn_verbs", "drawn_verb_clips", "drawn_verb_clips", "drawn_verb_weights")
    dag.add("msg3d", use_msg3d.STAGE)
    for suffix, views, annotation, found in (
        ("", "ingest.views", f"{last}.joints", "ego"),
        ("_manual", "ingest_ego.views", "ingest_ego.joints", "manual"),
    ):
        poses = {
            "annotation": annotation,
            "svegonet": f"predict_{found}.joints",
            "ego_only": f"ego_only{suffix}.joints",
        }
        for source, joints in poses.items():
            name = f"{source}{suffix}"
            dag.add(f"clips_{name}", cut_verb_clips.STAGE, actions=ACTION_EDGE, views=views, joints=joints)
            dag.add(f"msg3d_{name}", train_verbs.STAGE, members=MEMBER_EDGE, clips=f"clips_{name}.clips")
            for begin, network in (("", "msg3d"), ("own_", f"msg3d_{name}")):
                _add_classification(dag, f"{begin}verbs_{name}", f"clips_{name}", f"clips_annotation{suffix}", network)
        for begin in ("", "own_"):
            found_verbs = {source: f"{begin}verbs_{source}{suffix}.predictions" for source in poses}
            dag.add(f"{begin}verb_table{suffix}", tabulate_verbs.STAGE, members=MEMBER_EDGE, **found_verbs)


def _add_classification(dag: Dag, name: str, clips: str, reference: str, network: str) -> None:
    tables = {"clips": f"{clips}.clips", "reference": f"{reference}.clips", "weights": f"{network}.weights"}
    dag.add(name, classify_verbs.STAGE, **tables)
