"""A toy pipeline: a recording is a file of numbers, cut into chunks, multiplied, and summed."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from rich.console import Console

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import CHUNKS, MEMBERS, SOURCES
from assemblyhands_core.data.digests import FileDigests
from assemblyhands_core.data.store import Store
from assemblyhands_core.data.tables import TableSpec
from pipeline.config import GcConfig, RigConfig, RunConfig
from pipeline.executor_config import LocalConfig
from pipeline.executors import SerialExecutor
from pipeline.graph import MEMBER_EDGE, SOURCE_EDGE, TRUTH_EDGE, Dag
from pipeline.history import History
from pipeline.plan import PlannedNode, make_plan
from pipeline.progress import Progress
from pipeline.recordings import Recording
from pipeline.runner import Runner, results
from pipeline.tasks import Result
from pipeline.view import write_view
from pipeline.work import SequenceWork, possible_nodes, with_set
from stages._contract import Context, Stage, StageConfig, Tables

NUMBERS = TableSpec(
    "numbers",
    1,
    ("sequence_id", "frame"),
    pa.schema([("sequence_id", pa.string()), ("frame", pa.int64()), ("value", pa.float64())]),
)
CHUNK_LENGTH = 3


class CutConfig(StageConfig):
    pass


class MultiplyConfig(StageConfig):
    factor: float
    is_rounded: bool


class SumConfig(StageConfig):
    pass


def _numbers(context: Context, frames: np.ndarray, values: np.ndarray) -> pa.Table:
    return NUMBERS.build({"sequence_id": [context.sequence_id] * len(frames), "frame": frames, "value": values})


def cut(config: CutConfig, inputs: Tables, context: Context) -> Tables:
    values = np.loadtxt(inputs["sources"]["source_file"][1].as_py(), ndmin=1)
    if np.isnan(values).all():
        raise ValueError("the file holds no number")
    starts = np.arange(0, len(values), CHUNK_LENGTH)
    chunks = {
        "sequence_id": [context.sequence_id] * len(starts),
        "chunk": np.arange(len(starts)),
        "first_frame": starts,
        "num_frames": np.minimum(CHUNK_LENGTH, len(values) - starts),
    }
    return {"chunks": CHUNKS.build(chunks), "numbers": _numbers(context, np.arange(len(values)), values)}


def multiply(config: MultiplyConfig, inputs: Tables, context: Context) -> Tables:
    chunk = inputs["chunks"].to_pylist()
    assert len(chunk) == 1, "a chunk reads its own row only"
    frames = np.arange(chunk[0]["num_frames"]) + chunk[0]["first_frame"]
    values = to_numpy(inputs["numbers"]["value"])[frames] * config.factor
    if np.isnan(values).any():
        raise ValueError(f"frame {frames[np.isnan(values)][0]} is no number")
    return {"numbers": _numbers(context, frames, np.round(values) if config.is_rounded else values)}


def total(config: SumConfig, inputs: Tables, context: Context) -> Tables:
    return {"numbers": _numbers(context, np.zeros(1), np.array([to_numpy(inputs["numbers"]["value"]).sum()]))}


def cut_finer(config: CutConfig, inputs: Tables, context: Context) -> Tables:
    """One chunk for each number."""
    count = len(np.loadtxt(inputs["sources"]["source_file"][1].as_py(), ndmin=1))
    columns = {"chunk": np.arange(count), "first_frame": np.arange(count), "num_frames": np.ones(count)}
    return {"chunks": CHUNKS.build({"sequence_id": [context.sequence_id] * count, **columns})}


def total_of_both(config: SumConfig, inputs: Tables, context: Context) -> Tables:
    values = [to_numpy(inputs[role]["value"]).sum() for role in ("a", "b")]
    return {"numbers": _numbers(context, np.zeros(1), np.array([sum(values)]))}


def mean(config: SumConfig, inputs: Tables, context: Context) -> Tables:
    """The mean over all sequences of a split of their totals."""
    splits = {row["sequence_id"]: row["split"] for row in inputs["members"].to_pylist()}
    totals = [row["value"] for row in inputs["totals"].to_pylist() if splits[row["sequence_id"]] == "train"]
    return {"numbers": _numbers(context, np.zeros(1), np.array([np.mean(totals)]))}


def compare(config: SumConfig, inputs: Tables, context: Context) -> Tables:
    """How much more than the mean of all each number of a chunk is."""
    numbers = inputs["numbers"]
    excess = to_numpy(numbers["value"]) - inputs["mean"]["value"][0].as_py()
    return {"numbers": _numbers(context, to_numpy(numbers["frame"]), excess)}


def judge(config: SumConfig, inputs: Tables, context: Context) -> Tables:
    file = Path(inputs["truth"]["source_file"][0].as_py())
    error = to_numpy(inputs["numbers"]["value"]) - pa.parquet.read_table(file)["total"][0].as_py()
    return {"numbers": _numbers(context, np.zeros(1), error)}


def toy_dag(version: int = 1) -> Dag:
    numbers = {"numbers": NUMBERS}
    dag = Dag()
    cutting = Stage("cut", 1, CutConfig, {"sources": SOURCES}, {**numbers, "chunks": CHUNKS}, cut, "sequence")
    times = Stage("multiply", version, MultiplyConfig, {"chunks": CHUNKS, **numbers}, numbers, multiply, "chunk")
    dag.add("cut", cutting, sources=SOURCE_EDGE)
    dag.add("times", times, chunks="cut.chunks", numbers="cut.numbers")
    dag.add("total", Stage("sum", 1, SumConfig, numbers, numbers, total, "sequence"), numbers="times.numbers")
    judging = Stage("judge", 1, SumConfig, {"truth": SOURCES, **numbers}, numbers, judge, "sequence")
    dag.add("error", judging, truth=TRUTH_EDGE, numbers="total.numbers")
    over_all = Stage("mean", 1, SumConfig, {"members": MEMBERS, "totals": NUMBERS}, numbers, mean, "set")
    dag.add("mean", over_all, members=MEMBER_EDGE, totals="total.numbers")
    dag.add("mean_error", over_all, members=MEMBER_EDGE, totals="error.numbers")
    finer = Stage("cut_finer", 1, CutConfig, {"sources": SOURCES}, {"chunks": CHUNKS}, cut_finer, "sequence")
    dag.add("finer", finer, sources=SOURCE_EDGE)
    dag.add("times_finer", times, chunks="finer.chunks", numbers="cut.numbers")
    both = Stage("sum_both", 1, SumConfig, {"a": NUMBERS, "b": NUMBERS}, numbers, total_of_both, "sequence")
    dag.add("both", both, a="times.numbers", b="times_finer.numbers")
    comparing = Stage("compare", 1, SumConfig, {**numbers, "mean": NUMBERS}, numbers, compare, "chunk")
    dag.add("excess", comparing, numbers="times.numbers", mean="mean.numbers")
    return dag


@dataclass
class Toy:
    """A workspace with recordings of numbers, and the pipeline over them."""

    folder: Path
    factor: float = 2.0
    is_rounded: bool = False
    version: int = 1
    names: list[str] = field(default_factory=list)
    targets: tuple[str, ...] = ("total", "error")
    splits: dict[str, str] = field(default_factory=dict)

    def record(self, name: str, *values: float) -> None:
        (self.folder / f"{name}.txt").write_text("\n".join(map(str, values)))
        self.names = [*dict.fromkeys([*self.names, name])]

    def know(self, name: str, true_total: float) -> None:
        """Give a recording its ground truth; without it, there is no node ``error``."""
        (self.folder / f"{name}-truth").mkdir(exist_ok=True)
        pa.parquet.write_table(pa.table({"total": [true_total]}), self.folder / f"{name}-truth" / "total.parquet")

    @property
    def workspace(self) -> Path:
        return self.folder / "work"

    @property
    def store(self) -> Store:
        return Store(self.workspace)

    def config(self) -> RunConfig:
        config = RunConfig(
            seq="all", target="made", manifest=None, release=None, workspace=self.workspace, run="",
            rounds=3,
            gc=GcConfig(keep_runs=10, dry_run=False),
            rig=RigConfig(calibration=None, videos=None),
            executor=LocalConfig(name="serial", num_workers=1, memory_limit="auto"),
        )  # fmt: skip
        config._dag = toy_dag(self.version)
        config._dag.targets["made"] = self.targets
        config._stages = {"cut": CutConfig(), "sum": SumConfig(), "judge": SumConfig(),
                          "mean": SumConfig(), "compare": SumConfig(), "cut_finer": CutConfig(),
                          "sum_both": SumConfig(),
                          "multiply": MultiplyConfig(factor=self.factor, is_rounded=self.is_rounded)}  # fmt: skip
        return config

    def works(self) -> list[SequenceWork]:
        config = self.config()
        digests = FileDigests(self.workspace / "file-digests.json")
        works = []
        for name in self.names:
            file = self.folder / f"{name}.txt"
            truth = self.folder / f"{name}-truth"
            recording = Recording(name, file, {"numbers": file}, ground_truth=truth if truth.is_dir() else None)
            origins = recording.origin_rows(digests)
            nodes = possible_nodes(config, name, origins)
            works.append(SequenceWork(config, recording, origins, nodes, self.workspace / "logs"))
        return with_set(works, {name: self.splits.get(name, "train") for name in self.names})

    def plan(self) -> dict[tuple[str, str], PlannedNode]:
        rows = make_plan(self.works(), self.store, History(self.workspace))
        return {(row.sequence_id, row.node): row for row in rows}

    def run(self, run: str = "run") -> list[Result]:
        works = self.works()
        make_plan(works, self.store, History(self.workspace))
        with Progress(Console(quiet=True)) as progress:
            Runner(works, SerialExecutor(), self.store, progress).run()
        found = results(works)
        write_view(self.config(), run, found, "make toy")
        return found

    def status(self, found: list[Result]) -> dict[str, str]:
        return {f"{result.node} {result.shard}": result.status for result in found}

    def total(self, name: str) -> float:
        path = self.workspace / "runs" / "latest" / "total" / "numbers" / f"{name}.parquet"
        return float(pa.parquet.read_table(path.resolve())["value"][0].as_py())


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Toy]:
    monkeypatch.setattr("assemblyhands_core.data.store._LATE_S", 0.0)  # nobody waits for what is not there
    toy = Toy(tmp_path)
    toy.record("one", 1, 2, 3, 4, 5)
    yield toy
