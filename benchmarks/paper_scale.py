"""The engine alone, at the size of the paper's set: 34 subjects, 293 000 instants, every stage does nothing.

    python benchmarks/paper_scale.py [--subjects 34] [--instants 293000] [--workspace FOLDER]

Plans the real DAG (targets annotate and predict) with stages that give empty tables; runs half of the subjects on two
workers, plans everything again, goes on, and plans the finished run. *Beyond Dask's own* is what the thread that
schedules spends on a task more than on one that Dask is given alone, as many at a time as we do.
"""

import argparse
import resource
import shutil
import tempfile
import time
import uuid
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from rich.console import Console

from assemblyhands_core.data.catalog import CHUNKS
from assemblyhands_core.data.store import Store
from assemblyhands_core.data.tables import TableSpec
from pipeline.config import CONF_FOLDER, RunConfig, check_config
from pipeline.dask_executor import DaskExecutor
from pipeline.graph import EGO_EDGE, SOURCE_EDGE, Dag
from pipeline.history import History
from pipeline.local_cluster import local_workers
from pipeline.plan import make_plan
from pipeline.progress import Progress
from pipeline.recordings import Recording
from pipeline.runner import Runner, results
from pipeline.view import write_view
from pipeline.work import SequenceWork, with_set
from stages._contract import Context, StageConfig, Tables, no_externals

CHUNK_FRAMES = 128
_NUM_ALONE = 1000


def do_nothing(
    outputs: Mapping[str, TableSpec], num_frames: int, config: StageConfig, inputs: Tables, context: Context
) -> Tables:
    """Give empty tables, and where a stage cuts a sequence into chunks, these."""
    starts = range(0, num_frames, CHUNK_FRAMES)
    rows = [
        {
            "sequence_id": context.sequence_id,
            "chunk": chunk,
            "first_frame": first,
            "num_frames": min(CHUNK_FRAMES, num_frames - first),
        }
        for chunk, first in enumerate(starts)
    ]
    return {name: spec.from_rows(rows if spec.name == CHUNKS.name else []) for name, spec in outputs.items()}


def null_dag(dag: Dag, num_frames: int) -> None:
    """Put stages that do nothing in the place of all of a DAG's."""
    for name, node in dag.nodes.items():
        run = partial(do_nothing, dict(node.stage.outputs), num_frames)
        dag.nodes[name] = replace(node, stage=replace(node.stage, run=run, externals=no_externals, is_quick=False))


def works(workspace: Path, num_subjects: int, num_instants: int) -> list[SequenceWork]:
    """Return the tasks of the whole set."""
    with initialize_config_dir(str(CONF_FOLDER), version_base="1.3"):
        config: RunConfig = check_config(compose("config", [f"workspace={workspace}", "target=annotate"]))
    config.dag.targets["annotate"] = ("quality", "overlay", "predict_ego", "ego_evaluation", "ego_sheet")
    null_dag(config.dag, num_instants // num_subjects)
    row = {"role": "video", "name": "a", "source_file": __file__, "sha256": ""}
    found = []
    for number in range(num_subjects):
        name = f"subject-{number:02d}"
        rows = ({"sequence_id": name, **row},)
        origins = {edge: rows if edge in (SOURCE_EDGE, EGO_EDGE) else () for edge in _origins(config.dag)}
        absent = [edge for edge, there in origins.items() if not there and edge != "members"]
        nodes = [node for node in config.dag.upto(config.wanted_nodes, absent) if node.shard != "set"]
        found.append(SequenceWork(config, Recording(name, Path(__file__), {}), origins, nodes, workspace / "logs"))
    return with_set(found, {work.recording.sequence_id: "test" for work in found})


def _origins(dag: Dag) -> set[str]:
    return {edge for node in dag.nodes.values() for edge in node.inputs.values() if "." not in edge}


def _timed(action: Callable[[], Any]) -> tuple[Any, float, float]:
    wall, cpu = time.perf_counter(), time.thread_time()
    found = action()
    return found, time.perf_counter() - wall, time.thread_time() - cpu


def _run(workers: Any, sequences: list[SequenceWork], workspace: Path) -> int:
    """Run what is not settled; return how many tasks that were."""
    before = len(results(sequences))
    with Progress(Console(quiet=True)) as progress:
        Runner(sequences, DaskExecutor(workers, uuid.uuid4().hex), Store(workspace), progress).run()
    assert all(result.has_entry for result in results(sequences))
    return len(results(sequences)) - before


def nothing(number: int) -> int:
    """Do nothing, as a task that Dask runs for itself."""
    return number


def _dask_alone(workers: Any, num_tasks: int) -> None:
    from distributed import as_completed

    first = [workers.client.submit(nothing, number, pure=False) for number in range(2)]
    under_way = as_completed(first)
    for number, future in enumerate(under_way, 2):
        future.result()
        if number < num_tasks:
            under_way.add(workers.client.submit(nothing, number, pure=False))


def _planned(sequences: list[SequenceWork], workspace: Path) -> tuple[list[SequenceWork], float, float]:
    _, wall, cpu = _timed(lambda: make_plan(sequences, Store(workspace), History(workspace)))
    return sequences, wall, cpu


def _each(wall: float, cpu: float, count: int) -> str:
    return f"{count} tasks, {1e3 * wall / count:.1f} ms each, of the thread that schedules {1e3 * cpu / count:.2f}"


def _memory_gb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--subjects", type=int, default=34)
    parser.add_argument("--instants", type=int, default=293_000)
    parser.add_argument("--workspace", type=Path)
    options = parser.parse_args()
    workspace = options.workspace or Path(tempfile.mkdtemp(prefix="paper-scale-"))
    size = options.subjects, options.instants
    _, wall, _ = _planned(works(workspace, *size), workspace)
    print(f"plan of an empty workspace: {wall:.1f} s", flush=True)
    with local_workers(2, 1, "auto") as workers:
        _dask_alone(workers, 100)  # they are warm afterwards
        _, alone, alone_cpu = _timed(lambda: _dask_alone(workers, _NUM_ALONE))
        print(f"Dask alone: {_each(alone, alone_cpu, _NUM_ALONE)}")
        half = works(workspace, *size)[: options.subjects // 2]
        num_tasks, wall, cpu = _timed(lambda: _run(workers, half, workspace))
        print(f"half of the set: {_each(wall, cpu, num_tasks)}")
        beyond = cpu / num_tasks - alone_cpu / _NUM_ALONE
        print(f"beyond Dask's own: {1e3 * beyond:.2f} ms a task; memory {_memory_gb():.2f} GB", flush=True)
        sequences, wall, _ = _planned(works(workspace, *size), workspace)
        print(f"plan of the half-done run, until its next task can start: {wall:.1f} s", flush=True)
        num_tasks, wall, cpu = _timed(lambda: _run(workers, sequences, workspace))
        print(f"the other half: {_each(wall, cpu, num_tasks)}; memory {_memory_gb():.2f} GB", flush=True)
    _, wall, _ = _timed(lambda: write_view(sequences[0].config, "paper", results(sequences), "benchmark"))
    print(f"the run's folder, {len(results(sequences))} shards: {wall:.1f} s")
    _, wall, _ = _planned(works(workspace, *size), workspace)
    print(f"plan of the finished run: {wall:.1f} s; memory {_memory_gb():.2f} GB at most")
    if options.workspace is None:
        shutil.rmtree(workspace)


if __name__ == "__main__":
    main()
