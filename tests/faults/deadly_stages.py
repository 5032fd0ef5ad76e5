"""A pipeline one of whose shards kills the process that runs it, run by Dask as the real one is."""

import json
import os
import signal
import sys
from pathlib import Path

import pyarrow as pa
from rich.console import Console

from assemblyhands_core.data.catalog import CHUNKS, SOURCES
from assemblyhands_core.data.store import Store
from pipeline.config import GcConfig, RigConfig, RunConfig
from pipeline.executor_config import LocalConfig
from pipeline.executors import open_executor
from pipeline.graph import SOURCE_EDGE, Dag
from pipeline.progress import Progress
from pipeline.recordings import Recording
from pipeline.runner import Runner, results
from pipeline.work import SequenceWork
from stages._contract import Context, Stage, StageConfig, Tables

NUM_CHUNKS = 6
DEADLY = ("one", 2)


class NoConfig(StageConfig):
    """No parameters."""


def cut(config: NoConfig, inputs: Tables, context: Context) -> Tables:
    """Cut a recording into chunks."""
    name = context.sequence_id
    rows = [{"sequence_id": name, "chunk": c, "first_frame": c, "num_frames": 1} for c in range(NUM_CHUNKS)]
    return {"chunks": CHUNKS.from_rows(rows)}


def work(config: NoConfig, inputs: Tables, context: Context) -> Tables:
    """Pass a chunk on, or die of it."""
    if (context.sequence_id, inputs["chunks"]["chunk"][0].as_py()) == DEADLY:
        os.kill(os.getpid(), signal.SIGKILL)
    return {"chunks": inputs["chunks"]}


def gather(config: NoConfig, inputs: Tables, context: Context) -> Tables:
    """Put a sequence's chunks together again."""
    return {"chunks": pa.concat_tables([inputs["chunks"]])}


def deadly_dag() -> Dag:
    """Return a DAG that cuts, works on each chunk, and gathers."""
    chunks = {"chunks": CHUNKS}
    dag = Dag()
    dag.add("cut", Stage("cut", 1, NoConfig, {"sources": SOURCES}, chunks, cut, "sequence"), sources=SOURCE_EDGE)
    dag.add("work", Stage("work", 1, NoConfig, chunks, chunks, work, "chunk"), chunks="cut.chunks")
    dag.add("gather", Stage("gather", 1, NoConfig, chunks, chunks, gather, "sequence"), chunks="work.chunks")
    return dag


def main(workspace: Path) -> None:
    """Run the pipeline over two sequences; write what became of every shard as JSON to standard output."""
    config = RunConfig(
        seq="all", target="gather", manifest=None, release=None, workspace=workspace, run="", rounds=0,
        gc=GcConfig(keep_runs=1, dry_run=False),
        rig=RigConfig(calibration=None, videos=None),
        executor=LocalConfig(name="local", num_workers=2, memory_limit="auto"),
    )  # fmt: skip
    config._dag, config._stages = deadly_dag(), {name: NoConfig() for name in ("cut", "work", "gather")}
    nodes = list(config.dag.nodes.values())
    works = [
        SequenceWork(
            config, Recording(name, Path(__file__), {}), {SOURCE_EDGE: _source(name)}, nodes, workspace / "logs"
        )
        for name in ("one", "two")
    ]
    with open_executor(config.executor, workspace, "token") as executor, Progress(Console(quiet=True)) as progress:
        Runner(works, executor, Store(workspace), progress).run()
    found = [[result.node, str(result.shard), result.status, result.error] for result in results(works)]
    json.dump(found, sys.stdout)


def _source(sequence_id: str) -> tuple[dict[str, str], ...]:
    row = {"role": "video", "name": "a", "source_file": __file__, "sha256": ""}
    return ({"sequence_id": sequence_id, **row},)
