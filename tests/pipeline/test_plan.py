import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipeline.config import UserError
from pipeline.disk_space import check_space, space_sentence
from pipeline.plan import PlannedNode, explain


def test_before_ingest_the_shards_are_unknown(toy: Any) -> None:
    plan = toy.plan()
    assert (plan["one", "cut"].num_to_run, plan["one", "cut"].reason) == (1, "not computed before")
    assert plan["one", "times"].num_to_run is None


def test_nothing_to_do_after_a_run(toy: Any) -> None:
    toy.run()
    assert [(row.num_reused, row.num_to_run) for row in toy.plan().values()] == [(1, 0), (2, 0), (1, 0)]


def test_plan_names_the_parameter_that_differs_with_both_values(toy: Any) -> None:
    toy.run()
    toy.factor = 2.5
    plan = toy.plan()
    assert plan["one", "cut"].num_to_run == 0
    assert (plan["one", "times"].num_to_run, plan["one", "times"].reason) == (2, "factor 2.0 → 2.5")
    assert plan["one", "total"].reason == "times runs first"


def test_plan_names_a_new_version(toy: Any) -> None:
    toy.run()
    toy.version = 2
    assert toy.plan()["one", "times"].reason == "version 1 → 2"


def test_plan_names_the_input_that_differs(toy: Any) -> None:
    toy.run()
    toy.record("one", 1, 2, 3, 4, 6)
    assert toy.plan()["one", "cut"].reason == "input sources differs"


def test_plan_changes_nothing(toy: Any) -> None:
    toy.plan()
    assert not toy.store.root.exists()


def test_estimates_come_from_earlier_runs(toy: Any) -> None:
    assert toy.plan()["one", "cut"].seconds is None
    toy.run()
    toy.factor = 2.5
    assert toy.plan()["one", "times"].seconds is not None


def test_explain_is_empty_for_equal_parts() -> None:
    parts = {"stage": "s", "version": 1, "config": {"a": 1}, "externals": {}, "tables": {}, "inputs": {"x": ["d"]}}
    assert explain(parts, parts) == []
    assert explain(parts, {**parts, "config": {"b": 1}}) == ["a 1 → unset", "b unset → 1"]


def test_the_room_of_a_plan_is_what_its_nodes_took_before(toy: Any) -> None:
    assert toy.plan()["one", "cut"].num_bytes is None, "nothing is known yet"
    toy.run()
    entries = [path for path in (toy.store.root / "multiply").iterdir() if not path.name.startswith(".")]
    sizes = [sum(path.stat().st_size for path in entry.iterdir()) for entry in entries]
    assert len(sizes) == 2 and min(sizes) > 0
    toy.factor = 2.5
    plan = toy.plan()
    assert plan["one", "times"].num_bytes == pytest.approx(sum(sizes)) and plan["one", "cut"].num_bytes == 0
    toy.record("two", 1, 2, 3)
    assert toy.plan()["two", "times"].num_bytes == pytest.approx(sum(sizes)), "as many shards as another sequence has"


def test_a_plan_that_does_not_fit_on_the_disk_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = 3e9
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=free))
    rows = [PlannedNode("one", name, 0, 1, "", None, size) for name, size in (("a", 1e9), ("b", None), ("c", 2e9))]
    check_space(tmp_path, rows)
    free = 2.9e9
    with pytest.raises(
        UserError, match=r"about 3\.0 GB, by what earlier ones took, and .* has 2\.9 GB left: run `make gc`"
    ):
        check_space(tmp_path, rows)
    assert space_sentence(tmp_path, rows) == "estimated room: 3.0 of 2.9 GB"
