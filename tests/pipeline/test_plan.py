from typing import Any

from pipeline.plan import explain


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
