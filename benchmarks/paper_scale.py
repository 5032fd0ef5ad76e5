"""The engine alone, at the size of the paper's set: 34 subjects, 293 000 instants, every stage does nothing.

    python benchmarks/paper_scale.py [--subjects 34] [--instants 293000] [--workspace FOLDER]

Plans and runs the real DAG (targets annotate and predict) with stages that give empty tables, on two workers; then
plans it again, finished and with half of its results gone, and goes on from there. *Beyond Dask's own* is what the
thread that schedules spends on a task more than on one that Dask is given alone, as many at a time as we do.
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--subjects", type=int, default=34)
    parser.add_argument("--instants", type=int, default=293_000)
    parser.add_argument("--workspace", type=Path)
    options = parser.parse_args()
    workspace = options.workspace or Path(tempfile.mkdtemp(prefix="paper-scale-"))
    store, size = Store(workspace), (options.subjects, options.instants)

    sequences = works(workspace, *size)
    _, wall, _ = _timed(lambda: make_plan(sequences, store, History(workspace)))
    print(f"plan of an empty workspace: {wall:.1f} s")
    with local_workers(2, 1, "auto") as workers:
        _dask_alone(workers, 100)  # they are warm afterwards
        num_tasks, wall, cpu = _timed(lambda: _run(workers, sequences, workspace))
        _, alone, alone_cpu = _timed(lambda: _dask_alone(workers, num_tasks))
    for name, seconds, busy in (("run", wall, cpu), ("Dask alone", alone, alone_cpu)):
        each, own = 1e3 * seconds / num_tasks, 1e3 * busy / num_tasks
        print(
            f"{name}: {num_tasks} tasks in {seconds:.0f} s, {each:.1f} ms a task; the thread that schedules {own:.2f}"
        )
    print(f"beyond Dask's own: {1e3 * (cpu - alone_cpu) / num_tasks:.2f} ms a task")
    _, wall, _ = _timed(lambda: write_view(sequences[0].config, "paper", results(sequences), "benchmark"))
    print(f"the run's folder: {wall:.1f} s")

    sequences = works(workspace, *size)
    _, wall, _ = _timed(lambda: make_plan(sequences, store, History(workspace)))
    print(f"plan of a finished run: {wall:.1f} s")
    for entries in (workspace / "store").iterdir():
        for entry in sorted(entries.iterdir())[::2]:
            shutil.rmtree(entry)
    sequences = works(workspace, *size)
    _, wall, _ = _timed(lambda: make_plan(sequences, store, History(workspace)))
    print(f"plan of a half-done run, until its first task can start: {wall:.1f} s")
    with local_workers(2, 1, "auto") as workers:
        num_tasks, wall, _ = _timed(lambda: _run(workers, sequences, workspace))
    print(f"the other half: {num_tasks} tasks in {wall:.0f} s")
    print(f"memory of the main process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB at most")
    if options.workspace is None:
        shutil.rmtree(workspace)


if __name__ == "__main__":
    main()
