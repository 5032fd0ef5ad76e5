"""What worse poses cost: accuracy of verbs against the error of the poses, from noise that is added to them.

    python benchmarks/verb_noise.py [--run work/runs/latest] [--noise-mm 0 2 5 10 15 20 30] [--figure verbs.png]

Takes a finished run of `target=verb_weights` and classifies the segments of its test persons, of whom nothing was
learnt, anew for each noise. Figures are of poses that the simulated studio drew, not of real recordings.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from hydra import compose, initialize_config_dir

from assemblyhands_core.data.store import load_table
from assemblyhands_core.metrics.verbs import TABLE, VerbEvaluation, evaluate_verbs
from pipeline.config import CONF_FOLDER, check_config
from stages import classify_verbs, tabulate_verbs
from stages._contract import Context

METRICS = ("pose_error_mm", "accuracy", "mean_verb_accuracy")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, default=Path("work/runs/latest"))
    parser.add_argument("--sequence", default="poses_test")
    parser.add_argument("--noise-mm", type=float, nargs="+", default=[0, 2, 5, 10, 15, 20, 30])
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    clips = load_table(options.run / "drawn_verb_clips")
    clips = clips.filter(pc.equal(clips["sequence_id"], options.sequence))
    if not clips.num_rows:
        print(f"{options.run} has no clips of {options.sequence}: run `make train-verbs` first")
        return
    weights = load_table(options.run / "drawn_verb_weights")
    table = [_row(noise_mm, clips, weights, options.threads) for noise_mm in options.noise_mm]
    print(f"{len(clips['segment'].unique())} segments; intervals over takes, 95 %")
    print(f"{'noise mm':>9}" + "".join(f"{name:>30}" for name in METRICS))
    for noise_mm, cells in table:
        print(f"{noise_mm:9.1f}" + "".join(f"{_text(cells[name]):>30}" for name in METRICS))
    if options.figure:
        _draw(table, options.figure)


def _row(noise_mm: float, clips: pa.Table, weights: pa.Table, threads: int) -> tuple[float, dict[str, tuple]]:
    with initialize_config_dir(str(CONF_FOLDER), version_base="1.3"):
        stages = check_config(compose("config", [f"classify_verbs.noise_mm={noise_mm}"])).stages
    inputs = {"clips": clips, "reference": clips, "weights": weights}
    with tempfile.TemporaryDirectory() as folder:
        context = Context(Path(folder), "s", threads, Path(folder))
        found = classify_verbs.STAGE.run(stages["classify_verbs"], inputs, context)["predictions"]
    # A set's takes are one sequence; each is of another person, and goes whole into or out of a draw.
    takes = pa.array([f"take {segment // 1000}" for segment in found["segment"].to_pylist()])
    found = found.set_column(0, "sequence_id", takes).append_column("source", pa.array(["drawn"] * found.num_rows))
    settings = stages["tabulate_verbs"]
    assert isinstance(settings, tabulate_verbs.TabulateVerbsConfig)
    cells = evaluate_verbs(
        found, VerbEvaluation(settings.verbs, "", "recording", settings.num_resamples, settings.seed)
    )
    overall = {
        cell.metric: (cell.value, cell.low, cell.high) for cell in cells if (cell.table, cell.row) == (TABLE, "drawn")
    }
    return noise_mm, overall


def _text(figure: tuple) -> str:
    return "{:.1f} ({:.1f} to {:.1f})".format(*figure)


def _draw(table: list[tuple[float, dict[str, tuple]]], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), dpi=100, layout="constrained")
    axes = figure.subplots()
    errors = [cells["pose_error_mm"][0] for _, cells in table]
    value, low, high = zip(*(cells["mean_verb_accuracy"] for _, cells in table), strict=True)
    spread = np.abs(np.array([low, high]) - np.array(value))
    axes.errorbar(errors, value, yerr=spread, marker="o", color="#0072B2", capsize=3)
    axes.set(
        xlabel="wrist-relative pose error (mm), from noise",
        ylabel="mean accuracy over six verbs (%)",
        title="Verbs against pose error, synthetic test persons",
        ylim=(0, 100),
    )
    axes.axhline(100 / 6, color="#777777", linestyle="--")
    axes.text(errors[-1], 100 / 6 + 1, "chance", ha="right", color="#777777")
    figure.savefig(path)


if __name__ == "__main__":
    main()
