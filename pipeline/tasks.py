"""One shard of one node: resolve its key from what it reads, then reuse the store's entry or compute it.

Everything that crosses a process boundary here is small: names, digests, counts. Tables stay in the store.
"""

import time
import traceback
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import pyarrow as pa

from assemblyhands_core.data.digests import digest_json
from assemblyhands_core.data.entry_records import Output, Record
from assemblyhands_core.data.store import DamagedEntry, Store
from assemblyhands_core.training.scratch import remove_idle
from pipeline.graph import ORIGINS, Node
from pipeline.shard_log import shard_log
from stages._contract import Context, Stage, StageConfig

Status = Literal["reused", "done", "failed", "blocked"]

SET_NAME: Final = "all-sequences"
"""Stands for the sequence in the shards of nodes that are about all of a run's."""
_MAX_NAMED: Final = 2  # sequences in a sentence; their names are long


@dataclass(frozen=True, order=True)
class Shard:
    """A sequence, or one chunk of its frames."""

    sequence_id: str
    chunk: int | None = None

    def __str__(self) -> str:
        return self.sequence_id if self.chunk is None else f"{self.sequence_id}.{self.chunk:05d}"


@dataclass(frozen=True)
class Task:
    """What a worker needs to run one shard of one node.

    Attributes:
        config: the stage's parameters, validated.
        externals: what the result depends on beyond config and tables, as the stage said once for the whole run.
        problem: why the stage cannot run at all (a package or file is missing); empty if it can.
        origins: for each edge of `ORIGINS` that the node reads, its rows.
        workspace, log: where the store and this shard's log lie.
        num_threads: threads that the stage may use.
    """

    node: Node
    shard: Shard
    config: StageConfig
    externals: Mapping[str, str]
    problem: str
    origins: Mapping[str, Sequence[Mapping[str, Any]]]
    workspace: Path
    log: Path
    num_threads: int = 1


@dataclass(frozen=True)
class Result:
    """What became of a task: where its entry lies, or why there is none.

    Attributes:
        key, outputs: the entry's key and its tables' digests and counts; empty when failed or blocked.
        seconds: the time that making the entry took, whenever that was.
        error: a sentence for the user, when failed or blocked.
        blocked_by: the sequences of which something failed that a blocked shard needs.
        is_repairable: the failure was a damaged store entry, now set aside; running again rebuilds it.
    """

    node: str
    shard: Shard
    status: Status
    key: str = ""
    outputs: Mapping[str, Output] = field(default_factory=dict)
    seconds: float = 0.0
    error: str = ""
    is_repairable: bool = False
    blocked_by: frozenset[str] = frozenset()

    @property
    def has_entry(self) -> bool:
        """Whether other shards can read this one's tables."""
        return self.status in ("reused", "done")

    @property
    def culprits(self) -> frozenset[str]:
        """The sequences on whose account there is no entry; none where what is about all of them failed itself."""
        if self.status == "failed" and self.shard.sequence_id != SET_NAME:
            return frozenset({self.shard.sequence_id})
        return self.blocked_by


Upstream = Mapping[str, Sequence[Result]]


def key_parts(task: Task, upstream: Upstream) -> dict[str, Any]:
    """Return everything that a shard's outcome depends on; its digest is the shard's key."""
    stage, edges = task.node.stage, _filled(task, upstream)
    specs = {**{role: stage.inputs[role] for role in edges}, **stage.outputs}
    return {
        "stage": stage.name,
        "version": stage.version,
        "tables": {name: f"{spec.name} v{spec.version}" for name, spec in specs.items()},
        "config": task.config.model_dump(mode="json"),
        "externals": dict(task.externals),
        "inputs": {role: _input_digests(task, edge, upstream) for role, edge in edges.items()},
    }


def scratch_folder(workspace: Path, stage: str, key: str) -> Path:
    """Return the folder of all computations of an entry; an interrupted one goes on from there."""
    return workspace / "scratch" / f"{stage}-{key[:16]}"


def find_entry(task: Task, upstream: Upstream, store: Store) -> Result | None:
    """Return the result of a shard whose entry is already in the store."""
    if task.problem:
        return None
    stage = task.node.stage
    record = store.find(stage.name, digest_json(key_parts(task, upstream)))
    return None if record is None else _result(task, "reused", record)


def run_task(task: Task, upstream: Upstream) -> Result:
    """Reuse or compute one shard; errors become results, so that they stop only what depends on them."""
    if lacking := [result for results in upstream.values() for result in results if not result.has_entry]:
        return _blocked(task, lacking)
    if task.problem:
        return Result(task.node.name, task.shard, "failed", error=task.problem)
    store = Store(task.workspace)
    try:
        return find_entry(task, upstream, store) or _compute(task, upstream, store)
    except DamagedEntry as error:
        return Result(task.node.name, task.shard, "failed", error=str(error), is_repairable=True)
    except Exception as error:  # the boundary of a shard: whatever a stage raises must not stop other shards
        return _made_by_another(task, upstream, store) or _failed(task, error)


def _made_by_another(task: Task, upstream: Upstream, store: Store) -> Result | None:
    """Return the result of a shard that failed here if somebody else has made its entry meanwhile."""
    with suppress(Exception):  # what failed before may fail once more: that is told
        return find_entry(task, upstream, store)
    return None


def _failed(task: Task, error: Exception) -> Result:
    """Return the result of a task that failed, and note where in its log."""
    with suppress(OSError):  # the disk may be full: then the sentence has to do
        task.log.parent.mkdir(parents=True, exist_ok=True)
        with task.log.open("a") as log:
            log.write("".join(traceback.format_exception(error)))
    return Result(task.node.name, task.shard, "failed", error=_sentence(error))


def _blocked(task: Task, lacking: Sequence[Result]) -> Result:
    """Return the result of a task that cannot run, as something that it reads is not there.

    Where that is another sequence's, which may be one of hundreds, it is named with the remedy.
    """
    culprits = frozenset[str]().union(*(result.culprits for result in lacking))
    error = f"needs {', '.join(sorted({result.node for result in lacking}))}"
    if others := sorted(culprits - {task.shard.sequence_id}):
        num_more = len(others[_MAX_NAMED:])
        named = ", ".join(others[:_MAX_NAMED]) + (f" and {num_more} more" if num_more else "")
        them, name = ("them", "NAME for each") if len(others) > 1 else ("it", others[0])
        error += f", but {named} failed: put {them} right, or leave {them} out by adding ,-{name} to seq="
    return Result(task.node.name, task.shard, "blocked", error=error, blocked_by=culprits)


def foresee(task: Task, upstream: Upstream) -> Result | None:
    """Return what running a quick stage would give, and leave nothing behind; None where it would fail."""
    stage, store = task.node.stage, Store(task.workspace)
    try:
        inputs = _inputs(task, upstream, store)
        tables = stage.run(task.config, inputs, Context(Path(), task.shard.sequence_id))
    except (ValueError, OSError):  # the run itself will say so
        return None
    outputs = {
        name: Output(spec.digest(tables[name]), tables[name].num_rows, 0) for name, spec in stage.outputs.items()
    }
    return Result(task.node.name, task.shard, "done", digest_json(key_parts(task, upstream)), outputs)


def _compute(task: Task, upstream: Upstream, store: Store) -> Result:
    stage: Stage[Any] = task.node.stage
    started = time.perf_counter()
    inputs = _inputs(task, upstream, store)
    with store.draft(stage.name, key_parts(task, upstream)) as draft:
        scratch = scratch_folder(task.workspace, stage.name, draft.key)
        context = Context(draft.folder, task.shard.sequence_id, task.num_threads, scratch)
        with shard_log(task.log):
            tables = stage.run(task.config, inputs, context)
        if set(tables) != set(stage.outputs):
            raise ValueError(f"stage {stage.name} returned {sorted(tables)} instead of {sorted(stage.outputs)}")
        checked = {name: (spec, tables[name]) for name, spec in stage.outputs.items()}
        record = draft.write(checked, time.perf_counter() - started)
    remove_idle(scratch)
    # Another run may have been first, on a GPU perhaps: what counts is what is there.
    return _result(task, "done", store.find(stage.name, draft.key) or record)


def _result(task: Task, status: Status, record: Record) -> Result:
    return Result(task.node.name, task.shard, status, record.key, record.outputs, record.seconds)


def _filled(task: Task, upstream: Upstream) -> dict[str, str]:
    """Return role → edge of what a shard reads: optional roles only where they have rows."""
    optional = task.node.stage.optional
    edges = task.node.inputs.items()
    return {role: edge for role, edge in edges if role not in optional or _has_rows(task, edge, upstream)}


def _has_rows(task: Task, edge: str, upstream: Upstream) -> bool:
    if edge in ORIGINS:
        return bool(task.origins[edge])
    node, output = edge.split(".")
    return any(result.outputs[output].num_rows for result in upstream[node])


def _input_digests(task: Task, edge: str, upstream: Upstream) -> list[str]:
    if edge in ORIGINS:
        return [ORIGINS[edge].digest(ORIGINS[edge].from_rows(task.origins[edge]))]
    node, output = edge.split(".")
    slice_name = f"#{task.shard.chunk}" if _is_sliced(task, edge) else ""
    return [result.outputs[output].digest + slice_name for result in upstream[node]]


def _inputs(task: Task, upstream: Upstream, store: Store) -> dict[str, pa.Table]:
    return {role: _read_input(task, role, edge, upstream, store) for role, edge in _filled(task, upstream).items()}


def _read_input(task: Task, role: str, edge: str, upstream: Upstream, store: Store) -> pa.Table:
    if edge in ORIGINS:
        return ORIGINS[edge].from_rows(task.origins[edge])
    node, output = edge.split(".")
    spec = task.node.stage.inputs[role]
    records = [store.await_entry(task.node.upstream_stages[node], result.key) for result in upstream[node]]
    table = pa.concat_tables([spec.empty(), *(store.read(record, output, spec) for record in records)])
    if _is_sliced(task, edge):
        table = table.filter(pa.compute.equal(table.column("chunk"), task.shard.chunk))
    return table


def _is_sliced(task: Task, edge: str) -> bool:
    """Whether a chunk reads only its own rows of a table that covers the whole sequence."""
    return task.shard.chunk is not None and edge == task.node.chunk_edge


def _sentence(error: Exception) -> str:
    text = str(error).strip() or "no message"
    return text if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: {text}"
