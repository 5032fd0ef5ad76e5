"""`predict_ego` as the stage runs it: pictures per second, and the share of it spent outside the network.

    python benchmarks/predict_ego.py [--run work/runs/latest] [--threads 2] [--repeats 3]

Takes a finished run of `target=predict` and does the first chunk's prediction anew. *Outside the network* is the share
of the threads' time in which it does not run: decoding and scaling of crops, lifting, merging.
"""

import argparse
import tempfile
import time
from pathlib import Path

import torch
from _network_clock import NetworkClock
from hydra import compose, initialize_config_dir

from assemblyhands_core.data.store import load_table
from assemblyhands_core.models.svegonet import SVEgoNet
from pipeline.config import CONF_FOLDER, check_config
from stages import predict_ego
from stages._contract import Context


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, default=Path("work/runs/latest"))
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    if not (options.run / "predict_ego" / "manifest.json").is_file():
        print(f"{options.run} has no predictions: run `python -m pipeline predict` first")
        return
    crops = load_table(next(iter(sorted((options.run / "project_ego" / "crops").glob("*.parquet")))))
    weights = load_table(options.run / "svegonet")
    clock = NetworkClock()
    SVEgoNet.forward = clock.wrapped(SVEgoNet.forward)  # type: ignore[method-assign]
    inputs, times = {"crops": crops, "weights": weights}, []
    for _ in range(options.repeats + 1):  # the first one warms up
        clock.seconds, begin = 0.0, time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            context = Context(Path(folder), "s", options.threads, Path(folder))
            predict_ego.STAGE.run(_config(), inputs, context)
        times.append((time.perf_counter() - begin, clock.seconds / options.threads))
    whole, network = min(times[1:])
    count = sum(crops["valid"].to_pylist())
    print(f"{count} crops, {count / whole:.0f} per second on {options.threads} threads ({torch.__version__})")
    print(f"outside the network: {1 - network / whole:.1%}")


def _config() -> predict_ego.PredictEgoConfig:
    with initialize_config_dir(str(CONF_FOLDER), version_base="1.3"):
        config = check_config(compose("config")).stages["predict_ego"]
    assert isinstance(config, predict_ego.PredictEgoConfig)
    return config


if __name__ == "__main__":
    main()
