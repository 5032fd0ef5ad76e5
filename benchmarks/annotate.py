"""A round of annotation as the stage runs it: hands per second, what the network needs of it, and how near to the peak.

    python benchmarks/annotate.py [--run work/runs/latest] [--threads 2] [--repeats 3]

Takes a finished run (`make annotate`) and does round 2 of its first chunk anew. *Outside the network* is the share of
the threads' time in which the network does not run: tables, decoding and cutting of crops, the guard. FLOPs are
those of convolutions and products (two for each multiplication and addition); the peak is that of a product of two
large matrices on as many threads, measured in turn with the rounds because other work only slows both down.
"""

import argparse
import json
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import torch
from _network_clock import NetworkClock
from torch.utils.flop_counter import FlopCounterMode

from assemblyhands_core.models import annotation
from assemblyhands_core.models.mvexonet import MVExoNet
from pipeline.dag import build_dag
from stages import annotate_round
from stages._contract import Context

NODE, SIDE = "round_2", 2048


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, default=Path("work/runs/latest"))
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    if not (options.run / NODE / "manifest.json").is_file():
        print(f"{options.run} has no {NODE}: run `make annotate` first")
        return
    inputs, config = chunk_of(options.run)
    clock, counts = NetworkClock(), list[float]()
    annotation._forward = counting(clock.wrapped(annotation._forward), counts)
    timed(config, inputs, options.threads)  # compiles the fused loop
    rounds, peaks = [], []
    for _ in range(options.repeats):
        clock.seconds = 0.0
        rounds.append((timed(config, inputs, options.threads), clock.seconds / options.threads))
        peaks.append(peak_flops(options.threads))
    whole, network = min(rounds)
    hands, peak = inputs["joints"].num_rows, max(peaks)
    (flops,) = counts
    print(
        f"{hands} hands, {hands / 2 / whole:.2f} instants (both hands) per second, {1e3 * whole / hands:.0f} ms a hand"
    )
    print(f"outside the network: {1 - network / whole:.1%}")
    print(f"{flops / 1e9:.2f} GFLOP a hand, {flops * hands / network / 1e9:.0f} GFLOP/s in the network,")
    print(f"{flops * hands / network / peak:.0%} of this machine's peak of {peak / 1e9:.0f} GFLOP/s")


def counting(forward: Any, flops: list[float]) -> Any:
    """Return the same forward pass, which notes the FLOPs of one hand with all its views when it first runs."""
    lock = threading.Lock()

    def counted(network: MVExoNet, arguments: Any) -> Any:
        with lock:
            if not flops:
                with FlopCounterMode(display=False) as counter:
                    forward(network, [tensor[:1] for tensor in arguments])
                flops.append(float(counter.get_total_flops()))
        return forward(network, arguments)

    return counted


def chunk_of(run: Path) -> tuple[Mapping[str, pa.Table], Any]:
    """Return what the stage reads for the first chunk of a run, and its configuration."""
    node = build_dag().nodes[NODE]
    manifest = json.loads((run / NODE / "manifest.json").read_text())
    sequence_id, values = next(iter(manifest["configs"].items()))
    shard = next(name for name in manifest["shards"] if name.startswith(sequence_id))
    inputs = {}
    for role, edge in node.inputs.items():
        folder = run.joinpath(*edge.split("."))
        file = folder / f"{shard}.parquet"
        inputs[role] = pq.read_table((file if file.exists() else folder / f"{sequence_id}.parquet").resolve())
    return inputs, annotate_round.STAGE.config.model_validate(values)


def timed(config: Any, inputs: Mapping[str, pa.Table], num_threads: int) -> float:
    """Return the seconds that the stage takes."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        annotate_round.STAGE.run(config, inputs, Context(Path(folder), "s", num_threads, Path(folder)))
        return time.perf_counter() - begin


def peak_flops(num_threads: int) -> float:
    """Return FLOP/s of a product of two large matrices, the best of five."""
    torch.set_num_threads(num_threads)
    matrix, seconds = torch.rand(SIDE, SIDE), []
    for _ in range(5):
        begin = time.perf_counter()
        matrix @ matrix
        seconds.append(time.perf_counter() - begin)
    return 2.0 * SIDE**3 / min(seconds)


if __name__ == "__main__":
    main()
