import json
from typing import Any

from pipeline.history import History
from pipeline.view import node_digest


def test_the_view_has_a_folder_a_node_with_links_that_survive_a_move(toy: Any) -> None:
    found = toy.run("mine")
    run = toy.workspace / "runs" / "mine"
    assert (toy.workspace / "runs" / "latest").resolve() == run
    assert sorted(path.name for path in (run / "times" / "numbers").iterdir()) == [
        "one.00000.parquet",
        "one.00001.parquet",
    ]
    assert json.loads((run / "cut" / "manifest.json").read_text())["tables"] == ["numbers", "chunks"]
    provenance = json.loads((run / "run.json").read_text())
    assert provenance["digests"]["total"] == node_digest(found, "total")
    assert provenance["config"]["stages"]["multiply"] == {"factor": 2.0, "is_rounded": False}
    moved = toy.folder / "moved"
    toy.workspace.rename(moved)
    assert (moved / "runs" / "mine" / "total" / "numbers" / "one.parquet").resolve(strict=True).is_file()


def test_failures_stand_in_the_view(toy: Any) -> None:
    toy.record("bad", 1, float("nan"))
    toy.run()
    failures = json.loads((toy.workspace / "runs/latest/run.json").read_text())["failures"]
    assert [(item["node"], item["shard"], item["status"]) for item in failures] == [
        ("times", "bad.00000", "failed"), ("total", "bad", "blocked"),
    ]  # fmt: skip


def test_a_digest_of_a_node_is_its_contents(toy: Any) -> None:
    first = node_digest(toy.run(), "times")
    assert node_digest(toy.run(), "times") == first
    toy.factor = 3.0
    assert node_digest(toy.run(), "times") != first


def test_history_is_newest_first_and_survives_a_broken_manifest(toy: Any) -> None:
    toy.run("a")
    toy.run("b")
    assert {run.name for run in History(toy.workspace).runs} == {"a", "b"}
    (toy.workspace / "runs/b/times/manifest.json").write_text("{")
    node = toy.config().dag.nodes["times"]
    assert History(toy.workspace).mean_seconds(node) is not None
