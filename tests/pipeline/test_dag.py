import pickle
from dataclasses import replace

import pytest

from assemblyhands_core.data.catalog import CHUNKS, SOURCES, VIEWS
from pipeline.dag import build_dag
from pipeline.graph import CORRECTION_EDGE, JUDGED_EDGE, SOURCE_EDGE, TRUTH_EDGE, Dag
from stages._contract import Stage, StageConfig


def _stage(**inputs: object) -> Stage:
    return Stage("s", 1, StageConfig, inputs, {"chunks": CHUNKS}, lambda *_: {}, "sequence")


def test_the_pipeline_has_the_nodes_that_others_rely_on() -> None:
    wanted = {"ingest", "undistort", "detect_hands", "crop_hands", "detect_keypoints", "round_0"}
    for num_rounds in (0, 1, 3):
        dag = build_dag(num_rounds)
        assert wanted <= set(dag.nodes)
        assert all(target in dag.nodes for targets in dag.targets.values() for target in targets)


def test_a_target_takes_what_it_needs_and_no_more() -> None:
    assert [node.name for node in build_dag().upto(("audit",))] == ["ingest", "audit"]
    assert [node.name for node in build_dag().upto(("detect_hands",))] == ["ingest", "undistort", "detect_hands"]


def test_the_last_round_is_what_is_shown_and_earlier_ones_are_the_same_whatever_comes_after() -> None:
    for num_rounds in (0, 1, 2, 3):
        dag = build_dag(num_rounds)
        shown = [node.name for node in dag.upto(dag.targets["annotate"]) if node.name.startswith("round_")]
        assert shown == [f"round_{number}" for number in range(num_rounds + 1)]
        for name in ("quality", "overlay"):
            assert dag.nodes[name].inputs["joints"] == f"round_{num_rounds}.joints"
        assert all(dag.nodes[name] == build_dag().nodes[name] for name in shown)


def test_an_absent_origin_takes_out_all_that_it_leads_to() -> None:
    dag = Dag()
    dag.add("first", _stage(sources=SOURCES), sources=SOURCE_EDGE)
    dag.add("judged", _stage(truth=SOURCES, chunks=CHUNKS), truth=TRUTH_EDGE, chunks="first.chunks")
    dag.add("report", _stage(chunks=CHUNKS), chunks="judged.chunks")
    dag.add("last", _stage(chunks=CHUNKS), chunks="first.chunks")
    assert [node.name for node in dag.upto(("report", "last"))] == ["first", "judged", "report", "last"]
    assert [node.name for node in dag.upto(("report", "last"), (TRUTH_EDGE,))] == ["first", "last"]
    assert dag.upto(("report",), (TRUTH_EDGE,)) == []


@pytest.mark.parametrize("target", ["cross", "train_ego", "label_quality", "ego_evaluation_automatic"])
def test_what_a_network_learns_from_is_not_predicted_by_it(target: str) -> None:
    dag = build_dag()
    targets = dag.targets.get(target, (target,))
    judged = {node.name for node in dag.upto(targets)}
    learnt_from = {node.name for node in dag.upto(targets, (JUDGED_EDGE,))}
    trained = {name for name in judged if name.startswith("svegonet_")}
    assert trained and trained <= learnt_from
    assert {name for name in judged - learnt_from if not name.startswith("project_")} == {
        f"{node}_{crops}_{name.removeprefix('svegonet_')}"
        for node in ("predict", "errors")
        for crops in ("ego", "manual")
        for name in trained
    }


def test_what_annotates_does_not_depend_on_the_truth() -> None:
    dag = build_dag()
    readers = {node.name for node in dag.nodes.values() if TRUTH_EDGE in node.inputs.values()}
    assert {dag.nodes[name].stage.name for name in readers} == {"evaluate", "start_from_truth"}
    wanted = {node.name for node in dag.upto(dag.targets["annotate"])}
    without = {node.name for node in dag.upto(dag.targets["annotate"], (TRUTH_EDGE,))}
    assert wanted - without == {f"evaluation_{number}" for number in range(4)}
    after = {node.name for node in dag.nodes.values()} - {
        node.name for node in dag.upto(tuple(dag.nodes), (TRUTH_EDGE,))
    }
    assert after - readers == {"upper_bound"}, "what starts from the truth is read by its own evaluation alone"


@pytest.mark.parametrize(
    ("inputs", "edges", "message"),
    [
        ({"views": VIEWS}, {"views": "later.views"}, "no node later comes before it"),
        ({"views": VIEWS}, {"views": "first.views"}, "first has only chunks"),
        ({"views": VIEWS}, {"views": "first.chunks"}, "takes table views, first.chunks is table chunks"),
        ({"views": VIEWS}, {}, "has the roles ['views'], not []"),
        ({"sources": VIEWS}, {"sources": SOURCE_EDGE}, "takes table views, sources is table sources"),
    ],
)
def test_a_wrong_edge_is_named(inputs: dict[str, object], edges: dict[str, str], message: str) -> None:
    dag = Dag()
    dag.add("first", _stage(sources=SOURCES), sources=SOURCE_EDGE)
    with pytest.raises(ValueError, match="node second") as caught:
        dag.add("second", _stage(**inputs), **edges)
    assert message in str(caught.value)


def test_a_repeated_name_is_refused() -> None:
    dag = Dag()
    dag.add("first", _stage(sources=SOURCES), sources=SOURCE_EDGE)
    with pytest.raises(ValueError, match="added twice"):
        dag.add("first", _stage(sources=SOURCES), sources=SOURCE_EDGE)


def test_a_node_is_cut_as_it_is_told_and_chunks_of_two_kinds_do_not_mix() -> None:
    dag = Dag()
    for name in ("coarse", "fine"):
        dag.add(name, _stage(sources=SOURCES), sources=SOURCE_EDGE)
    chunked = replace(_stage(chunks=CHUNKS), outputs={"views": VIEWS}, shard="chunk")
    dag.add("one", chunked, chunks="coarse.chunks")
    dag.add(
        "other", replace(chunked, inputs={"chunks": CHUNKS, "more": CHUNKS}), chunks="fine.chunks", more="coarse.chunks"
    )
    assert (dag.nodes["one"].chunk_edge, dag.nodes["other"].chunk_edge) == ("coarse.chunks", "fine.chunks")
    mixed = replace(chunked, inputs={"chunks": CHUNKS, "views": VIEWS})
    with pytest.raises(ValueError, match=r"node mixed is cut by coarse\.chunks, other by fine\.chunks"):
        dag.add("mixed", mixed, chunks="coarse.chunks", views="other.views")
    whole = replace(mixed, shard="sequence")
    dag.add("whole", whole, chunks="coarse.chunks", views="other.views")


def test_an_optional_role_may_stay_empty() -> None:
    dag = Dag()
    dag.add("first", _stage(sources=SOURCES), sources=SOURCE_EDGE)
    dag.add("extra", _stage(truth=SOURCES), truth=TRUTH_EDGE)
    optional = replace(_stage(chunks=CHUNKS, more=CHUNKS), optional=frozenset({"more"}))
    dag.add("both", optional, chunks="first.chunks", more="extra.chunks")
    dag.add("alone", optional, chunks="first.chunks")
    with pytest.raises(ValueError, match="node odd: stage s has the roles"):
        dag.add("odd", optional, more="extra.chunks")
    assert [node.name for node in dag.upto(("both",))] == ["first", "extra", "both"]
    first, both = dag.upto(("both",), (TRUTH_EDGE,))
    assert (first.name, both.name, dict(both.inputs)) == ("first", "both", {"chunks": "first.chunks"})
    assert both.upstream == ("first",) and both.chunk_edge == dag.nodes["both"].chunk_edge


def test_the_upper_bound_knows_of_no_corrections() -> None:
    dag = build_dag()
    readers = {node.name for node in dag.nodes.values() if "corrections.corrections" in node.inputs.values()}
    assert readers == {"round_0", "round_1", "round_2", "round_3"}
    without = {node.name: node for node in dag.upto(dag.targets["annotate"], (CORRECTION_EDGE,))}
    assert readers < set(without) and "corrections" not in without
    assert all("corrections" not in node.inputs for node in without.values())


def test_a_node_is_pickled_once_and_comes_back_as_it_was() -> None:
    dag = build_dag()
    node = dag.nodes["round_1"]
    first, again = pickle.dumps(node), pickle.dumps(node)
    assert first == again and pickle.loads(first) == node and pickle.loads(first) is pickle.loads(again)
    other = node.without({"corrections"}) if "corrections" in node.stage.optional else dag.nodes["round_2"]
    assert pickle.loads(pickle.dumps(other)) == other != node
