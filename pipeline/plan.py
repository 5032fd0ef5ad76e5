"""What a run would do, and why: every node and sequence is reused, run or waiting for something that runs."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from assemblyhands_core.data.store import DamagedEntry, Store
from pipeline.graph import Node
from pipeline.history import History
from pipeline.tasks import Task, find_entry, foresee, key_parts
from pipeline.work import SequenceWork


@dataclass(frozen=True)
class PlannedNode:
    """The plan for one node of one sequence.

    Attributes:
        num_reused, num_to_run: shards; ``num_to_run`` is None while it is not known how many there are.
        reason: why shards run, in a few words.
        seconds: estimate of the work in one process, from earlier runs of the stage; None without any.
        num_bytes: estimate of the room that it will take, likewise.
    """

    sequence_id: str
    node: str
    num_reused: int
    num_to_run: int | None
    reason: str
    seconds: float | None
    num_bytes: float | None = None


def make_plan(
    works: Sequence[SequenceWork], store: Store, history: History, *, is_only_told: bool = False
) -> list[PlannedNode]:
    """Settle every shard whose entry is in the store, and say of the others why they run.

    Args:
        works: The tasks.
        store: Where entries are.
        history: Of earlier runs.
        is_only_told: Nothing runs afterwards: then quick stages are tried out, so that what follows from them is known.
    """
    rows: dict[str, list[PlannedNode]] = {work.recording.sequence_id: [] for work in works}
    for name in works[0].config.dag.nodes if works else ():  # node by node, as what is about all waits for each
        for work in works:
            rows[work.recording.sequence_id] += [
                _plan_node(work, n, store, history, is_only_told) for n in work.nodes if n.name == name
            ]
    return [row for of_work in rows.values() for row in of_work]


def _plan_node(work: SequenceWork, node: Node, store: Store, history: History, is_only_told: bool) -> PlannedNode:
    name = work.recording.sequence_id
    if node not in list(work.known_nodes()):
        cutting = node.chunk_edge.partition(".")[0] or "the sequences are cut"
        room = (history.mean_bytes(node, store) or 0.0) * history.mean_shards(node)
        return PlannedNode(name, node.name, 0, None, f"shards are known after {cutting}", None, room)
    to_run: list[Task] = []
    for task in work.tasks(node):
        if not _settle(work, task, store):
            to_run.append(task)
    num_reused = len(work.shards(node)) - len(to_run)
    reason = _why(work, to_run, store, history)
    if is_only_told and node.stage.is_quick:
        _foresee(work, to_run, store)
    means = history.mean_seconds(node), history.mean_bytes(node, store) if to_run else 0.0
    estimates = [None if mean is None else mean * len(to_run) for mean in means]
    return PlannedNode(name, node.name, num_reused, len(to_run), reason, *estimates)


def _settle(work: SequenceWork, task: Task, store: Store) -> bool:
    """Settle a task whose entry is in the store; return whether it is."""
    if work.missing_upstream(task):
        return False
    result = find_entry(task, work.upstream(task), store)
    if result is None:
        return False
    try:
        work.settle(result, store)
    except DamagedEntry:  # it is set aside, so the task runs
        return False
    return True


def _foresee(work: SequenceWork, tasks: Sequence[Task], store: Store) -> None:
    """Settle tasks by what they would give; not those that wait for others, or would fail."""
    for task in tasks:
        result = None if work.missing_upstream(task) else foresee(task, work.upstream(task))
        if result is not None:
            work.settle(result, store)


def _why(work: SequenceWork, to_run: Sequence[Task], store: Store, history: History) -> str:
    reasons = Counter(_why_task(work, task, store, history) for task in to_run)
    return "; ".join(reason for reason, _ in reasons.most_common(2))


def _why_task(work: SequenceWork, task: Task, store: Store, history: History) -> str:
    if running := work.missing_upstream(task):
        return f"{', '.join(running)} runs first"
    if task.problem:
        return task.problem
    old = history.last_record(task.node, task.shard, store)
    if old is None:
        return "not computed before"
    differences = explain(old.parts, key_parts(task, work.upstream(task)))
    return ", ".join(differences) or "its entry is gone"


def explain(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """Return what differs between two shards' key parts, e.g. ``max_reprojection_px 10.0 → 8.0``."""
    found = [f"{part} {old[part]} → {new[part]}" for part in ("stage", "version") if old[part] != new[part]]
    changed_roles = set(old["inputs"]) ^ set(new["inputs"])  # their tables say nothing more
    for part in ("config", "externals", "tables"):
        before, after = old[part], new[part]
        names = sorted(name for name in {**before, **after} if before.get(name) != after.get(name))
        names = [name for name in names if part != "tables" or name not in changed_roles]
        found += [f"{name} {_short(before.get(name, 'unset'))} → {_short(after.get(name, 'unset'))}" for name in names]
    roles = dict.fromkeys([*new["inputs"], *old["inputs"]])
    return found + [
        f"input {role} {change}" for role in roles if (change := _change(old["inputs"], new["inputs"], role))
    ]


def _change(old: Mapping[str, Any], new: Mapping[str, Any], role: str) -> str:
    if role not in old:
        return "is new"
    if role not in new:
        return "is gone"
    return "" if old[role] == new[role] else "differs"


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 24 else f"{text[:12]}…"


def total_seconds(rows: Sequence[PlannedNode], num_workers: int) -> float | None:
    """Return the estimated wall time of a plan, or None if a node that runs has no earlier timing."""
    estimates = [row.seconds for row in rows if row.num_to_run != 0]
    return None if None in estimates else sum(s for s in estimates if s is not None) / num_workers


def total_bytes(rows: Sequence[PlannedNode]) -> float:
    """Return the estimated room that a plan will take, as far as earlier runs tell."""
    return sum(row.num_bytes or 0.0 for row in rows)
