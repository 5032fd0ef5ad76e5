"""``python -m pipeline [COMMAND] [parameter=value …]``: Hydra composes, the engine runs."""

import os
import shlex
import sys
import time
from collections.abc import Callable

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException, MissingConfigException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from assemblyhands_core.data.store import DamagedEntry
from pipeline.commands import execute
from pipeline.config import CONF_FOLDER, UserError, check_config, chooses_file, unknown_key_message
from pipeline.dag import build_dag
from pipeline.describe import describe
from pipeline.overrides import asks_hydra, has_values_of_sweep, is_sweep, literal, name_words, stray_word
from pipeline.sweeps import Point, write_sweep
from pipeline.terminal import terminal

_INTERRUPTED = 130  # as shells count it: 128 + SIGINT
_COMMANDS = ("run", "plan", "preflight", "gc", "fsck", "report", "compare", "view", "suspects", "correct", "describe")
_OTHER_NAMES = {"import": "correct"}
_WORDS = {"compare": ("run", "other"), "plan": ("target",)}  # parameters that need no name there
_USAGE = """usage: python -m pipeline [COMMAND] [parameter=value ...]

commands
  all        everything from recordings to the paper's tables and a report: preset=tiny, small or paper
  annotate   video in, 3D hand joints out (the default): what is there already is reused
  smooth     the same, and the joints cleaned up over time beside them
  evaluate   annotate, hold every round against the truth where it is known, and write a report
  export     annotate, and write AssemblyHands and COCO files of it, with the headset's pictures where there is one
  simulate   record synthetic sequences in the simulated studio
  train      draw crops and train our networks on them: manifest=data_manifests/training_crops.csv
  predict    hands in the headset's pictures, with SVEgoNet; held against labels where there are any
  train_ego  train SVEgoNet on a manifest's sequences of split train; cross: by people's labels, ours, and both
  ego_only   2D + triangulation in the headset's cameras alone, to compare with
  verbs      which verb is being done, from hand poses of each source; train_verbs: with a network for each
  doctor     look a recording over before hours are spent on it
  preflight  say what of the AssemblyHands release is there: manifest=data_manifests/assemblyhands_v1_1.csv release=PATH
  report     write the page of a finished run: run=NAME (default: the latest)
  compare    compare A B: two runs of the same sequences, difference by difference, with paired intervals
  plan       plan [TARGET], say plan all: what would run, what is reused, and why; changes nothing
  gc         remove results that none of the newest runs refers to
  fsck       read all results again, and set aside what is damaged so that the next run makes it anew
  view       write a run's sequences for the viewer rerun: seq=NAME [run=NAME]; work/runs/<run>/view/<seq>.rrd
  suspects   write what is probably wrong in a run as a task for CVAT or another tool: seq=NAME [run=NAME]
  correct    take over what was corrected there (or: import): corrected=FILE; docs/corrections.md
  describe   the DAG and all tables, in Markdown

often used parameters
  seq=NAME               a sequence of the manifest; names with commas, a glob, or all; all,-NAME leaves one out
  rig.calibration=PATH   with rig.videos='GLOB' and seq=NAME: a rig of your own
  target=NAME            a node or target to stop at
  rounds=3               how often MVExoNet refines 2D + triangulation; 0: not at all
  executor=serial        all in this process, for debuggers; local (default); ssh, slurm, cluster: several machines
  triangulate.max_reprojection_px=8    any parameter of a stage; --cfg job prints them all
  -m PARAMETER=A,B       a sweep: shared work is done once, a table and a picture at its end; repeat it to go on

Results: work/runs/latest/<node>/<table>/*.parquet; in Python: assemblyhands_core.data.store.load("round_3")
"""


def main() -> int:
    """Run the command line; return the exit code: 0 done, 1 some shards failed, 2 a mistake in the request."""
    arguments = sys.argv[1:]
    if arguments[:1] == ["help"] or {"-h", "--help"} & set(arguments):
        print(_USAGE)
        return 0
    command, overrides = _split_command(arguments)
    if command == "describe":
        print(describe(build_dag()), end="")
        return 0
    overrides = literal(overrides)
    if word := stray_word(overrides):
        raise UserError(f"{word} is no parameter=value; see --help")
    command_line = shlex.join(["python", "-m", "pipeline", *arguments])
    if not asks_hydra(overrides):
        return execute(command, check_config(_composed(overrides)), command_line)
    return _run_with_hydra(command, overrides, command_line)


def _run_with_hydra(command: str, overrides: list[str], command_line: str) -> int:
    """Let Hydra compose, which sweeps and knows flags of its own; return the exit code."""
    _refuse_unknown(overrides)
    codes, points = [0], list[Point]()
    sweep = time.strftime("sweep-%Y%m%d-%H%M%S") if is_sweep(overrides) else ""

    def run(composed: DictConfig) -> int:
        config = check_config(composed)
        if sweep:
            of_point = HydraConfig.get()
            config = config.model_copy(update={"run": f"{config.run or sweep}-{of_point.job.num:02d}"})
            points.append(Point(tuple(of_point.overrides.task), config))
        return execute(command, config, command_line)

    def job(composed: DictConfig) -> None:
        if _INTERRUPTED not in codes:  # a job that fails does not stop a sweep, the user does
            codes.append(_reported(lambda: run(composed)))

    sys.argv = [sys.argv[0], *overrides]
    os.environ["HYDRA_FULL_ERROR"] = "1"  # let errors through to us instead of printing tracebacks
    hydra.main(version_base="1.3", config_path=str(CONF_FOLDER), config_name="config")(job)()
    if points and command == "run":
        write_sweep(terminal(), points, points[0].config.workspace / "sweeps" / sweep)
    return max(codes)


def _reported(action: Callable[[], int]) -> int:
    """Return an action's exit code; a user's mistake becomes a sentence and the code 2."""
    try:
        return action()
    except (UserError, DamagedEntry, HydraException, OmegaConfBaseException) as error:
        print(f"error: {str(error).strip()}", file=sys.stderr)
    except OSError as error:
        place = f" ({error.filename})" if error.filename else ""
        print(f"error: {error.strerror or error}{place}; nothing that was finished is lost", file=sys.stderr)
    except KeyboardInterrupt:
        print("interrupted: what was finished is kept; the same command goes on from there", file=sys.stderr)
        return _INTERRUPTED
    return 2


def _split_command(arguments: list[str]) -> tuple[str, list[str]]:
    """Return the command and the overrides; a target's name stands for running it."""
    if not arguments or "=" in arguments[0] or arguments[0].startswith("-"):
        return "run", arguments
    first, rest = _OTHER_NAMES.get(arguments[0], arguments[0]), arguments[1:]
    if first in _COMMANDS:
        return first, name_words(rest, *_WORDS.get(first, ()))
    targets = build_dag().targets
    if first in targets:
        return "run", [f"target={first}", *rest]
    raise UserError(f"there is no command {first}; choose among {', '.join(dict.fromkeys([*targets, *_COMMANDS[1:]]))}")


def _composed(overrides: list[str]) -> DictConfig:
    """Return the configuration; composing takes most of a second, so a mistake is looked for when Hydra finds one."""
    try:
        with hydra.initialize_config_dir(str(CONF_FOLDER), version_base="1.3"):
            composed: DictConfig = hydra.compose("config", overrides)
    except HydraException:
        _refuse_unknown(overrides)
        raise
    return composed


def _refuse_unknown(overrides: list[str]) -> None:
    """Refuse files of ``conf`` and parameters that do not exist with a sentence, where Hydra has pages of its own."""
    settings = [argument for argument in overrides if "=" in argument and not argument.startswith("-")]
    chosen = [setting for setting in settings if chooses_file(setting) and not has_values_of_sweep(setting)]
    try:
        with hydra.initialize_config_dir(str(CONF_FOLDER), version_base="1.3"):
            composed = hydra.compose("config", chosen)
    except MissingConfigException as error:
        there = ", ".join(error.options or ())
        raise UserError(f"there is no {error.missing_cfg_file}; choose among {there}") from error
    if message := unknown_key_message(settings, composed):
        raise UserError(message)


if __name__ == "__main__":
    sys.exit(_reported(main))
